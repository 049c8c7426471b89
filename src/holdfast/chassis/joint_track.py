"""The angle of the turn joint at the times of measurements, as the encoder read it: for sensors on the chassis."""

from bisect import bisect_left, insort
from math import remainder, tau

from holdfast.chassis.encoder import JointModel
from holdfast.events import Outcome
from holdfast.messages import JointAngle
from holdfast.sensors.sensor import Joint

MEMORY_NS = 30_000_000_000


class JointTrack:
    """The readings of the last seconds, linear in between; an encoder counts on beyond half a turn, or wraps."""

    def __init__(self, encoder: JointModel) -> None:
        self._encoder = encoder
        self._readings: list[tuple[int, float]] = []  # stamp [ns] and angle [rad]

    def add(self, reading: JointAngle) -> None:
        """Take in a reading."""
        if self._encoder.check(reading) is not Outcome.USED:
            return
        insort(self._readings, (reading.stamp_ns + self._encoder.offset_ns, self._encoder.angle(reading)))
        if self._readings[-1][0] - self._readings[0][0] > 2 * MEMORY_NS:
            del self._readings[: bisect_left(self._readings, (self._readings[-1][0] - MEMORY_NS, 0.0))]

    def at(self, stamp_ns: int) -> Joint | None:
        """Return the joint at a time; None where no reading is near enough."""
        k = bisect_left(self._readings, (stamp_ns, 0.0))
        k = min(max(k, 1), len(self._readings) - 1)
        if k < 1:
            return None
        (before_ns, before_rad), (after_ns, after_rad) = self._readings[k - 1], self._readings[k]
        reach_ns = self._encoder.max_age_ns
        if not before_ns - reach_ns <= stamp_ns <= after_ns + reach_ns or not 0 < after_ns - before_ns <= 2 * reach_ns:
            return None
        rate = remainder(after_rad - before_rad, tau) / ((after_ns - before_ns) * 1e-9)
        return Joint(before_rad + rate * (stamp_ns - before_ns) * 1e-9, rate)
