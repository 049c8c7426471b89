"""IMUs, of the cabin and of the chassis, and the samples that none can have measured."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.config.assignment import Rule
from holdfast.messages import Array, ImuSample
from holdfast.recording.columns import Columns, axes
from holdfast.recording.decode import IMU, Decoder
from holdfast.recording.kinds import CHASSIS, DERIVED, Kind, register
from holdfast.recording.source import Subscription

MIN_LINE_SAMPLES = 4
LINE_TOLERANCE = 1e-6
"""Second differences [rad/s, m/s^2] below this are zero: far under any sensor's noise, and yet above what the jitter of
the stamps leaves of a line drawn over time (on the KITTI drive all tolerances from 1e-7 to 1e-4 find the same 8 lines).
"""
MAX_REPEATS = 0.01
NS_PER_S = 1e9


def imu_decoder(subscription: Subscription) -> Decoder:
    """Decode sensor_msgs/Imu; this is the hot path of a replay."""
    sensor = subscription.sensor

    def decode(message: Any, arrival_ns: int) -> ImuSample:
        stamp = message.header.stamp
        rate = message.angular_velocity
        force = message.linear_acceleration
        return ImuSample(
            stamp.sec * 1_000_000_000 + stamp.nanosec,
            arrival_ns,
            sensor,
            np.array((rate.x, rate.y, rate.z)),
            np.array((force.x, force.y, force.z)),
        )

    return decode


@dataclass(frozen=True, slots=True)
class ImuFindings:
    """Samples that an IMU cannot have measured; lines are runs of 4 or more samples on a line in all six channels."""

    repeats: int
    not_finite: int
    lines: int
    line_samples: int
    longest_line_s: float
    longest_line_at_s: float

    def summary(self) -> str:
        """Return it in one line."""
        return f"{self.repeats} repeated samples, {self.lines} straight lines, {self.not_finite} not finite"

    def problems(self, count: int) -> Iterator[str]:
        """Yield what is wrong; see `Findings`."""
        if self.repeats > MAX_REPEATS * count:
            yield (
                f"{self.repeats} of {count} samples ({self.repeats / count:.0%}) repeat the one before; the sensor "
                "measures less often than it is read, so its true rate is lower"
            )
        if self.lines:
            yield (
                f"{self.lines} straight line(s) through all six channels, {self.line_samples} samples, the longest "
                f"{self.longest_line_s:.3f} s at {self.longest_line_at_s:.1f} s; a logger drew them over drop-outs, "
                "nothing was measured there"
            )
        if self.not_finite:
            yield f"{self.not_finite} sample(s) are not finite; they are counted and not used"


def check(stamps_ns: NDArray[np.int64], values: Array, start_ns: int) -> ImuFindings | None:
    """Return what was found; None if all values are zero: such messages hold an orientation alone."""
    if not values.any():
        return None
    lines = straight_lines(values)
    begin, end = max(lines, key=lambda line: stamps_ns[line[1] - 1] - stamps_ns[line[0]], default=(0, 0))
    return ImuFindings(
        repeats=int((values[1:] == values[:-1]).all(axis=1).sum()),
        not_finite=int((~np.isfinite(values).all(axis=1)).sum()),
        lines=len(lines),
        line_samples=sum(end - begin for begin, end in lines),
        longest_line_s=float(stamps_ns[end - 1] - stamps_ns[begin]) / NS_PER_S if lines else 0.0,
        longest_line_at_s=float(stamps_ns[begin] - start_ns) / NS_PER_S if lines else 0.0,
    )


def straight_lines(values: Array) -> list[tuple[int, int]]:
    """Find runs of 4 or more samples (N, 6) whose second differences are zero in all channels though they change.

    Noise makes such a run impossible for a sensor: a logger drew it over a drop-out. Returns (begin, end) indices,
    the end exclusive. Runs without change are no lines but repeats.
    """
    first = np.diff(values, axis=0)
    with np.errstate(invalid="ignore"):
        straight = (np.abs(np.diff(first, axis=0)) <= LINE_TOLERANCE).all(axis=1)
        straight &= (np.abs(first[1:]) > LINE_TOLERANCE).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], straight, [False])).astype(np.int8)))
    runs = ((int(begin), int(end) + 2) for begin, end in edges.reshape(-1, 2))
    return [(begin, end) for begin, end in runs if end - begin >= MIN_LINE_SAMPLES]


COLUMNS = Columns((*axes("w?_rad_s"), *axes("a?_m_s2")), ImuSample.of)
OTHER = ("mag", "camera", "ouster", "livox", "velodyne", "heading")

register(
    Kind(
        "imu",
        ImuSample,
        {IMU: imu_decoder},
        COLUMNS,
        rules=(
            Rule("imu", ("cabin", "data"), (*CHASSIS, *DERIVED, *OTHER), last_resort=True),
            Rule("imu", avoid=("mag", "heading"), every=True, spare=True),
        ),
        gap="no IMU factor spans a gap, so the other sensors must bridge it",
        check=check,
        rank=0,
    )
)
register(
    Kind(
        "base_imu",
        ImuSample,
        {IMU: imu_decoder},
        COLUMNS,
        rules=(Rule("base_imu", CHASSIS, (*DERIVED, "mag"), named=True, on_chassis=True),),
        gap="the joint and the cabin's gyroscope carry the chassis meanwhile",
        rank=90,
    )
)
