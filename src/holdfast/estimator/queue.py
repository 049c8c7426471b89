"""Checked measurements that wait until the IMU has reached their time, in the order of their stamps.

An update eliminates all nodes since the oldest of its measurements, and the covariance of that one is read through as
many: 0.1 s of work for what is 2.5 s late on a machine with many sensors. So what is very late, and can wait, waits
for others that are, a tenth of its lateness at most, and one update takes in all of them.
"""

from bisect import insort
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from holdfast.sensors.sensor import Measurement

VERY_LATE_NS = 500_000_000
SHARE = 10  # the part of what a measurement is late, for which it waits for others


class _Waiting(NamedTuple):
    stamp_ns: int
    order: int
    measurement: Measurement


class MeasurementQueue:
    """Gives measurements back by stamp; of two with one stamp, first the one that came first.

    Args:
        longest_ns: what is very late waits no longer for others.
    """

    def __init__(self, longest_ns: int) -> None:
        self._longest_ns = longest_ns
        self._waiting: list[_Waiting] = []
        self._late: list[_Waiting] = []
        self._late_until_ns = 0  # where any wait
        self._order = 0

    def __len__(self) -> int:
        return len(self._waiting) + len(self._late)

    def counts(self) -> Counter[str]:
        """Return how many measurements of each sensor wait."""
        return Counter(one.measurement.sensor for one in self._waiting + self._late)

    def drain(self) -> list[Measurement]:
        """Return and drop all that wait."""
        self.take_late()
        drained, self._waiting = [one.measurement for one in self._waiting], []
        return drained

    def push(self, measurement: Measurement, late_ns: int = 0) -> None:
        """Let a measurement wait; one that can wait for others is so far behind the IMU."""
        self._order += 1
        waiting = _Waiting(measurement.stamp_ns, self._order, measurement)
        if late_ns <= VERY_LATE_NS:
            insort(self._waiting, waiting)
            return
        until_ns = measurement.stamp_ns + late_ns + min(late_ns // SHARE, self._longest_ns)
        self._late_until_ns = min(until_ns, self._late_until_ns) if self._late else until_ns
        self._late.append(waiting)

    def is_due(self, reached_ns: int) -> bool:
        """Whether a measurement waits whose time has been reached, and that waits for no others."""
        if self._late and self._late_until_ns <= reached_ns:
            return True
        return bool(self._waiting) and self._waiting[0].stamp_ns <= reached_ns

    def pop_due(self, reached_ns: int) -> Iterator[Measurement]:
        """Yield and drop the measurements that are due."""
        while self.is_due(reached_ns):
            if self._late_until_ns <= reached_ns:
                self.take_late()
            yield self._waiting.pop(0).measurement

    def take_late(self) -> None:
        """Let what is very late wait for others no longer."""
        for one in self._late:
            insort(self._waiting, one)
        self._late.clear()
