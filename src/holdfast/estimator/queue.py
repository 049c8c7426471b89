"""Checked measurements that wait until the IMU has reached their time, in the order of their stamps."""

from bisect import insort
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from holdfast.sensors.sensor import Measurement


class _Waiting(NamedTuple):
    stamp_ns: int
    order: int
    measurement: Measurement


class MeasurementQueue:
    """Gives measurements back by stamp; of two with one stamp, first the one that came first."""

    def __init__(self) -> None:
        self._waiting: list[_Waiting] = []
        self._order = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def counts(self) -> Counter[str]:
        """Return how many measurements of each sensor wait."""
        return Counter(one.measurement.sensor for one in self._waiting)

    def drain(self) -> list[Measurement]:
        """Return and drop all that wait."""
        drained, self._waiting = [one.measurement for one in self._waiting], []
        return drained

    def push(self, measurement: Measurement) -> None:
        """Let a measurement wait."""
        self._order += 1
        insort(self._waiting, _Waiting(measurement.stamp_ns, self._order, measurement))

    def is_due(self, reached_ns: int) -> bool:
        """Whether a measurement waits whose time has been reached."""
        return bool(self._waiting) and self._waiting[0].stamp_ns <= reached_ns

    def pop_due(self, reached_ns: int) -> Iterator[Measurement]:
        """Yield and drop the measurements whose time has been reached."""
        while self.is_due(reached_ns):
            yield self._waiting.pop(0).measurement
