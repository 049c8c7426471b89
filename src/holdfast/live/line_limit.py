"""Keeps the log of a live node readable, whatever happens how often."""

from dataclasses import dataclass

PERIOD_NS = 10_000_000_000
LINES = 3
"""Of one kind in a period; the rest is counted."""

Subject = tuple[str, str]
"""What a line is about and of what kind it is, such as a sensor and the kind of an event."""


@dataclass(slots=True)
class _Period:
    began_ns: int
    lines: int = 0
    unsaid: int = 0


class LineLimit:
    """Admits a few lines of each kind in a period, and tells afterwards how many there would have been."""

    def __init__(self) -> None:
        self._periods: dict[Subject, _Period] = {}

    def admits(self, subject: Subject, now_ns: int) -> bool:
        """Return whether a line may be printed; if not, it is counted."""
        period = self._periods.setdefault(subject, _Period(now_ns))
        is_admitted = period.lines < LINES
        period.lines += is_admitted
        period.unsaid += not is_admitted
        return is_admitted

    def end(self, now_ns: int) -> list[tuple[Subject, int]]:
        """End the periods that are over, and return the number of lines that were not printed, where there are some."""
        over = {subject: one for subject, one in self._periods.items() if now_ns - one.began_ns >= PERIOD_NS}
        for subject in over:
            del self._periods[subject]
        return [(subject, period.unsaid) for subject, period in over.items() if period.unsaid]
