"""Whether velocities lead where positions do, without an estimate.

A receiver whose velocities are in other axes, late, of another sign or always zero claims no less than a good one.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from holdfast.estimator.course import UNKNOWN_VARIANCE
from holdfast.sensors.sensor import Position, Velocity

# of the way, and of the noise of two positions: in 316 pieces of five drives good receivers missed half of it at most
ELSEWHERE, ELSEWHERE_SIGMA = 0.1, 3.0
PIECE_NS = 5_000_000_000  # in which the past is looked at


class VelocityCheck:
    """Knows the sensors of velocity that led elsewhere than the positions when the past was looked at."""

    def __init__(self) -> None:
        self._lying: set[str] = set()

    def look_back(self, velocities: Sequence[Velocity], positions: Sequence[Position]) -> None:
        """Leave out from now on what leads elsewhere than the positions of one receiver in a piece of the past."""
        pieces: dict[int, list[Position]] = {}
        for one in positions:
            pieces.setdefault(one.stamp_ns // PIECE_NS, []).append(one)
        for piece in pieces.values():
            inside = [one for one in velocities if piece[0].stamp_ns < one.stamp_ns <= piece[-1].stamp_ns]
            self._lying |= _leading_elsewhere(inside, piece)

    def credible(
        self, velocities: Sequence[Velocity], positions: Sequence[Position]
    ) -> tuple[list[Velocity], list[str]]:
        """Return velocities, and the sensors whose velocities are left out: they lead elsewhere, now or in the past.

        Args:
            velocities: sorted by stamp.
            positions: of one receiver, sorted by stamp.
        """
        lying = {one.sensor for one in velocities} & (self._lying | _leading_elsewhere(velocities, positions))
        return [one for one in velocities if one.sensor not in lying], sorted(lying)


def _leading_elsewhere(velocities: Sequence[Velocity], positions: Sequence[Position]) -> set[str]:
    by_sensor: dict[str, list[Velocity]] = {}
    for one in velocities:
        by_sensor.setdefault(one.sensor, []).append(one)
    return {name for name, series in by_sensor.items() if _leads_elsewhere(series, positions)}


def _leads_elsewhere(velocities: Sequence[Velocity], positions: Sequence[Position]) -> bool:
    """Whether the velocities of one sensor lead elsewhere than the positions of one receiver."""
    if len(positions) < 2:
        return False
    stamps_ns = np.array([one.stamp_ns for one in velocities])
    at_ns = np.array([one.stamp_ns for one in positions])
    inside = (stamps_ns >= at_ns[0]) & (stamps_ns <= at_ns[-1])
    if inside.sum() < 2:
        return False
    t = (stamps_ns[inside] - at_ns[0]) * 1e-9
    track = np.array([one.p_W_P for one in positions])
    speeds = np.array([one.v_W_P for one in velocities])[inside]
    known = np.max([one.covariance.diagonal() for one in velocities], axis=0) < UNKNOWN_VARIANCE
    ends = np.column_stack([np.interp(t[[0, -1]], (at_ns - at_ns[0]) * 1e-9, axis) for axis in track.T])
    moved, led = (ends[1] - ends[0])[known], np.trapezoid(speeds, t, axis=0)[known]
    noise_m = ELSEWHERE_SIGMA * sqrt(sum(float(np.trace(one.covariance)) for one in (positions[0], positions[-1])))
    way_m = max(np.linalg.norm(moved), np.trapezoid(np.linalg.norm(speeds[:, known], axis=1), t))
    return bool(np.linalg.norm(moved - led) > noise_m + ELSEWHERE * way_m)
