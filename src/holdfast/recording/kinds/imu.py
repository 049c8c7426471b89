"""IMUs, of the cabin and of the chassis, and the samples that none can have measured."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.config.assignment import Measured, Rule
from holdfast.config.sensors import InertialConfig
from holdfast.messages import Array, ImuSample, Message
from holdfast.recording.columns import Columns, axes
from holdfast.recording.decode import IMU, STAMP, Decoder, FieldDecoder
from holdfast.recording.imu_at_rest import UNITS_OF_GRAVITY, ImuAtRest, force_unit_m_s2, imu_at_rest
from holdfast.recording.kinds import CHASSIS, DERIVED, Kind, register
from holdfast.recording.source import Subscription

FIELDS = (*STAMP, *(f"{vector}.{axis}" for vector in ("angular_velocity", "linear_acceleration") for axis in "xyz"))
MIN_LINE_SAMPLES = 4
LINE_TOLERANCE = 1e-6
"""Second differences [rad/s, m/s^2] below this are zero: far under any sensor's noise, and yet above what the jitter of
the stamps leaves of a line drawn over time (on the KITTI drive all tolerances from 1e-7 to 1e-4 find the same 8 lines).
"""
MAX_REPEATS = 0.01
GREATEST_MEDIAN_FORCE_M_S2 = 50.0  # five times gravity for half of the time is no machine
NS_PER_S = 1e9
REST_NEEDED = "record some seconds of standstill"


def imu_decoder(subscription: Subscription) -> Decoder:
    """Decode sensor_msgs/Imu; this is the hot path of a replay."""
    sensor = subscription.sensor

    def build(arrival_ns: int, sec: int, nanosec: int, *numbers: float) -> ImuSample:
        stamp_ns = sec * 1_000_000_000 + nanosec
        return ImuSample(stamp_ns, arrival_ns, sensor, np.array(numbers[:3]), np.array(numbers[3:]))

    def build_of_other_units(arrival_ns: int, sec: int, nanosec: int, *numbers: float) -> Message:
        return subscription.meant(build(arrival_ns, sec, nanosec, *numbers))

    return FieldDecoder(FIELDS, build if subscription.factors is None else build_of_other_units)


@dataclass(frozen=True, slots=True)
class ImuFindings:
    """Samples that an IMU cannot have measured; lines are runs of 4 or more samples on a line in all six channels.

    `at_rest` is what it is like at its quietest, None if it never is quiet; the force is the median of its length, and
    its unit what gravity shows it to be.
    """

    repeats: int
    not_finite: int
    lines: int
    line_samples: int
    longest_line_s: float
    longest_line_at_s: float
    median_force_m_s2: float
    force_unit_m_s2: float
    at_rest: ImuAtRest | None

    def summary(self) -> str:
        """Return it in one line."""
        text = f"{self.repeats} repeated samples, {self.lines} straight lines, {self.not_finite} not finite"
        return text if self.at_rest is None else f"{text}; {self.at_rest.summary()}"

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
        if self.force_unit_m_s2 != 1.0:
            yield (
                f"gravity shows that the accelerometer gives {UNITS_OF_GRAVITY[self.force_unit_m_s2]}, of which "
                f"accelerometer_factors of {self.force_unit_m_s2:.9g} each would make m/s^2"
            )
        elif self.median_force_m_s2 > GREATEST_MEDIAN_FORCE_M_S2:
            yield (
                f"the median specific force is {self.median_force_m_s2:.0f}, where gravity alone is 9.8: the driver "
                "seems to give another unit, of which accelerometer_factors would make m/s^2"
            )
        if self.at_rest is not None and self.at_rest.is_without_gravity():
            yield (
                f"the mean specific force is {self.at_rest.mean_force_m_s2:.2f} m/s^2 at rest, where it is gravity's "
                "9.8: the driver seems to take gravity off; it must give what the accelerometer measures"
            )

    def measured(self) -> Measured:
        """Return what a configuration can say of the IMU; see `Findings`."""
        if self.at_rest is None:
            return Measured((f"never quiet: its noise cannot be measured ({REST_NEEDED})",))
        found = {
            "gyroscope_noise_density": self.at_rest.gyroscope_noise_density,
            "accelerometer_noise_density": self.at_rest.accelerometer_noise_density,
        }
        found = {key: float(f"{density:.2g}") for key, density in found.items()}
        return Measured(
            self.at_rest.notes(),
            {key: f"measured {density:g}" for key, density in found.items()},
            {key: value for key, value in found.items() if InertialConfig.model_fields[key].default < value <= 1.0},
        )


def check(stamps_ns: NDArray[np.int64], values: Array, start_ns: int) -> ImuFindings | None:
    """Return what was found; None if all values are zero: such messages hold an orientation alone."""
    if not values.any():
        return None
    finite = np.isfinite(values).all(axis=1)
    lines = straight_lines(values)
    begin, end = max(lines, key=lambda line: stamps_ns[line[1] - 1] - stamps_ns[line[0]], default=(0, 0))
    return ImuFindings(
        repeats=int((values[1:] == values[:-1]).all(axis=1).sum()),
        not_finite=int((~finite).sum()),
        lines=len(lines),
        line_samples=sum(end - begin for begin, end in lines),
        longest_line_s=float(stamps_ns[end - 1] - stamps_ns[begin]) / NS_PER_S if lines else 0.0,
        longest_line_at_s=float(stamps_ns[begin] - start_ns) / NS_PER_S if lines else 0.0,
        median_force_m_s2=float(np.median(np.linalg.norm(values[finite, 3:], axis=1))) if finite.any() else 0.0,
        force_unit_m_s2=force_unit_m_s2(stamps_ns / NS_PER_S, values),
        at_rest=imu_at_rest(stamps_ns, values, start_ns),
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
