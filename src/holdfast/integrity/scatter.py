"""How far positions scatter beside what the IMU measured: what a receiver claims is believed up to that.

It needs no estimate, not even an attitude, so that a start can use it: one whose fixes are ten times worse than they
claim finds everything else at odds with them.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.integrity.point_motion import SAME_M, divided_difference, motions_between, times_of
from holdfast.integrity.sway import Sways
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.even_stamps import EvenStamps
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import Measurement, Position, Role, Sensor, of_role

COMPARED = 4  # positions: of three, nothing is left beside a start, a velocity and an acceleration
WAITING = 24  # positions, of which the newest may be ahead of the IMU
MOST_NS = 2_500_000_000  # in which four positions tell anything: in more, what wanders looks like noise
MEMORY, ENOUGH = 48, (12, 24)  # fours; horizontal and vertical, as what follows
QUANTILES = 0.25, 0.35  # positions that are elsewhere now and then do not count
OF_CHANCE = 0.575, 0.206  # these quantiles of chi-square, with two degrees of freedom and one
BEGINS, ENDS = 2.5**2, 1.5**2  # of the factor that is believed: less may be chance
KEPT = 0.98  # of the factor, from one four to the next: by motion, less is seen
NEWS = 2.0  # times the sigma that was told last


class Scatter:
    """The factors on the variances that one receiver claims, horizontal and vertical: (94) in docs/math.md.

    Args:
        buffer: of the IMU's samples.
        p_I_P: (3,) the point whose positions come.
    """

    def __init__(self, buffer: ImuBuffer, p_I_P: Array) -> None:
        self._buffer, self._p_I_P = buffer, p_I_P
        self._newest = deque[tuple[Position, int]](maxlen=WAITING)  # and by how much its stamp is later than even
        self._compared_ns = NEVER_NS
        self._squares = tuple(deque[float](maxlen=MEMORY) for _ in QUANTILES)
        self._factors = np.ones(2)

    @property
    def factors(self) -> Array:
        """(3,) on the variances of east, north and up."""
        return self._factors[[0, 0, 1]]

    def add(self, position: Position, uneven_ns: int = 0) -> tuple[float, float] | None:
        """Take in a position as it arrives, as the receiver claims it, with what its stamp was later than it is now.

        Return the squares of what the newest scatter by at the stamps that were given and at even ones, where that is
        known and these are others.
        """
        if self._newest and position.stamp_ns <= self._newest[-1][0].stamp_ns:
            self._newest.clear()  # late, or by another clock
            self._compared_ns = NEVER_NS
        self._newest.append((position, uneven_ns))
        measured = [one for one in self._newest if one[0].stamp_ns <= self._buffer.latest_ns][-COMPARED:]
        if len(measured) < COMPARED or measured[-1][0].stamp_ns <= self._compared_ns:
            return None
        even = [one for one, _ in measured]
        self._compared_ns = even[-1].stamp_ns
        squares = self._squares_of(even)
        if squares is None:
            return None
        self._note(squares)
        if not any(by_ns for _, by_ns in measured):
            return None
        at_given = self._squares_of([replace(one, stamp_ns=one.stamp_ns + by_ns) for one, by_ns in measured])
        return None if at_given is None else (float(at_given[0]), float(squares[0]))

    def _squares_of(self, positions: Sequence[Position]) -> Array | None:
        if positions[-1].stamp_ns - positions[0].stamp_ns > MOST_NS:
            return None
        found = motions_between(self._buffer, positions)
        return None if found is None else beyond(positions, found.of_point(self._p_I_P))

    def _note(self, squares: Array) -> None:
        for k, (held, square) in enumerate(zip(self._squares, squares, strict=True)):
            if np.isnan(square):
                continue
            held.append(square)
            if len(held) >= ENOUGH[k]:
                seen = sorted(held)[int(QUANTILES[k] * len(held))] / OF_CHANCE[k]
                factor = max(seen, KEPT * self._factors[k])
                least = BEGINS if self._factors[k] == 1.0 else ENDS
                self._factors[k] = factor if factor > least else 1.0


def beyond(positions: Sequence[Position], motion: Array) -> Array:
    """Return the squares (2,) of what positions scatter beyond the motion of their point, over the variance claimed.

    Compared is the combination of norm 1 in which no parabola is left, and with it neither the velocity nor gravity;
    horizontal and vertical. Where the numbers are all the same, as of rounded ones or repeated ones, it is nan.
    """
    weights = divided_difference(times_of(positions))
    motion_m = float(np.linalg.norm(weights @ motion))  # in whatever direction
    track = np.array([one.p_W_P for one in positions])
    is_same, residual = np.ptp(track, axis=0) < SAME_M, weights @ track
    variances = np.mean([one.covariance.diagonal() for one in positions], axis=0)
    squares = np.full(2, np.nan)
    for k, axes in enumerate((slice(0, 2), slice(2, 3))):
        if not is_same[axes].all():
            squares[k] = max(float(np.linalg.norm(residual[axes])) - motion_m, 0.0) ** 2 / variances[axes].mean()
    return squares


class Scatters:
    """The scatter of all receivers of positions, and the sway that none of them sees.

    Args:
        sensors: all models, by name.
        buffer: of the IMU's samples.
        log: where is told what scatters by more than it claims, and what sways.
        imu: name of the IMU.
    """

    def __init__(self, sensors: Mapping[str, Sensor], buffer: ImuBuffer, log: EventLog, imu: str) -> None:
        self._sensors, self._buffer, self._log, self._imu = sensors, buffer, log, imu
        self.forget()

    def forget(self) -> None:
        """Know nothing of what was compared until now."""
        points = of_role(self._sensors, Role.POSITION)
        self._receivers = {name: Scatter(self._buffer, one.p_I_P) for name, one in points.items()}
        self._sways = Sways(self._sensors, self._buffer, self._log, self._imu)
        self._told = dict.fromkeys(self._receivers, 1.0)

    def newly_swaying(self) -> bool:
        """Whether the accelerometer was found to sway, or by much more, since this was asked last."""
        return self._sways.newly_told()

    def weighed(self, position: Measurement, scales: Mapping[str, NoiseScale], stamps: EvenStamps) -> Measurement:
        """Return a measurement as it arrives, a position with the covariance that is believed; its scale is told."""
        if not isinstance(position, Position):
            return position
        self._sways.add(position)
        name = position.sensor
        squares = self._receivers[name].add(position, stamps.moved_ns(name))
        if squares is not None:
            stamps.judge(name, *squares, position.stamp_ns)
        factors = self._receivers[name].factors
        most = sqrt(factors.max())
        if not self._told[name] / NEWS < most < self._told[name] * NEWS:
            self._told[name] = most
            reason = f"its positions scatter by {most:.1f} times what they claim"
            self._log.report(EventKind.NOISE, position.stamp_ns, name, reason)
        scales[name].weigh(factors[0])
        if most == 1.0:
            return position
        times = np.sqrt(factors)
        return replace(position, covariance=position.covariance * np.outer(times, times))
