"""What became of every measurement, and what a user may ask about later."""

from collections import Counter

from holdfast.state import Event, EventKind, Outcome


class EventLog:
    """Counts the outcomes, keeps the events until they are taken.

    Args:
        imu: name of the sensor whose used samples `samples` counts.
    """

    def __init__(self, imu: str) -> None:
        self.samples = 0  # of the IMU that were used, counted apart because it is done at every one
        self.imu = imu
        self._counts: Counter[tuple[str, Outcome]] = Counter()
        self.event_counts: Counter[EventKind] = Counter()
        self.events: list[Event] = []

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """How many measurements of each sensor had which outcome."""
        if self.samples:
            self._counts[self.imu, Outcome.USED] += self.samples
            self.samples = 0
        return self._counts

    def count(self, sensor: str, outcome: Outcome, number: int = 1) -> None:
        """Count measurements of a sensor by what became of them; a negative number corrects an earlier count."""
        self._counts[sensor, outcome] += number

    def recount(self, sensor: str, before: Outcome, outcome: Outcome) -> None:
        """Correct what became of a measurement that was counted before."""
        self.count(sensor, before, -1)
        self.count(sensor, outcome)

    def report(self, kind: EventKind, stamp_ns: int, sensor: str, reason: str) -> None:
        """Keep an event."""
        self.event_counts[kind] += 1
        self.events.append(Event(stamp_ns, kind, sensor, reason))

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self.events = self.events, []
        return events
