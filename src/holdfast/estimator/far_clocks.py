"""Clocks that cannot be right: so far ahead of the IMU's, or behind it, that no transport explains it.

A receiver in GPS time is 18 s ahead, the clock of a computer that nobody has set is off by years. When a message
arrives is known all the same, and by how much it is late is nearly the same each time: its stamp is read by a clock
that is off by that. What transport takes is part of it, which is found as any other clock that is off.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from statistics import median
from types import MappingProxyType

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.messages import Message
from holdfast.sensors.clock import measured_later

EARLY_NS, LATE_NS = 500_000_000, 12_000_000_000  # by which what is measured may arrive before the IMU's, and after it
COUNT, SPAN_NS = 5, 2_000_000_000  # messages in a row that are off alike, for so long
RECENT = 16  # messages, of which the transport is known
ALIKE_NS = 500_000_000  # by which transport takes longer at times; and clocks that are nearer are one
LEAP_NS = (18_000_000_000, 37_000_000_000)  # of GPS and TAI before UTC


@dataclass(slots=True)
class _Seen:
    """A sensor's clock, and what would be another one.

    `early_ns` is added to its stamps; by `late_ns` the newest of them are behind the IMU then. By `off_ns` the newest
    in a row that cannot be right are, `since_ns` is the arrival of the first of these.
    """

    early_ns: int = 0
    late_ns: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT))
    off_ns: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT))
    since_ns: int = 0

    @property
    def usual_ns(self) -> int:
        """By how much stamps are behind that are right; 0 before the first."""
        return round(median(self.late_ns)) if self.late_ns else 0


class FarClocks:
    """Reads the stamps of all sensors beside the IMU.

    Args:
        log: where is told whose clock is far off.
        known: what was added to stamps before, by sensor [ns]; a clock that has been set since shows it.
    """

    def __init__(self, log: EventLog, known: Mapping[str, int] = MappingProxyType({})) -> None:
        self._log = log
        self._seen = {name: _Seen(early_ns) for name, early_ns in known.items()}
        self._is_moved = False

    def learnt(self) -> dict[str, int]:
        """Return what is added to stamps, by sensor [ns]."""
        return {name: one.early_ns for name, one in self._seen.items() if one.early_ns}

    def late_s(self, sensor: str) -> float:
        """Return by how much the stamps of a sensor, as read, use to be behind the IMU when they arrive [s]."""
        seen = self._seen.get(sensor)
        return 0.0 if seen is None else seen.usual_ns * 1e-9

    def move(self, sensors: Iterable[str], by_ns: int) -> None:
        """Know that the stamps of some sensors, as read, are early by so much: what came with them was not late."""
        for name in sensors:
            seen = self._seen.setdefault(name, _Seen())
            seen.early_ns += by_ns
            seen.late_ns = deque((one - by_ns for one in seen.late_ns), RECENT)
        self._is_moved = True

    def newly_moved(self) -> bool:
        """Whether stamps were moved since this was asked last."""
        is_moved, self._is_moved = self._is_moved, False
        return is_moved

    def read(self, message: Message, behind_ns: int, offset_ns: int = 0) -> Message:
        """Return a message by the IMU's clock; the same one where its own is not far from that, or nobody knows yet.

        Args:
            message: in the order of arrival.
            behind_ns: by how much its stamp is behind the IMU at its arrival, with what is configured to be added.
            offset_ns: what that is.
        """
        seen = self._seen.setdefault(message.sensor, _Seen())
        now_ns = message.stamp_ns + offset_ns + behind_ns
        usual_ns = seen.usual_ns
        early_ns = min(seen.early_ns, 0, key=lambda early_ns: abs(behind_ns - early_ns - usual_ns))
        late_ns = behind_ns - early_ns
        if min(0, usual_ns) - EARLY_NS <= late_ns <= LATE_NS:
            if early_ns != seen.early_ns:
                seen.early_ns = early_ns
                self._report(message, now_ns, "stamps agree with the IMU's again")
            seen.off_ns.clear()
            seen.late_ns.append(late_ns)
        else:
            self._doubt(seen, message, behind_ns, now_ns)
        return measured_later(message, seen.early_ns)

    def _doubt(self, seen: _Seen, message: Message, behind_ns: int, now_ns: int) -> None:
        """Take in a stamp that cannot be right by what is known; know another clock if those before say the same."""
        if not seen.off_ns or abs(behind_ns - median(seen.off_ns)) > ALIKE_NS:
            seen.off_ns.clear()
            seen.since_ns = message.arrival_ns
        seen.off_ns.append(behind_ns)
        if len(seen.off_ns) < COUNT or message.arrival_ns - seen.since_ns < SPAN_NS:
            return
        seen.early_ns, self._is_moved = self._off_ns(seen), True
        seen.off_ns.clear()
        apart = f"{abs(seen.early_ns) * 1e-9:.3f} s {'behind' if seen.early_ns > 0 else 'ahead of'} the IMU's"
        reason = (
            f"stamps are {apart}: read by a clock that is off by that (`time_offset_s` sets it right from the start)"
        )
        self._report(message, now_ns, reason)

    def _off_ns(self, seen: _Seen) -> int:
        """Return by how much a clock is behind the IMU's: as another that is off alike, by leap seconds, or as seen."""
        off_ns = round(median(seen.off_ns)) - seen.usual_ns
        known = [one.early_ns for one in self._seen.values() if one is not seen and one.early_ns]
        leaps = [sign * leap_ns for leap_ns in LEAP_NS for sign in (-1, 1)]
        return next((one for one in (*known, *leaps) if abs(off_ns - one) <= ALIKE_NS), off_ns)

    def _report(self, message: Message, now_ns: int, reason: str) -> None:
        self._log.report(EventKind.CLOCK_STEP, now_ns, message.sensor, reason)
