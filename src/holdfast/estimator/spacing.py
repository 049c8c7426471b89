"""How far apart in time the measurements of a sensor come."""

from holdfast.measured_fields import NEVER_NS


class Spacing:
    """The time between measurements, as the newest three say; a silence is none.

    Attributes:
        spacing_ns: 0 until they do.
    """

    def __init__(self) -> None:
        self.spacing_ns = 0
        self._newest_ns = NEVER_NS
        self._before_ns = 0

    def add(self, stamp_ns: int) -> None:
        """Take in the stamp of a measurement; what comes late says nothing."""
        if stamp_ns <= self._newest_ns:
            return
        since_ns = 0 if self._newest_ns == NEVER_NS else stamp_ns - self._newest_ns
        self.spacing_ns = min(self._before_ns, since_ns)
        self._newest_ns, self._before_ns = stamp_ns, since_ns
