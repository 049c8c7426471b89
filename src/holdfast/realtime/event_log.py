"""What both processes have reported, over all optimisers that there were."""

from collections import Counter, deque
from collections.abc import Iterable

import gtsam

from holdfast.event_log import EventLog
from holdfast.events import Event, EventKind, Outcome
from holdfast.realtime.records import unpack_nav
from holdfast.realtime.reports import Report


class EngineLog:
    """Keeps counts and events until they are asked for.

    One thread asks; another may `receive` meanwhile: what it writes is either a deque or replaced as a whole.

    Args:
        log: of the IMU path.
    """

    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._events: deque[Event] = deque()
        self._smoothed: deque[tuple[int, bytes]] = deque()
        self._took_ns: deque[int] = deque()
        self._counts: Counter[tuple[str, Outcome]] = Counter()  # of the optimiser that there is
        self._counts_before: Counter[tuple[str, Outcome]] = Counter()  # of those that have ended
        self._event_counts: Counter[EventKind] = Counter()
        self.waiting_for = "the optimiser process is coming up"
        self.optimiser_cpu_s = 0.0
        self.last_fault = ""

    def receive(self, report: Report | None) -> None:
        """Keep the report of an optimiser; None: it has ended."""
        if report is None:
            self._counts_before, self._counts = self._counts_before + self._counts, Counter()
            return
        self._counts = Counter(report.counts)
        self._smoothed.extend(report.smoothed)
        self._took_ns.extend(report.took_ns)
        self._keep_events(report.events)
        if not report.fault:
            self.waiting_for, self.optimiser_cpu_s = report.waiting_for, report.cpu_s

    def receive_fault(self, stamp_ns: int, why: str, lost: int) -> None:
        """Keep why an optimiser ended, and how many measurements went with it at most."""
        self.last_fault = f"the optimiser process {why}"
        reason = f"{self.last_fault}; up to {lost} measurements are lost with it"
        self._keep_events([Event(stamp_ns, EventKind.OPTIMISER_FAULT, "", reason)])

    def _keep_events(self, events: Iterable[Event]) -> None:
        kept = list(events)
        self._events.extend(kept)
        self._event_counts = self._event_counts + Counter(event.kind for event in kept)

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """How many measurements of each sensor had which outcome."""
        return self._log.counts + self._counts_before + self._counts

    @property
    def event_counts(self) -> Counter[EventKind]:
        """How many events of each kind there were."""
        return self._log.event_counts + self._event_counts

    @property
    def events(self) -> list[Event]:
        """The events that have not been taken."""
        while self._events:
            self._log.events.append(self._events.popleft())
        return self._log.events

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        return self._log.take_events() if self.events else []

    def take_update_times(self) -> list[int]:
        """Return how long each update since the last call took [ns]."""
        return [self._took_ns.popleft() for _ in range(len(self._took_ns))]

    def take_smoothed(self) -> list[tuple[int, gtsam.NavState]]:
        """Return the nodes since the last call that will not change any more, with their stamps."""
        if not self._smoothed:
            return []
        taken = [self._smoothed.popleft() for _ in range(len(self._smoothed))]
        return [(stamp_ns, unpack_nav(packed)) for stamp_ns, packed in taken]
