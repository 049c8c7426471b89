"""The IMU: which samples can be used, and where it was silent.

Between two samples the readings are taken as linear in time, so that an interval may be cut at any instant. A drop-out
(missing samples, or samples that a logger drew as a straight line) is a gap: a constant-twist motion model stands in.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from math import isfinite, sqrt
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from holdfast.config.sensors import InertialConfig
from holdfast.messages import Array, ImuSample
from holdfast.sensors.preintegration import CALM, Density, Step
from holdfast.sensors.vibration import BLOCK, block_density
from holdfast.state import Outcome

SUSPECT_LINE = 3  # so many steps on one line happen by chance once in a long while
FROZEN_FACTOR = 10  # a reading that does not change at all for this many gap lengths is a dead sensor
PERIOD_WINDOW = 64
LINE_TOLERANCE = 1e-3  # of the change per sample; six channels of a living sensor never agree that well
CLOCK_JUMP_NS = 250_000_000  # a stamp that differs from its arrival by this much more than those before is suspect
SUSPECTS_ACCEPTED = 3
DELAY_WINDOW = 64  # samples over whose shortest delay the next are judged; twice as many at most


class Added(NamedTuple):
    """What a sample made certain.

    Attributes:
        step: to it from the sample before; None where the IMU was silent.
        line_since_ns: start of the straight line that the samples until now lie on, if this one makes it certain.
    """

    step: Step | None
    line_since_ns: int | None


class Piece(NamedTuple):
    """A stretch of time in which the IMU either measured throughout or was silent throughout."""

    start_ns: int
    end_ns: int
    is_gap: bool


_Reading = tuple[float, float, float, float, float, float]  # specific force, angular velocity


class ImuBuffer:
    """The usable samples of the last seconds, cut at will and aware of drop-outs."""

    def __init__(self, config: InertialConfig) -> None:
        self._config = config
        self.offset_ns = round(config.time_offset_s * 1e9)
        self._stamps: list[int] = []
        self._forces: list[Array] = []
        self._rates: list[Array] = []
        self._mean_steps: list[Step | None] = []  # to each sample from the one before, None over a silence
        self._readings: list[_Reading] = []  # the same as floats, ten times faster to compare
        self._dropped = 0  # samples since the last `clear` that are held no more
        self._densities: dict[int, Density] = {}  # by block
        self._is_gap: list[bool] = []  # of the interval that ends at the sample of the same index
        self._gaps = 0  # intervals with is_gap set: lets `pieces` skip the search in the usual case
        self._periods_ns: list[int] = []
        self._max_gap_ns = round(config.max_gap_s * 1e9)
        self._ranges = config.accelerometer_range, config.gyroscope_range
        self._line_start = 0
        self._arrival_ns = 0
        self._suspect_ns = self._suspect_arrival_ns = self._suspect_delay_ns = self._suspects = 0
        self._repeats = self._repeats_since_ns = 0
        self._delay_ns = self._older_delay_ns = self._delays = 0

    @property
    def arrival_ns(self) -> int:
        """When the newest sample arrived."""
        return self._arrival_ns

    @property
    def latest_ns(self) -> int:
        """Stamp of the newest sample, time offset applied; 0 before the first."""
        return self._stamps[-1] if self._stamps else 0

    @property
    def oldest_ns(self) -> int:
        """Stamp of the oldest sample that is still held; 0 before the first."""
        return self._stamps[0] if self._stamps else 0

    @property
    def max_gap_ns(self) -> int:
        """Silence longer than this is a drop-out: the configured bound, or 2.5 sample periods if that is more."""
        return self._max_gap_ns

    def is_trusted(self, start_ns: int, end_ns: int) -> bool:
        """Whether the IMU measured all along, and not in a way that may yet turn out to be a straight line."""
        on_line = len(self._stamps) - 1 - self._line_start >= SUSPECT_LINE
        if on_line and end_ns > self._stamps[self._line_start]:
            return False
        return not any(piece.is_gap for piece in self.pieces(start_ns, end_ns))

    def check(self, sample: ImuSample) -> Outcome:
        """Say whether a sample can be used; physics and order only, no statistics."""
        fx, fy, fz = sample.specific_force.tolist()  # floats compare ten times faster than arrays reduce
        wx, wy, wz = sample.angular_velocity.tolist()
        force, rate = self._ranges
        # NaN and infinity fail every comparison
        in_range = -force <= fx <= force and -force <= fy <= force and -force <= fz <= force
        if not (in_range and -rate <= wx <= rate and -rate <= wy <= rate and -rate <= wz <= rate):
            finite = all(map(isfinite, (fx, fy, fz, wx, wy, wz)))
            return Outcome.OUT_OF_RANGE if finite else Outcome.NOT_FINITE
        if not self._stamps:
            return Outcome.USED
        ahead_ns = sample.stamp_ns + self.offset_ns - self._stamps[-1]
        if 0 < ahead_ns <= self._max_gap_ns:
            self._suspects = self._repeats = 0
            return Outcome.USED
        return self._judge(sample, ahead_ns)

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
        if stamp_ns not in (before_ns, self._stamps[-1]):
            self._repeats = 0
        elif self._repeats == 0:
            self._repeats_since_ns = self._arrival_ns
        self._repeats += stamp_ns in (before_ns, self._stamps[-1])
        follows = self._suspects > 0 and 0 < stamp_ns - before_ns <= self._max_gap_ns
        self._suspects = self._suspects + 1 if follows else 1
        self._suspect_delay_ns = min(delay_ns, self._suspect_delay_ns) if follows else delay_ns
        if abs(ahead_ns) <= CLOCK_JUMP_NS and sample.arrival_ns - self._arrival_ns <= self._max_gap_ns:
            self._suspects = 0  # samples in the wrong order
        if self._suspects >= SUSPECTS_ACCEPTED:
            return Outcome.USED
        if ahead_ns == 0:
            return Outcome.DUPLICATE
        return Outcome.CLOCK_JUMP if ahead_ns > 0 else Outcome.BACKWARD

    @property
    def delay_ns(self) -> int:
        """The shortest time from stamp to arrival of the last samples, whatever their clocks are."""
        return min(self._delay_ns, self._older_delay_ns)

    @property
    def has_new_clock(self) -> bool:
        """Whether the sample that `check` has just let pass is of another clock than those before."""
        return self._suspects >= SUSPECTS_ACCEPTED

    @property
    def is_stuck(self) -> bool:
        """Whether the samples that `check` refused last all had one stamp while time passed: their clock stands."""
        passed_ns = self._suspect_arrival_ns - self._repeats_since_ns
        return self._repeats >= SUSPECTS_ACCEPTED and 2 * passed_ns > self._max_gap_ns

    @property
    def new_clock_behind_ns(self) -> int:
        """By how much a new clock is behind that of the samples before, as the arrivals tell."""
        return self._suspect_delay_ns - self.delay_ns

    def clear(self) -> None:
        """Forget every sample: they are of another clock, or of long ago."""
        for series in self._series():
            series.clear()
        self._dropped = 0
        self._densities.clear()
        self._gaps = self._line_start = self._suspects = self._repeats = self._delays = 0

    def _series(self) -> tuple[list[Any], ...]:
        readings = self._forces, self._rates, self._mean_steps, self._readings
        return self._stamps, *readings, self._is_gap

    def add(self, sample: ImuSample) -> Added:
        """Append a checked sample."""
        stamp, force, rate = sample.stamp_ns + self.offset_ns, sample.specific_force, sample.angular_velocity
        reading: _Reading = (*force.tolist(), *rate.tolist())
        self._arrival_ns, self._suspects = sample.arrival_ns, 0
        self._learn_delay(sample.arrival_ns - stamp)
        step, is_gap = None, False
        if self._stamps:
            dt_ns = stamp - self._stamps[-1]
            is_gap = dt_ns > self._max_gap_ns
            if not is_gap:
                step = _mean_step(dt_ns * 1e-9, reading, self._readings[-1])
                self._learn_period(dt_ns)
        self._stamps.append(stamp)
        self._forces.append(force)
        self._rates.append(rate)
        self._mean_steps.append(step)
        self._readings.append(reading)
        self._is_gap.append(is_gap)
        self._gaps += is_gap
        is_line, line_since_ns = self._on_straight_line(is_gap)
        return Added(None if is_line else step, line_since_ns)

    def _learn_delay(self, delay_ns: int) -> None:
        if self._delays % DELAY_WINDOW == 0:
            self._older_delay_ns = self._delay_ns if self._delays else delay_ns
            self._delay_ns = delay_ns
        elif delay_ns < self._delay_ns:
            self._delay_ns = delay_ns
        self._delays += 1

    def _learn_period(self, dt_ns: int) -> None:
        self._periods_ns.append(dt_ns)
        if len(self._periods_ns) == PERIOD_WINDOW:
            self._max_gap_ns = max(round(self._config.max_gap_s * 1e9), round(2.5 * median(self._periods_ns)))
            self._periods_ns.clear()

    def density(self, start_ns: int, end_ns: int) -> Density:
        """Return the white noise that the samples in a time show, or those just before it if it is short.

        Only samples until the end of that time count, in blocks: the answer does not depend on when it is asked for.
        """
        first = (self._dropped + bisect_left(self._stamps, start_ns)) // BLOCK
        last = (self._dropped + bisect_right(self._stamps, end_ns)) // BLOCK - 1
        found = [density for block in range(min(first, last), last + 1) if (density := self._block(block)) is not None]
        if not found:
            return CALM
        return Density(*(sqrt(sum(one * one for one in each) / len(found)) for each in zip(*found, strict=True)))

    def _block(self, block: int) -> Density | None:
        """Return what a block shows; None where the IMU was silent in it, or its samples are gone."""
        if block not in self._densities:
            k = block * BLOCK - self._dropped
            if k < 0 or any(self._is_gap[k : k + BLOCK]):
                return None
            self._densities[block] = block_density(self._stamps[k : k + BLOCK], self._readings[k : k + BLOCK])
        return self._densities[block]

    def _on_straight_line(self, after_gap: bool) -> tuple[bool, int | None]:
        """Follow the run of samples that lie on one line in all six channels, and mark it as a gap once it is certain.

        Returns:
            Whether the newest sample is on such a line, and the start of the line if that has just become certain.
        """
        last = len(self._stamps) - 1
        if after_gap or last < 2:
            self._line_start = last
            return False, None
        before, middle, newest = self._readings[-3:]
        if _bends(before, middle, newest, 1.0):
            t0, t1, t2 = self._stamps[-3:]
            if t2 - t1 == t1 - t0 or _bends(before, middle, newest, (t2 - t1) / (t1 - t0)):
                self._line_start = last - 1  # on a line neither by index nor by time, whichever a logger goes by
                return False, None
        start = self._line_start
        needed = self._max_gap_ns
        if not (self._rates[-1] - self._rates[start]).any() and not (self._forces[-1] - self._forces[start]).any():
            needed *= FROZEN_FACTOR
        if last - start < 3 or self._stamps[last] - self._stamps[start] <= needed:
            return False, None
        line_since_ns = None if self._is_gap[last - 1] else self._stamps[start]
        for k in range(last, start, -1):
            if self._is_gap[k]:
                break
            self._is_gap[k] = True
            self._gaps += 1
        return True, line_since_ns

    def forget_before(self, stamp_ns: int) -> None:
        """Drop samples that no interval after `stamp_ns` needs; cheap, because it drops many at a time."""
        k = bisect_right(self._stamps, stamp_ns) - 1
        if k > 1000 or (k > 0 and self._stamps[k] - self._stamps[0] > 10_000_000_000):
            self._gaps -= sum(self._is_gap[:k])
            self._line_start = max(0, self._line_start - k)
            for series in self._series():
                del series[:k]
            self._dropped += k
            oldest = self._dropped // BLOCK
            self._densities = {block: one for block, one in self._densities.items() if block >= oldest}

    def stamps_between(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the stamps in (start, end)."""
        return self._stamps[bisect_right(self._stamps, start_ns) : bisect_left(self._stamps, end_ns)]

    def pieces(self, start_ns: int, end_ns: int) -> list[Piece]:
        """Cut [start, end] where the IMU falls silent or speaks again; past the newest sample all is gap."""
        if not self._gaps and end_ns <= self.latest_ns and start_ns >= self.oldest_ns:
            return [Piece(start_ns, end_ns, False)]
        cuts: list[Piece] = []
        at = start_ns
        for k in range(bisect_right(self._stamps, start_ns), len(self._stamps)):
            if at >= end_ns:
                break
            until, is_gap = min(self._stamps[k], end_ns), k == 0 or self._is_gap[k]
            if cuts and cuts[-1].is_gap == is_gap:
                cuts[-1] = Piece(cuts[-1].start_ns, until, is_gap)
            else:
                cuts.append(Piece(at, until, is_gap))
            at = until
        if at < end_ns:
            start = cuts.pop().start_ns if cuts and cuts[-1].is_gap else at
            cuts.append(Piece(start, end_ns, True))
        return cuts

    def steps(self, start_ns: int, end_ns: int) -> list[Step]:
        """Return the steps that fill [start, end], which must hold no gap."""
        return list(self._steps(start_ns, end_ns))

    def _steps(self, start_ns: int, end_ns: int) -> Iterator[Step]:
        at = start_ns
        for k in range(bisect_right(self._stamps, start_ns), len(self._stamps)):
            if at >= end_ns:
                return
            until = min(self._stamps[k], end_ns)
            before, after = self._stamps[k - 1], self._stamps[k]
            whole = self._mean_steps[k]
            if whole is not None and at == before and until == after:
                yield whole
                at = until
                continue
            middle = 0.5 * ((at - before) + (until - before)) / (after - before)
            force = (1.0 - middle) * self._forces[k - 1] + middle * self._forces[k]
            rate = (1.0 - middle) * self._rates[k - 1] + middle * self._rates[k]
            yield Step((until - at) * 1e-9, force, rate)
            at = until
        if at < end_ns:  # a node on the grid may lie a little past the newest sample
            yield Step((end_ns - at) * 1e-9, self._forces[-1], self._rates[-1])

    def latest_force(self) -> Array:
        """Return the specific force (3,) [m/s^2] of the newest sample."""
        return self._forces[-1]

    def latest_rate(self) -> Array:
        """Return the reading of the gyroscope (3,) [rad/s] of the newest sample."""
        return self._rates[-1]

    def angular_velocity(self, stamp_ns: int) -> Array:
        """Return the reading of the gyroscope (3,) [rad/s] at a time: interpolated, or the last one before it."""
        k = bisect_right(self._stamps, stamp_ns)
        if k == len(self._stamps) or self._is_gap[k]:
            return self._rates[k - 1]
        if k == 0:
            return self._rates[0]
        fraction = (stamp_ns - self._stamps[k - 1]) / (self._stamps[k] - self._stamps[k - 1])
        return (1.0 - fraction) * self._rates[k - 1] + fraction * self._rates[k]

    def window(self, start_ns: int, end_ns: int) -> tuple[Array, Array] | None:
        """Return specific force and angular velocity (N, 3) in [start, end], or None if the IMU was silent in it."""
        i, j = bisect_left(self._stamps, start_ns), bisect_right(self._stamps, end_ns)
        if j - i < 4 or start_ns < self.oldest_ns or any(self._is_gap[i:j]):
            return None
        return np.array(self._forces[i:j]), np.array(self._rates[i:j])


def _mean_step(dt_s: float, one: _Reading, other: _Reading) -> Step:
    ax, ay, az, ux, uy, uz = one
    bx, by, bz, vx, vy, vz = other
    force = np.array((0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)))
    return Step(dt_s, force, np.array((0.5 * (ux + vx), 0.5 * (uy + vy), 0.5 * (uz + vz))))


def _bends(before: _Reading, middle: _Reading, last: _Reading, ratio: float) -> bool:
    """Whether three readings do not lie on a line; `ratio` is the second interval over the first (1: by index)."""
    for k in (0, 3):
        ax, ay, az = middle[k] - before[k], middle[k + 1] - before[k + 1], middle[k + 2] - before[k + 2]
        bx, by, bz = last[k] - middle[k], last[k + 1] - middle[k + 1], last[k + 2] - middle[k + 2]
        allowed = LINE_TOLERANCE * max(abs(bx), abs(by), abs(bz)) + 1e-12
        if abs(bx - ratio * ax) > allowed or abs(by - ratio * ay) > allowed or abs(bz - ratio * az) > allowed:
            return True
    return False
