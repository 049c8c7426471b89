"""The clock of the estimator: continuous time, whatever the clock of the IMU does.

The estimator's time goes on with that of the IMU. Where the stamps of the IMU step and the arrivals say how much time
has passed all the same, the offset between the two takes the step. Stamps of other sensors are read in whichever clock
the IMU has had makes them as old as they use to be, so it does not matter which sensors step with it, or when.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import gtsam

from holdfast.event_log import EventLog, MeasurementRecord
from holdfast.events import Event, EventKind
from holdfast.messages import ImuSample, Message
from holdfast.sensors.clock import measured_later
from holdfast.sensors.imu import CLOCK_JUMP_NS, ImuBuffer
from holdfast.state import NOTHING, OptimisedState, Output

MAX_SILENCE_NS = 60_000_000_000  # of the IMU that is crossed: after more, where the machine was tells nothing of it
CLOCKS = 4  # of the past that are remembered
AGE_STEP_NS = 10_000_000  # by which one message may change how old those of its sensor use to be


class Clock:
    """Maps stamps to continuous time and back; until the IMU's clock steps the two are the same.

    Args:
        buffer: of the IMU's samples, in continuous time.
        log: where events go.
    """

    def __init__(self, buffer: ImuBuffer, log: EventLog) -> None:
        self._buffer, self._log = buffer, log
        self.offset_ns = 0  # of the IMU's stamps against continuous time
        self._known = deque([0], CLOCKS)
        self._since: deque[tuple[int, int]] = deque(maxlen=CLOCKS)  # times and offsets from then on
        self._ages_ns: dict[str, int] = {}
        self._stuck_ns = 0

    @property
    def has_stepped(self) -> bool:
        """Whether stamps and continuous time differ."""
        return bool(self._since)

    # --- into continuous time ----------------------------------------------------------------------------------------

    def read(self, message: Message) -> Message:
        """Return a message of a sensor other than the primary IMU in continuous time."""
        buffer, name = self._buffer, message.sensor
        if not buffer.latest_ns:
            return message
        now_ns = buffer.latest_ns + max(0, message.arrival_ns - buffer.arrival_ns)
        usual_ns = self._ages_ns.get(name, 0)
        offset_ns, age_ns = 0, now_ns - message.stamp_ns
        if self._since:
            offset_ns = min(self._known, key=lambda offset_ns: abs(age_ns + offset_ns - usual_ns))
            age_ns += offset_ns
        if name in self._ages_ns:
            age_ns = min(max(age_ns, usual_ns - AGE_STEP_NS), usual_ns + AGE_STEP_NS)
        if abs(age_ns) < MAX_SILENCE_NS:
            self._ages_ns[name] = age_ns
        return measured_later(message, -offset_ns)

    def read_sample(self, sample: ImuSample) -> ImuSample:
        """Return a sample of the primary IMU in continuous time, by the clock that it has had until now."""
        return replace(sample, stamp_ns=sample.stamp_ns - self.offset_ns)

    def step(self, sample: ImuSample) -> ImuSample | None:
        """Take the step of the IMU's clock before a sample; None if the arrivals do not say how much time has passed.

        Args:
            sample: the first of the new clock that the buffer lets pass, read by the old one.
        """
        buffer = self._buffer
        if not 0 <= sample.arrival_ns - buffer.arrival_ns <= MAX_SILENCE_NS:
            return None
        step_ns = -buffer.new_clock_behind_ns
        offset_ns = self.offset_ns + step_ns
        newest_ns = buffer.latest_ns - buffer.offset_ns
        known_ns = min(self._known, key=lambda known_ns: abs(known_ns - offset_ns))
        if abs(known_ns - offset_ns) < CLOCK_JUMP_NS and known_ns != self.offset_ns:
            offset_ns = known_ns  # back to a clock that others may have kept
        stamp_ns = max(sample.stamp_ns + self.offset_ns - offset_ns, newest_ns + 1)
        way = "ahead" if step_ns > 0 else "back"
        reason = f"the stamps have stepped {way} by {abs(step_ns) * 1e-9:.2f} s: the state is carried over"
        self._log.report(EventKind.CLOCK_STEP, stamp_ns, sample.sensor, reason)
        if not self._since:
            self._since.append((0, 0))
        self._since.append((stamp_ns, offset_ns))
        if offset_ns in self._known:
            self._known.remove(offset_ns)
        self._known.append(offset_ns)
        self.offset_ns = offset_ns
        return replace(sample, stamp_ns=stamp_ns)

    def by_arrival(self, sample: ImuSample) -> ImuSample | None:
        """Return a sample whose stamp stands still at the time that its arrival says; None if it says nothing."""
        buffer = self._buffer
        stamp_ns = sample.arrival_ns - buffer.delay_ns - buffer.offset_ns
        if not 0 < stamp_ns - (buffer.latest_ns - buffer.offset_ns) <= MAX_SILENCE_NS:
            return None
        if self._stuck_ns != sample.stamp_ns:
            self._stuck_ns = sample.stamp_ns
            reason = "the stamps stand still: samples are taken at the times of their arrival"
            self._log.report(EventKind.CLOCK_STEP, stamp_ns, sample.sensor, reason)
        return replace(sample, stamp_ns=stamp_ns)

    # --- back to stamps ----------------------------------------------------------------------------------------------

    def stamp(self, time_ns: int) -> int:
        """Return the stamp that the clock of the IMU showed at a continuous time."""
        for since_ns, offset_ns in reversed(self._since):
            if time_ns >= since_ns:
                return time_ns + offset_ns
        return time_ns + (self._since[0][1] if self._since else 0)

    def output(self, output: Output) -> Output:
        """Return an output with stamps."""
        if not self._since or output is NOTHING:
            return output
        estimate, base = output.estimate, output.base
        return Output(
            None if estimate is None else estimate._replace(stamp_ns=self.stamp(estimate.stamp_ns)),
            self.optimised(output.optimised),
            self.smoothed(output.smoothed),
            None if base is None else base._replace(stamp_ns=self.stamp(base.stamp_ns)),
        )

    def optimised(self, state: OptimisedState | None) -> OptimisedState | None:
        """Return an optimised state with its stamp."""
        return None if state is None else replace(state, stamp_ns=self.stamp(state.stamp_ns))

    def smoothed(self, nodes: Sequence[tuple[int, gtsam.NavState]]) -> list[tuple[int, gtsam.NavState]]:
        """Return smoothed nodes with their stamps."""
        return [(self.stamp(time_ns), nav) for time_ns, nav in nodes]

    def events(self, events: list[Event]) -> list[Event]:
        """Return events with their stamps; the same list where that changes nothing."""
        return [replace(one, stamp_ns=self.stamp(one.stamp_ns)) for one in events] if self._since else events

    def records(self, records: list[MeasurementRecord]) -> list[MeasurementRecord]:
        """Return records with their stamps; the same list where that changes nothing."""
        return [one._replace(stamp_ns=self.stamp(one.stamp_ns)) for one in records] if self._since else records
