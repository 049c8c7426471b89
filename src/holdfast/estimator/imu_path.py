"""The half of the estimator that answers at IMU rate: it never waits for the other half, which optimises."""

from typing import Any, NamedTuple

from holdfast.chassis.kinematics import BaseKinematics
from holdfast.config.model import Config
from holdfast.estimator.clock import MAX_SILENCE_NS, Clock
from holdfast.estimator.predictor import NO_RING, Predictor
from holdfast.event_log import EventLog
from holdfast.kernel.imu_path import (
    CHASSIS_IS_UNSOUND,
    ENCODER_FLAG,
    FROM_IMU,
    HAS_CHASSIS,
    HAS_ESTIMATE,
    IS_SOUND,
    REFUSED,
)
from holdfast.kernel.samples import IS_LINE, STEPPED
from holdfast.measured_fields import check_message
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import BaseState, Estimate, EventKind, OptimisedState, Outcome


class Received(NamedTuple):
    """What a usable sample of the IMU brought.

    Attributes:
        sample: in continuous time.
        has_step: the IMU measured all along since the sample before.
        before_ns: stamp of the sample before, 0 at the first.
        line_since_ns: start of the straight line that it makes certain, if there is one.
        begins_anew: nothing of before is known at its time.
        is_usual: it followed the one before as samples do, and is in the ring, if there is one.
        estimate: the state at it; None before the start, or where the state is ahead.
        is_sound: whether the estimate is finite; what is not must never get out.
        base: the state of the chassis at the estimate, if it is known.
    """

    sample: ImuSample
    has_step: bool
    before_ns: int
    line_since_ns: int | None
    begins_anew: bool
    is_usual: bool = False
    estimate: Estimate | None = None
    is_sound: bool = True
    base: BaseState | None = None


def receive(buffer: ImuBuffer, sample: ImuSample, *, begins_anew: bool = False) -> Received:
    """Append a checked sample; where the clock has gone back or one begins anew, nothing of before is kept."""
    before_ns = buffer.latest_ns
    begins_anew = _clear_if_behind(buffer, sample, begins_anew=begins_anew)
    has_step, line_since_ns = buffer.add(sample)
    return Received(sample, has_step, before_ns, line_since_ns, begins_anew)


def _clear_if_behind(buffer: ImuBuffer, sample: ImuSample, *, begins_anew: bool) -> bool:
    begins_anew |= sample.stamp_ns + buffer.offset_ns < buffer.latest_ns
    if begins_anew:
        buffer.clear()
    return begins_anew


class ImuPath:
    """Checks samples, propagates the newest optimised state to them, and carries it on to the chassis.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        log: where counts and events go.
        ring: rows shared with another process, as integers and as doubles, into which usual samples are written.
    """

    def __init__(self, config: Config, buffer: ImuBuffer, log: EventLog, ring: tuple[Any, Any] = NO_RING) -> None:
        self._config = config
        self._buffer = buffer
        self._log = log
        self._serves_chassis = {one[0] for one in (config.joint, config.base_imu) if one is not None}
        self._predictor = Predictor(config, buffer, ring)
        self.clock = Clock(buffer, log)
        self._carry_chassis()

    def _carry_chassis(self) -> None:
        """Begin with a chassis of which nothing is known."""
        self._chassis = BaseKinematics(self._config, self._log)
        self._predictor.carry(self._chassis)

    @property
    def is_running(self) -> bool:
        """Whether estimates are being given."""
        return self._predictor.is_running

    @property
    def has_imu(self) -> bool:
        """Whether the IMU measured until the newest sample."""
        return self._predictor.has_imu

    def serves_chassis(self, sensor: str) -> bool:
        """Whether a sensor is the encoder or the IMU of the chassis."""
        return sensor in self._serves_chassis

    def process(self, sample: ImuSample, number: int = 0, epoch: int = 0) -> Received | None:
        """Take in a sample and carry the state to it; None if it cannot be used.

        Args:
            sample: in the order of arrival.
            number: of its row in the ring.
            epoch: for that row.

        Raises:
            MessageError: the readings are no numbers.
        """
        clock, before_ns = self.clock, self._buffer.latest_ns
        read = clock.read_sample(sample) if clock.offset_ns else sample
        try:
            flags = self._predictor.process(read, number, epoch)
        except (TypeError, ValueError):  # an array of the right shape that is not made of numbers
            check_message(sample, sample.QUANTITIES)
            raise
        if flags == REFUSED:
            return self._process_unusual(sample, read)
        return self._received(read, before_ns, flags, is_usual=True)

    def _process_unusual(self, sample: ImuSample, read: ImuSample) -> Received | None:
        """Take in a sample that does not follow the one before as usual, if it can be used."""
        buffer, clock = self._buffer, self.clock
        outcome, latest_ns = buffer.check(read), buffer.latest_ns
        if outcome is not Outcome.USED:
            by_arrival = clock.by_arrival(read) if buffer.is_stuck else None
            if by_arrival is None:
                self._log.count(sample.sensor, outcome)
                return None
            read = by_arrival
        elif buffer.has_new_clock:
            carried = clock.step(read) if self.is_running else None
            if carried is None:
                return self._begin_anew(sample)
            read = carried
        elif read.stamp_ns + buffer.offset_ns - latest_ns > MAX_SILENCE_NS and self._is_lost_at(read):
            return self._begin_anew(sample)
        return self._take(read, begins_anew=False)

    def _is_lost_at(self, sample: ImuSample) -> bool:
        """Whether the motion before a sample is unknown for too long: no samples, and no measurements instead."""
        latest_ns = self._buffer.latest_ns
        reached_ns = max(latest_ns, self._predictor.stamp_ns) if self.is_running else latest_ns
        return latest_ns > 0 and sample.stamp_ns + self._buffer.offset_ns - reached_ns > MAX_SILENCE_NS

    def _begin_anew(self, sample: ImuSample) -> Received:
        """Take in a sample of which nobody knows how long after the one before it was measured."""
        self.stop()
        self.clock = Clock(self._buffer, self._log)
        return self._take(sample, begins_anew=True)

    def _take(self, sample: ImuSample, *, begins_anew: bool) -> Received:
        before_ns = self._buffer.latest_ns
        begins_anew = _clear_if_behind(self._buffer, sample, begins_anew=begins_anew)
        return self._received(sample, before_ns, self._predictor.process_checked(sample), begins_anew=begins_anew)

    def _received(
        self, sample: ImuSample, before_ns: int, flags: int, *, is_usual: bool = False, begins_anew: bool = False
    ) -> Received:
        self._log.samples += 1
        line_since_ns = self._buffer.line_since_ns if flags & IS_LINE else None
        brought = sample, flags & STEPPED != 0, before_ns, line_since_ns, begins_anew, is_usual
        if not flags & HAS_ESTIMATE:
            return Received(*brought)
        stamp_ns, values = self._buffer.latest_ns, self._predictor.values.copy()
        estimate = Estimate(stamp_ns, values, flags & FROM_IMU != 0)
        if not flags & IS_SOUND:
            reason = "the estimate is not finite: starting over"
            self._log.report(EventKind.OPTIMISER_FAULT, stamp_ns, "", reason)
            return Received(*brought, estimate, is_sound=False)
        encoder = self._chassis.note(stamp_ns, flags // ENCODER_FLAG)
        base = BaseState(stamp_ns, values, encoder) if flags & HAS_CHASSIS else None
        if flags & CHASSIS_IS_UNSOUND:
            reason = "the state of the chassis is not finite: begun anew"
            self._log.report(EventKind.OPTIMISER_FAULT, stamp_ns, "", reason)
            self._carry_chassis()
        return Received(*brought, estimate, True, base)

    def add_to_chassis(self, message: ImuSample | JointAngle) -> None:
        """Take in a reading of a sensor of the chassis or the turn joint."""
        self._chassis.add(message, self._buffer.arrival_ns)

    def count(self) -> None:
        """Count what became of the readings of the chassis until now."""
        self._chassis.count()

    def release_ring(self) -> None:
        """Let go of the memory that is shared with another process."""
        self._predictor.release_ring()

    def start(self, state: OptimisedState, gravity: float) -> None:
        """Begin with a first state, gravity in m/s^2."""
        self._predictor.begin(state, gravity)

    def anchor(self, state: OptimisedState, *, is_recovery: bool) -> None:
        """Continue from a new optimised state."""
        self._predictor.anchor(state, is_recovery=is_recovery)

    def settle(self) -> OptimisedState:
        """Let the propagated state take the place of the optimised one, and return it."""
        return self._predictor.settle()

    def stop(self) -> None:
        """Give no estimates until the next start."""
        self._predictor.stop()
