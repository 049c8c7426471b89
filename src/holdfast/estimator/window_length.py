"""How long the sliding window is: as configured, and longer where sensors are later than that."""

from collections import deque
from heapq import nlargest

from holdfast.config.model import GraphConfig
from holdfast.event_log import EventLog
from holdfast.events import EventKind

RECENT, SEVERAL = 50, 3  # of so many measurements of a sensor, so many that are late are no exception
MOST_NS = 20_000_000_000  # that the window may be long, if it is not configured longer
TOLD_NS = 500_000_000  # by which it has grown


class WindowLength:
    """Follows how late the measurements of each sensor are.

    Attributes:
        now_ns: how long the window is to be.

    Args:
        config: of the graph.
        log: where events go.
    """

    def __init__(self, config: GraphConfig, log: EventLog) -> None:
        self.now_ns = self._configured_ns = self._told_ns = round(config.lag_s * 1e9)
        self._log = log
        self._late_ns: dict[str, deque[int]] = {}
        self._needed_ns: dict[str, int] = {}

    def note(self, sensor: str, late_ns: int, stamp_ns: int) -> None:
        """Take in by how much a measurement is behind the IMU when it arrives.

        Half of what is configured is left before the latest, so that they are smoothed like others.
        """
        late = self._late_ns.setdefault(sensor, deque(maxlen=RECENT))
        late.append(late_ns)
        spare_ns = self._configured_ns // 2
        if late_ns <= spare_ns and sensor not in self._needed_ns:
            return
        bearable = [one for one in late if one + spare_ns <= max(MOST_NS, self._configured_ns)]
        usual_ns = nlargest(SEVERAL, bearable)[-1] if len(bearable) >= SEVERAL else 0
        self._needed_ns[sensor] = usual_ns + spare_ns
        if usual_ns <= spare_ns:
            del self._needed_ns[sensor]
        self.now_ns = max(self._configured_ns, *self._needed_ns.values(), 0)
        if self.now_ns > self._told_ns + TOLD_NS:
            self._told_ns = self.now_ns
            reason = (
                f"{usual_ns * 1e-9:.1f} s late: the window is {self.now_ns * 1e-9:.1f} s long from now on (if its "
                "clock is off, `time_offset_s` sets it right)"
            )
            self._log.report(EventKind.LATE, stamp_ns, sensor, reason)
