"""Which stamps of the sensors beside the IMU can be right, by the IMU's clock, and since when those of one cannot."""

from collections import Counter

from holdfast.config.model import GraphConfig
from holdfast.estimator.far_clocks import LATE_NS, FarClocks
from holdfast.estimator.stamp_faults import StampFaults
from holdfast.estimator.window_length import WindowLength
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.messages import Message
from holdfast.sensors.even_stamps import EvenStamps
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.stamp_filter import StampFilter


class StampCheck:
    """Checks stamps, and tells when those of a sensor go astray and when they agree again.

    Attributes:
        window: follows how late measurements are.
        even: gives receivers the stamps at which they measure.
        faults: tells which stamps stand still.

    Args:
        buffer: of the IMU's samples.
        log: where events go.
        graph: how long its window is at least.
        clocks: reads those that are far off.
    """

    def __init__(self, buffer: ImuBuffer, log: EventLog, graph: GraphConfig, clocks: FarClocks) -> None:
        self._buffer, self._log, self._clocks = buffer, log, clocks
        self.faults = StampFaults()
        self.window = WindowLength(graph, log)
        self.even = EvenStamps(log)
        self._filter = StampFilter()
        self._astray: Counter[str] = Counter()  # stamps in a row that contradict the IMU's clock, by sensor

    def _behind_ns(self, message: Message, stamp_ns: int) -> int | None:
        """Return by how much a stamp is behind the IMU's clock at its arrival; None where no sample has come."""
        reached_ns = self._buffer.latest_ns
        if not reached_ns:
            return None
        return reached_ns + max(0, message.arrival_ns - self._buffer.arrival_ns) - stamp_ns

    def read(self, message: Message, offset_ns: int) -> Message:
        """Return a message with the stamp that it should have, given what is configured to be added to that later."""
        behind_ns = self._behind_ns(message, message.stamp_ns + offset_ns)
        return self.even.read(message if behind_ns is None else self._clocks.read(message, behind_ns, offset_ns))

    def check(self, message: Message, stamp_ns: int) -> Outcome:
        """Say whether the stamp of a message, time offset applied, can be right."""
        name, buffer = message.sensor, self._buffer
        outcome = self._filter.check(name, stamp_ns, message.arrival_ns, buffer.latest_ns, buffer.arrival_ns)
        behind_ns = self._behind_ns(message, stamp_ns) or 0
        self.faults.note(name, message.stamp_ns)
        if outcome is Outcome.USED and behind_ns > LATE_NS:
            outcome = Outcome.LATE
        if outcome is Outcome.USED:
            self.window.note(name, behind_ns, stamp_ns)
            if self._astray.pop(name, 0) > 1 and name not in self._clocks.learnt():
                self._report(name, "stamps agree with the IMU's again")
        elif outcome is not Outcome.DUPLICATE:
            self._astray[name] += 1
            if self._astray[name] == 2:
                apart = f"{abs(behind_ns) * 1e-9:.3f} s {'ahead of' if behind_ns < 0 else 'behind'}"
                self._report(name, f"stamps are {apart} the IMU's: refused")
        return outcome

    def is_told(self, name: str, outcome: Outcome) -> bool:
        """Whether an event has told already why the stamps of a sensor are refused."""
        return self._astray[name] > 1 and outcome in (Outcome.CLOCK_JUMP, Outcome.LATE)

    def _report(self, name: str, reason: str) -> None:
        self._log.report(EventKind.CLOCK_STEP, self._buffer.latest_ns, name, reason)
