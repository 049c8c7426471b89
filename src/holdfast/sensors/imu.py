"""The IMU: which samples can be used, and where it was silent.

Between two samples the readings are taken as linear in time, so that an interval may be cut at any instant. A drop-out
(missing samples, or samples that a logger drew as a straight line) is a gap: a constant-twist motion model stands in.
The samples lie in the records of `holdfast.kernel`, whose functions take them in and cut them.
"""

from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from holdfast.config.sensors import InertialConfig
from holdfast.errors import MessageError
from holdfast.events import Outcome
from holdfast.kernel import layout
from holdfast.kernel.density import LENGTH, find_density
from holdfast.kernel.inertial_motion import add_up
from holdfast.kernel.samples import (
    IS_LINE,
    STEPPED,
    SUSPECT_LINE,
    fill_steps,
    find_piece,
    find_rate,
    find_row_after,
    forget_before,
    take_in,
)
from holdfast.measured_fields import REAL_KINDS, got
from holdfast.messages import Array, ImuSample
from holdfast.sensors.preintegration import Density, Step
from holdfast.sensors.rate_forecast import RateForecast

CLOCK_JUMP_NS = 250_000_000  # a stamp that differs from its arrival by this much more than those before is suspect
SUSPECTS_ACCEPTED = 3
ROWS = 4096  # for samples at first
NEWEST, BEFORE, ARRIVAL = (
    layout.BUFFER.names.index(name)  # type: ignore[union-attr]
    for name in ("newest_ns", "before_ns", "arrival_ns")
)


def as_doubles(reading: Array, field: str) -> Array:
    """Return a reading of an `ImuSample` as an array of float64.

    Raises:
        MessageError: it is not made of numbers.
    """
    found = np.asarray(reading)
    if found.dtype.kind not in REAL_KINDS:
        must_be = ImuSample.QUANTITIES[field]
        raise MessageError(f"ImuSample.{field}: must be {must_be}, {got(reading)}")
    return np.asarray(found, np.float64)


class Added(NamedTuple):
    """What a sample made certain.

    Attributes:
        has_step: the IMU measured all along since the sample before.
        line_since_ns: start of the straight line that the samples until now lie on, if this one makes it certain.
    """

    has_step: bool
    line_since_ns: int | None


class Piece(NamedTuple):
    """A stretch of time in which the IMU either measured throughout or was silent throughout."""

    start_ns: int
    end_ns: int
    is_gap: bool


class InertialMotion(NamedTuple):
    """What the IMU measured over a stretch of time, in the frame where it was at the start, without gravity.

    Attributes:
        R: (3, 3) rotation.
        v: (3,) change of the velocity [m/s].
        p: (3,) change of the position beyond that of the velocity at the start [m].
    """

    R: Array
    v: Array
    p: Array


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """The integral of the angular velocity in the axes of I (3,) [rad], and the time in which the IMU measured it."""

    angle_rad: Array
    time_s: float

    @property
    def rate(self) -> Array:
        """The mean angular velocity (3,) [rad/s]."""
        return self.angle_rad / self.time_s if self.time_s > 0.0 else np.zeros(3)

    def __add__(self, other: "Turning") -> "Turning":
        return Turning(self.angle_rad + other.angle_rad, self.time_s + other.time_s)

    def __neg__(self) -> "Turning":
        return Turning(-self.angle_rad, -self.time_s)


NOT_TURNED = Turning(np.zeros(3), 0.0)


class ImuBuffer:
    """The usable samples of the last seconds, cut at will and aware of drop-outs.

    Attributes:
        record: (1,) of `BUFFER`; so that `holdfast.kernel.imu_path` works on them, as are
        samples: the rows, of which `first` to `end` are held; replaced by a larger array where they do not suffice
        blocks: what they show of the noise.
        numbers: the record as integers, five times faster to read.
    """

    def __init__(self, config: InertialConfig) -> None:
        self._config = config
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.record: Any = np.zeros(1, layout.BUFFER)
        self._one = self.record[0]
        self.numbers = memoryview(self.record.view(np.int64).data)
        self._one["least_gap_ns"] = self._one["max_gap_ns"] = round(config.max_gap_s * 1e9)
        self._one["accelerometer_range"] = config.accelerometer_range
        self._one["gyroscope_range"] = config.gyroscope_range
        self.samples: Any = np.zeros(ROWS, layout.SAMPLE)
        self.blocks: Any = np.zeros(ROWS // LENGTH + 2, layout.BLOCK)
        self._note_rows()
        self._suspect_ns = self._suspect_arrival_ns = self._suspect_delay_ns = self._suspects = 0
        self._repeats = self._repeats_since_ns = 0
        self.forecast = RateForecast()

    def _note_rows(self) -> None:
        """Write down where the rows lie."""
        self._one["samples_at"], self._one["rows"] = self.samples.ctypes.data, len(self.samples)
        self._one["blocks_at"], self._one["block_rows"] = self.blocks.ctypes.data, len(self.blocks)

    @property
    def arrival_ns(self) -> int:
        """When the newest sample arrived."""
        number: int = self.numbers[ARRIVAL]
        return number

    @property
    def latest_ns(self) -> int:
        """Stamp of the newest sample, time offset applied; 0 before the first."""
        number: int = self.numbers[NEWEST]
        return number

    @property
    def before_ns(self) -> int:
        """Stamp of the sample before the newest; 0 at the first."""
        number: int = self.numbers[BEFORE]
        return number

    @property
    def oldest_ns(self) -> int:
        """Stamp of the oldest sample that is still held; 0 before the first."""
        first, end = self._held()
        return int(self.samples[first]["stamp_ns"]) if first < end else 0

    @property
    def max_gap_ns(self) -> int:
        """Silence longer than this is a drop-out: the configured bound, or 2.5 sample periods if that is more."""
        return int(self._one["max_gap_ns"])

    def _held(self) -> tuple[int, int]:
        """Return the rows that are held: first, and one past the last."""
        return int(self._one["first"]), int(self._one["end"])

    def is_trusted(self, start_ns: int, end_ns: int) -> bool:
        """Whether the IMU measured all along, and not in a way that may yet turn out to be a straight line.

        It has not before the oldest sample that is held, nor after the newest.
        """
        line_start, end = int(self._one["line_start"]), int(self._one["end"])
        if end - 1 - line_start >= SUSPECT_LINE and end_ns > self.samples[line_start]["stamp_ns"]:
            return False
        return not any(piece.is_gap for piece in self.pieces(start_ns, end_ns))

    def check(self, sample: ImuSample) -> Outcome:
        """Say whether a sample can be used; physics and order only, no statistics."""
        fx, fy, fz = sample.specific_force.tolist()  # floats compare ten times faster than arrays reduce
        wx, wy, wz = sample.angular_velocity.tolist()
        force, rate = self._config.accelerometer_range, self._config.gyroscope_range
        # NaN and infinity fail every comparison
        in_range = -force <= fx <= force and -force <= fy <= force and -force <= fz <= force
        if not (in_range and -rate <= wx <= rate and -rate <= wy <= rate and -rate <= wz <= rate):
            finite = all(map(isfinite, (fx, fy, fz, wx, wy, wz)))
            return Outcome.OUT_OF_RANGE if finite else Outcome.NOT_FINITE
        first, end = self._held()
        if first == end:
            return Outcome.USED
        ahead_ns = sample.stamp_ns + self.offset_ns - self.latest_ns
        if 0 < ahead_ns <= self.max_gap_ns:
            self._suspects = self._repeats = 0
            return Outcome.USED
        outcome = self._judge(sample, ahead_ns)
        self._one["is_suspicious"] = self._suspects or self._repeats
        return outcome

    def _judge(self, sample: ImuSample, ahead_ns: int) -> Outcome:
        """One stamp that contradicts its arrival is an error; several that follow each other are a new clock.

        A forward jump contradicts it if the sample were under way for less time than any before.
        """
        stamp_ns = sample.stamp_ns + self.offset_ns
        delay_ns = sample.arrival_ns - stamp_ns
        if ahead_ns > 0 and delay_ns >= self.delay_ns - CLOCK_JUMP_NS:
            self._suspects = self._repeats = 0
            return Outcome.USED  # a silence
        before_ns, self._suspect_ns, self._suspect_arrival_ns = self._suspect_ns, stamp_ns, sample.arrival_ns
        if stamp_ns not in (before_ns, self.latest_ns):
            self._repeats = 0
        elif self._repeats == 0:
            self._repeats_since_ns = self.arrival_ns
        self._repeats += stamp_ns in (before_ns, self.latest_ns)
        follows = self._suspects > 0 and 0 < stamp_ns - before_ns <= self.max_gap_ns
        self._suspects = self._suspects + 1 if follows else 1
        self._suspect_delay_ns = min(delay_ns, self._suspect_delay_ns) if follows else delay_ns
        if abs(ahead_ns) <= CLOCK_JUMP_NS and sample.arrival_ns - self.arrival_ns <= self.max_gap_ns:
            self._suspects = 0  # samples in the wrong order
        if self._suspects >= SUSPECTS_ACCEPTED:
            return Outcome.USED
        if ahead_ns == 0:
            return Outcome.DUPLICATE
        return Outcome.CLOCK_JUMP if ahead_ns > 0 else Outcome.BACKWARD

    @property
    def delay_ns(self) -> int:
        """The shortest time from stamp to arrival of the last samples, whatever their clocks are."""
        return min(int(self._one["delay_ns"]), int(self._one["older_delay_ns"]))

    @property
    def has_new_clock(self) -> bool:
        """Whether the sample that `check` has just let pass is of another clock than those before."""
        return self._suspects >= SUSPECTS_ACCEPTED

    @property
    def is_stuck(self) -> bool:
        """Whether the samples that `check` refused last all had one stamp while time passed: their clock stands."""
        passed_ns = self._suspect_arrival_ns - self._repeats_since_ns
        return self._repeats >= SUSPECTS_ACCEPTED and 2 * passed_ns > self.max_gap_ns

    @property
    def new_clock_behind_ns(self) -> int:
        """By how much a new clock is behind that of the samples before, as the arrivals tell."""
        return self._suspect_delay_ns - self.delay_ns

    def clear(self) -> None:
        """Forget every sample: they are of another clock, or of long ago."""
        for name in ("first", "end", "dropped", "newest_ns", "gaps", "line_start", "is_suspicious", "delays"):
            self._one[name] = 0
        self.blocks["number"] = 0
        self._suspects = self._repeats = 0
        self.forecast.begin_anew()

    def add(self, sample: ImuSample) -> Added:
        """Append a checked sample."""
        self.make_room()
        reading = (*sample.specific_force.tolist(), *sample.angular_velocity.tolist())
        stamp_ns = sample.stamp_ns + self.offset_ns
        flags = take_in(self.record, self.samples, stamp_ns, sample.arrival_ns, reading)
        return Added(flags & STEPPED != 0, self.line_since_ns if flags & IS_LINE else None)

    @property
    def line_since_ns(self) -> int:
        """Start of the run of samples on one line that the newest is on."""
        return int(self.samples[self._one["line_start"]]["stamp_ns"])

    def make_room(self) -> None:
        """Let there be a row for another sample, which has been checked."""
        self._suspects = 0
        first, end = self._held()
        if end < len(self.samples):
            return
        held, blocks = self.samples[first:end], self.blocks
        if end - first > 0.75 * end:
            self.samples = np.zeros(2 * len(self.samples), layout.SAMPLE)
            self.blocks = np.zeros(len(self.samples) // LENGTH + 2, layout.BLOCK)
            for block in blocks[blocks["number"] > 0]:
                self.blocks[(block["number"] - 1) % len(self.blocks)] = block
            self._note_rows()
        self.samples[: end - first] = held
        for name, change in (("first", -first), ("end", -first), ("line_start", -first), ("dropped", first)):
            self._one[name] += change

    def density(self, start_ns: int, end_ns: int) -> Density:
        """Return the white noise that the samples in a time show, or those just before it if it is short.

        Only samples until the end of that time count, in blocks: the answer does not depend on when it is asked for.
        """
        return Density(*find_density(self.record, self.samples, self.blocks, start_ns, end_ns))

    @property
    def sway(self) -> float:
        """Density of what the accelerometer feels and no receiver sees [m/s^2/sqrt(Hz)]: the least of its noise."""
        return float(self._one["sway"])

    @sway.setter
    def sway(self, density: float) -> None:
        self._one["sway"] = density

    def forget_before(self, stamp_ns: int) -> None:
        """Drop samples that no interval after `stamp_ns` needs, many at a time."""
        forget_before(self.record, self.samples, stamp_ns)

    def _row_after(self, stamp_ns: int) -> int:
        row: int = find_row_after(self.record, self.samples, stamp_ns)
        return row

    def stamps_between(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the stamps in (start, end)."""
        stamps: list[int] = self.samples["stamp_ns"][self._row_after(start_ns) : self._row_after(end_ns - 1)].tolist()
        return stamps

    def pieces(self, start_ns: int, end_ns: int) -> list[Piece]:
        """Cut [start, end] where the IMU falls silent or speaks again; past the newest sample all is gap."""
        if not self._one["gaps"] and end_ns <= self.latest_ns and start_ns >= self.oldest_ns:
            return [Piece(start_ns, end_ns, False)]
        cuts: list[Piece] = []
        at_ns = start_ns
        while at_ns < end_ns:
            until_ns, is_gap = find_piece(self.record, self.samples, at_ns, end_ns)
            cuts.append(Piece(at_ns, until_ns, is_gap))
            at_ns = until_ns
        return cuts

    def motion(self, start_ns: int, end_ns: int, bias: Array) -> InertialMotion:
        """Return what the IMU measured in [start, end], which must hold no gap.

        `bias` (6,) is that of the accelerometer [m/s^2] and of the gyroscope [rad/s].
        """
        steps, summed = self._steps(start_ns, end_ns), np.empty(15)
        add_up(steps, len(steps), tuple(bias.tolist()), summed)
        return InertialMotion(summed[:9].reshape(3, 3), summed[9:12], summed[12:])

    def turning(self, start_ns: int, end_ns: int) -> Turning:
        """Return by how much the gyroscope has turned in [start, end], which must hold no gap; biases included."""
        steps = self._steps(start_ns, end_ns)
        return Turning(steps["dt_s"] @ steps["rate"], float(steps["dt_s"].sum()))

    def _steps(self, start_ns: int, end_ns: int) -> Any:
        steps = np.empty(self._row_after(end_ns) - self._row_after(start_ns) + 2, layout.STEP)
        return steps[: fill_steps(self.record, self.samples, start_ns, end_ns, steps)]

    def steps(self, start_ns: int, end_ns: int) -> list[Step]:
        """Return the steps that fill [start, end], which must hold no gap."""
        steps = self._steps(start_ns, end_ns)
        return [Step(*one) for one in zip(steps["dt_s"].tolist(), steps["force"], steps["rate"], strict=True)]

    def readings(self, start_ns: int, end_ns: int) -> tuple[Array, Array, Array]:
        """Return the mean forces (N, 3) [m/s^2], rates (N, 3) [rad/s] and lengths (N,) [s] of the steps in a time.

        They fill [start, end], which must hold no gap.
        """
        steps = self._steps(start_ns, end_ns)
        return steps["force"], steps["rate"], steps["dt_s"]

    def angular_velocity(self, stamp_ns: int) -> Array:
        """Return the reading of the gyroscope (3,) [rad/s] at a time: interpolated, or the last one before it."""
        return np.array(find_rate(self.record, self.samples, stamp_ns))

    def window(self, start_ns: int, end_ns: int) -> tuple[Array, Array] | None:
        """Return specific force and angular velocity (N, 3) in [start, end], or None if the IMU was silent in it."""
        i, j = self._row_after(start_ns - 1), self._row_after(end_ns)
        held = self.samples[i:j]
        if j - i < 4 or start_ns < self.oldest_ns or held["is_gap"].any():
            return None
        return held["force"].copy(), held["rate"].copy()
