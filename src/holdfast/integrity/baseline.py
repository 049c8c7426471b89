"""The distance between two antennas: as mounted, or one of their fixes is wrong."""

from itertools import combinations
from math import sqrt

import numpy as np

from holdfast.messages import Array
from holdfast.sensors.sensor import Position, PositionSensor

PAIRED_NS = 1_000_000  # in which even a fast machine moves by less than a fix is wrong
BASELINE_SIGMA = 4.0
BASELINE_SLACK_M = 0.02  # calibration of the mounting


class BaselineTest:
    """Compares positions of one instant pair by pair.

    Args:
        sensors: their models, by name.
    """

    def __init__(self, sensors: dict[str, PositionSensor]) -> None:
        self._mounted_m = {
            frozenset((a.name, b.name)): float(np.linalg.norm(b.p_I_P - a.p_I_P))
            for a, b in combinations(sensors.values(), 2)
        }
        self._last: dict[str, tuple[Position, float]] = {}  # with its NIS

    def contradicted(self, position: Position, nis: float) -> Position | None:
        """Return which of two simultaneous positions is the worse one, if their distance is wrong: this or another."""
        self._last[position.sensor] = position, nis
        for other, other_nis in self._last.values():
            if other.sensor == position.sensor or abs(other.stamp_ns - position.stamp_ns) > PAIRED_NS:
                continue
            if not self._agrees(position, other):
                return position if nis >= other_nis else other
        return None

    def _agrees(self, one: Position, other: Position) -> bool:
        between: Array = other.p_W_P - one.p_W_P
        distance = float(np.linalg.norm(between))
        axis = between / max(distance, 1e-9)
        sigma = sqrt(float(axis @ (one.covariance + other.covariance) @ axis))
        mounted_m = self._mounted_m[frozenset((one.sensor, other.sensor))]
        return abs(distance - mounted_m) <= BASELINE_SIGMA * sigma + BASELINE_SLACK_M
