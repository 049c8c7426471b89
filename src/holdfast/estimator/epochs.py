"""Measurements of one instant that arrive one after the other are waited for, so that one update takes in all of them.

Two antennas and the heading of one receiver measure together but are sent one by one: an update for each of them would
linearise, eliminate and judge the same node three times.
"""

from holdfast.graph.nodes import to_grid

MAX_WAIT_NS = 20_000_000  # from the first of them to the last
RECENT = 8  # epochs, of several groups of sensors perhaps


class Epochs:
    """Which sensors measured together last, and who of them is missing now."""

    def __init__(self) -> None:
        self._first_ns: dict[int, int] = {}  # arrival of the first measurement of an epoch, by its stamp
        self._newest: dict[str, int] = {}  # stamp by sensor, without those that came too late to be waited for
        self._before: int | None = None  # stamp of the epoch before the one that is waited for
        self._until_ns = 0  # arrival

    def add(self, sensor: str, stamp_ns: int, arrival_ns: int) -> None:
        """Note a measurement, in the order of arrival."""
        stamp = to_grid(stamp_ns)
        until_ns = self._first_ns.setdefault(stamp, arrival_ns) + MAX_WAIT_NS
        if len(self._first_ns) > RECENT:
            del self._first_ns[next(iter(self._first_ns))]
        before = self._newest.pop(sensor, None)
        if before in self._newest.values():
            self._before, self._until_ns = before, until_ns
        if arrival_ns <= until_ns:
            self._newest[sensor] = stamp

    def is_incomplete(self, now_ns: int) -> bool:
        """Whether to wait for a sensor that measured together with others the last time; `now_ns` is an arrival."""
        is_in_time = self._until_ns - MAX_WAIT_NS <= now_ns < self._until_ns
        return is_in_time and self._before in self._newest.values()
