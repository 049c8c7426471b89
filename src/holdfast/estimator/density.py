"""Bounds the work that a sensor causes: so many of its measurements to a second of their stamps are taken in.

Each may become a node of the graph, and an update costs what the nodes in the window cost. Who sends thousands a second
would have every update take seconds, in a replay too, where nobody drops what is late.
"""

from collections import defaultdict

from holdfast.config.model import Config
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome

TELL_NS = 1_000_000_000
SLOT = 4  # measurements to one slot of time: jitter may put two of them where one belongs
SLOTS = 4096  # that are remembered of each sensor: 80 s at 200 Hz, longer than a measurement may be late


class Shedding:
    """Counts what is left out of a sensor's measurements, and tells it once a second.

    Args:
        rate_hz: at which all would be taken in.
        log: where to count and to report.
    """

    def __init__(self, sensor: str, rate_hz: float, log: EventLog) -> None:
        self._sensor, self._rate_hz, self._log = sensor, rate_hz, log
        self._told_ns: int | None = None  # arrival
        self._untold = 0

    def add(self, number: int, arrival_ns: int, stamp_ns: int) -> None:
        """Count measurements that are left out at an arrival; `stamp_ns` is that of the event."""
        self._log.count(self._sensor, Outcome.OVERLOAD, number)
        self._untold += number
        if self._told_ns is None or not 0 <= arrival_ns - self._told_ns < TELL_NS:
            reason = f"{self._untold} measurements left out: more than {self._rate_hz:g} a second come"
            self._log.report(EventKind.OVERLOAD, stamp_ns, self._sensor, reason)
            self._told_ns, self._untold = arrival_ns, 0


class Density:
    """How many measurements each sensor has in slots of time, by their stamps and in whatever order they come.

    Args:
        config: `realtime.max_rate_hz`.
        log: where to count and to report.
    """

    def __init__(self, config: Config, log: EventLog) -> None:
        self._rate_hz, self._log = config.realtime.max_rate_hz, log
        self._slot_ns = max(1, round(SLOT / self._rate_hz * 1e9))
        self._counts: defaultdict[str, dict[int, int]] = defaultdict(dict)
        self._shedding: dict[str, Shedding] = {}

    def admits(self, sensor: str, stamp_ns: int, arrival_ns: int) -> bool:
        """Return whether a measurement may be taken in, and count it as left out if not."""
        counts, slot = self._counts[sensor], stamp_ns // self._slot_ns
        count = counts.get(slot, 0)
        if count >= SLOT:
            if sensor not in self._shedding:
                self._shedding[sensor] = Shedding(sensor, self._rate_hz, self._log)
            self._shedding[sensor].add(1, arrival_ns, stamp_ns)
            return False
        counts[slot] = count + 1
        if len(counts) > SLOTS:
            del counts[next(iter(counts))]
        return True
