"""The distance between two antennas: as mounted, or one of their fixes is wrong."""

from math import sqrt

import gtsam
import numpy as np

from holdfast.integrity.lever_arms import PAIRED_NS, LeverArms, variance_along
from holdfast.messages import Array
from holdfast.sensors.sensor import Position

BASELINE_SIGMA = 4.0
BASELINE_SLACK_M = 0.02  # calibration of the mounting


class BaselineTest:
    """Compares positions of one instant pair by pair; `lever_arms` says how far apart they should be, and learns."""

    def __init__(self, lever_arms: LeverArms) -> None:
        self._lever_arms = lever_arms
        self._last: dict[str, tuple[Position, float]] = {}  # with its NIS

    def contradicted(self, position: Position, nis: float, attitude: gtsam.Rot3) -> Position | None:
        """Return which of two simultaneous positions is the worse one, if their distance is wrong: this or another.

        Args:
            position: in the order of stamps.
            nis: of the position.
            attitude: of the machine, whatever its heading is worth.
        """
        self._last[position.sensor] = position, nis
        for other, other_nis in self._last.values():
            if other.sensor == position.sensor or abs(other.stamp_ns - position.stamp_ns) > PAIRED_NS:
                continue
            self._lever_arms.note(position, other, attitude)
            if not self._agrees(position, other):
                return position if nis >= other_nis else other
        return None

    def _agrees(self, one: Position, other: Position) -> bool:
        between: Array = other.p_W_P - one.p_W_P
        distance = float(np.linalg.norm(between))
        sigma = sqrt(variance_along(between, one.covariance + other.covariance))
        mounted_m = self._lever_arms.distance_m(one.sensor, other.sensor)
        return abs(distance - mounted_m) <= BASELINE_SIGMA * sigma + BASELINE_SLACK_M
