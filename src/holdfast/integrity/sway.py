"""How far the IMU says that the machine sways where positions see nothing of it.

An engine that turns nearly as often as the IMU measures is folded to a slow swing: no noise from sample to sample, and
no bias. Judged by it every other sensor lies. It needs no estimate, not even an attitude, as `scatter` does not.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.integrity.point_motion import (
    SAME_M,
    Motions,
    divided_difference,
    motions_between,
    times_of,
    white_acceleration,
)
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import Position, Role, Sensor, of_role

COMPARED = 5  # positions: under a fourth difference a constant bias of the gyroscope, which tilts gravity, cancels, too
STEP_NS, MOST_NS = 450_000_000, 4_500_000_000  # between two of them, and in which five must lie
WAITING = 12  # positions, of which the newest may be ahead of the IMU
MEMORY, ENOUGH = 12, 8  # fives
QUANTILE, OF_CHANCE = 0.25, 0.404  # this quantile of chi-square with three degrees of freedom, over three
KEPT = 0.98  # of the squared density, from one five to the next: what swings is at rest now and then
RECENT_NS = 10_000_000_000
LEAST = 0.15  # density [m/s^2/sqrt(Hz)]: of less, no estimate is lost
ARM_M = 3.0  # by which the point may be elsewhere: what turns then seems to sway
NEWS = 2.0  # times what was told last


class Felt(NamedTuple):
    """What the IMU felt of the motion of a point, and what positions of it saw.

    Attributes:
        moved: (3,) by the IMU, that it is compared with [m].
        by_arm: (3, 3) its derivative by where the point is.
        seen: the squared length of what the positions moved by [m^2].
        variance: per axis, where the acceleration is white noise of density 1 [m^2].
    """

    moved: Array
    by_arm: Array
    seen: float
    variance: float

    @classmethod
    def of(cls, times_s: Array, motions: Motions, p_I_P: Array, track: Array) -> "Felt":
        """Return that of positions (N, 3) at times (N,), given how the IMU has moved meanwhile."""
        weights = divided_difference(times_s)
        seen = weights @ track
        variance = white_acceleration(times_s, weights).sum()
        by_arm = np.einsum("k,kij->ij", weights, motions.R)
        return cls(weights @ motions.of_point(p_I_P), by_arm, float(seen @ seen), float(variance))


def unseen(felt: Iterable[Felt]) -> Array:
    """Return the squared densities (N,) that a motion would need beyond what was seen of it [m^2/s^3].

    The point is where the least of it is felt.
    """
    moved, by_arm, seen, variance = (np.array(one) for one in zip(*felt, strict=True))
    weighed = by_arm / variance[:, None, None]
    information = np.einsum("nij,nik->jk", weighed, by_arm) + np.eye(3) / ARM_M**2
    arm = -np.linalg.solve(information, np.einsum("nij,ni->j", weighed, moved))
    squared = ((moved + by_arm @ arm) ** 2).sum(axis=1)
    densities: Array = (squared - seen) / (3.0 * variance)
    return densities


class Sway:
    """The squared density [m^2/s^3] of what the accelerometer feels and one receiver does not see: (96).

    Args:
        buffer: of the IMU's samples.
        p_I_P: (3,) the point whose positions come.

    Attributes:
        seen_ns: stamp of the newest position that told something.
        density: it; 0 where positions see as much, None where too few have told.
    """

    def __init__(self, buffer: ImuBuffer, p_I_P: Array) -> None:
        self._buffer, self._p_I_P = buffer, p_I_P
        self._newest = deque[Position](maxlen=WAITING)
        self._felt = deque[Felt](maxlen=MEMORY)
        self.seen_ns = NEVER_NS
        self.density: float | None = None

    def add(self, position: Position) -> bool:
        """Take in a position as it arrives; return whether it told something."""
        if self._newest and position.stamp_ns <= self._newest[-1].stamp_ns - STEP_NS:
            self._newest.clear()  # by another clock
            self.seen_ns = NEVER_NS
        if not self._newest or position.stamp_ns >= self._newest[-1].stamp_ns + STEP_NS:
            self._newest.append(position)
        measured = [one for one in self._newest if one.stamp_ns <= self._buffer.latest_ns][-COMPARED:]
        if len(measured) < COMPARED or measured[-1].stamp_ns <= self.seen_ns:
            return False
        felt = self._felt_between(measured)
        if felt is None:
            return False
        self.seen_ns = measured[-1].stamp_ns
        self._felt.append(felt)
        if len(self._felt) >= ENOUGH:
            found = np.sort(unseen(self._felt))[int(QUANTILE * len(self._felt))] / OF_CHANCE
            self.density = max(float(found), KEPT * (self.density or 0.0))
        return True

    def _felt_between(self, positions: Sequence[Position]) -> Felt | None:
        """Return what was felt between positions; None if nobody knows, or if they are all the same."""
        track, times_s = np.array([one.p_W_P for one in positions]), times_of(positions)
        if times_s[-1] > MOST_NS * 1e-9 or (np.ptp(track, axis=0) < SAME_M).all():
            return None
        motions = motions_between(self._buffer, positions)
        return None if motions is None else Felt.of(times_s, motions, self._p_I_P, track)


class Sways:
    """What no receiver sees of what the accelerometer feels; who asks the buffer for its noise is told.

    Args:
        sensors: all models, by name.
        buffer: of the IMU's samples.
        log: where is told that there is something.
        imu: name of the IMU.
    """

    def __init__(self, sensors: Mapping[str, Sensor], buffer: ImuBuffer, log: EventLog, imu: str) -> None:
        self._receivers = {name: Sway(buffer, one.p_I_P) for name, one in of_role(sensors, Role.POSITION).items()}
        self._buffer, self._log, self._imu = buffer, log, imu
        self._told, self._is_new = LEAST, False
        buffer.sway = 0.0

    def newly_told(self) -> bool:
        """Whether something was told since this was asked last."""
        is_new, self._is_new = self._is_new, False
        return is_new

    def add(self, position: Position) -> None:
        """Take in a position as it arrives."""
        if not self._receivers[position.sensor].add(position):
            return
        newest_ns = max(one.seen_ns for one in self._receivers.values())
        recent = [one.density for one in self._receivers.values() if one.seen_ns > newest_ns - RECENT_NS]
        squared = min((one for one in recent if one is not None), default=0.0)
        density = sqrt(squared) if squared > LEAST**2 else 0.0
        self._buffer.sway = density
        if density > self._told * NEWS:
            self._told, self._is_new = density, True
            reason = f"its accelerometer swings as no receiver sees the machine do, by {density:.1f} m/s^2/sqrt(Hz)"
            self._log.report(EventKind.NOISE, position.stamp_ns, self._imu, reason)
