"""What became of every measurement, and what a user may ask about later."""

from collections import Counter
from math import nan
from typing import NamedTuple

from holdfast.events import Event, EventKind, Outcome
from holdfast.messages import Array


class MeasurementRecord(NamedTuple):
    """What became of one measurement. One that is decided again has another record; the last one counts.

    Attributes:
        stamp_ns: when it was taken.
        nis: normalised innovation squared, (21) in docs/math.md; NaN where it was not tested, or not anew.
        dof: degrees of freedom of the NIS; 0 where there is none.
        limit: on the NIS, beyond which the gate refuses it.
        p_W_P: (3,) measured position in W [m], of a measurement that is one.
    """

    stamp_ns: int
    sensor: str
    outcome: Outcome
    nis: float = nan
    dof: int = 0
    limit: float = nan
    p_W_P: Array | None = None


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
        self._records: list[MeasurementRecord] | None = None

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

    def keep_records(self) -> None:
        """Keep a record of every measurement from now on, for someone who takes them."""
        self._records = self._records or []

    def record(
        self,
        stamp_ns: int,
        sensor: str,
        outcome: Outcome,
        nis: float = nan,
        dof: int = 0,
        *,
        limit: float = nan,
        p_W_P: Array | None = None,
    ) -> None:
        """Record what became of a measurement, if anyone wants to know."""
        if self._records is not None:
            self._records.append(MeasurementRecord(stamp_ns, sensor, outcome, nis, dof, limit, p_W_P))

    def take_records(self) -> list[MeasurementRecord]:
        """Return the records since the last call; none unless `keep_records` was called."""
        taken, self._records = self._records or [], None if self._records is None else []
        return taken

    def report(self, kind: EventKind, stamp_ns: int, sensor: str, reason: str) -> None:
        """Keep an event."""
        self.event_counts[kind] += 1
        self.events.append(Event(stamp_ns, kind, sensor, reason))

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self.events = self.events, []
        return events
