"""The half of the estimator that answers at IMU rate: it never waits for the other half, which optimises."""

from typing import NamedTuple

import numpy as np

from holdfast.chassis.kinematics import BaseKinematics
from holdfast.config.model import Config
from holdfast.estimator.clock import MAX_SILENCE_NS, Clock
from holdfast.estimator.predictor import Predictor
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.kernel.imu_path import (
    CHASSIS_IS_UNSOUND,
    ENCODER_FLAG,
    FROM_IMU,
    HAS_CHASSIS,
    HAS_ESTIMATE,
    HAS_NEWS,
    IS_OVERDUE,
    IS_PENDING,
    IS_SOUND,
    REFUSED,
    process,
)
from holdfast.kernel.samples import IS_LINE, STEPPED
from holdfast.messages import Array, ImuSample, JointAngle, Message
from holdfast.sensors.imu import NEWEST, ImuBuffer, as_doubles
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT, LearntJoint
from holdfast.state import BaseState, Estimate, OptimisedState, Output

DOUBLE = np.dtype(np.float64)
NO_FLAGS = -2  # what `process` never returns
NEW = tuple.__new__  # makes a named tuple three times faster than its name
UNUSUAL = IS_LINE | CHASSIS_IS_UNSOUND | IS_OVERDUE  # flags with which there is more to be done


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

    Attributes:
        flags: what came of the newest sample, as `holdfast.kernel.imu_path.process` says.
        address: of the kernel's `PATH`.
        shared: what it knows of another process, a `SHARED`.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        log: where counts and events go.
        learnt: what was learnt of the turn joint before.
    """

    def __init__(
        self, config: Config, buffer: ImuBuffer, log: EventLog, learnt: LearntJoint = NOTHING_OF_JOINT
    ) -> None:
        self._config = config
        self._buffer, self._numbers = buffer, buffer.numbers
        self._log = log
        self._serves_chassis = {one[0] for one in (config.joint, config.base_imu) if one is not None}
        self._predictor = Predictor(config, buffer)
        self.address, self.shared = self._predictor.address, self._predictor.shared
        self._copy_row = self._predictor.copy_row
        self.clock = Clock(buffer, log)
        self.flags = self._usual_flags = NO_FLAGS
        self._carry_chassis(learnt)

    def _carry_chassis(self, learnt: LearntJoint) -> None:
        """Begin with a chassis of which no more is known."""
        self._chassis = BaseKinematics(self._config, self._log, learnt)
        self._predictor.carry(self._chassis)
        self._usual_flags, self._has_base, self._encoder = NO_FLAGS, False, self._chassis.encoder

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

    def answer(self, stamp_ns: int, arrival_ns: int, force: Array, rate: Array) -> Output | None:
        """Take in a sample; return what it led to if that is of the same sort as at the last one, else None.

        Then `flags` say what came of it, and `finish` does what is left to do. No object is looked at here that need
        not be: each costs more than the arithmetic where the caches are cold.

        Args:
            stamp_ns: as the clock of the IMU had it.
            arrival_ns: when it came.
            force: (3,) specific force [m/s^2].
            rate: (3,) angular velocity [rad/s].
        """
        if force.dtype is not DOUBLE or rate.dtype is not DOUBLE:
            force, rate = as_doubles(force, "specific_force"), as_doubles(rate, "angular_velocity")
        flags = process(self.address, stamp_ns, arrival_ns, force, rate, False)
        if flags != self._usual_flags:
            self.flags = flags
            return None
        time_ns, row, base = self._numbers[NEWEST], self._copy_row(), None
        if self._has_base:
            base = NEW(BaseState, (time_ns, row, self._encoder))
        return NEW(Output, (NEW(Estimate, (time_ns, row, True)), None, (), base))

    def process(self, sample: ImuSample) -> Received | None:
        """Take in a sample and carry the state to it; None if it cannot be used.

        Args:
            sample: in the order of arrival.

        Raises:
            MessageError: the readings are no numbers.
        """
        self.flags = self._predictor.process(sample)
        if self.flags == HAS_NEWS:
            self.shared["left"] = 0  # nobody wants it
            self.flags = self._predictor.process(sample)
        return self.finish(sample)

    def finish(self, sample: ImuSample) -> Received | None:
        """Do what is left to do at the newest sample according to `flags`; None if it cannot be used."""
        clock = self.clock
        read = clock.read_sample(sample) if clock.offset_ns else sample
        if self.flags == REFUSED:
            return self._process_unusual(sample, read)
        return self._received(read, self._buffer.before_ns, is_usual=True)

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
        self._chassis.keep_learnt()
        self.clock = Clock(self._buffer, self._log)
        return self._take(sample, begins_anew=True)

    def _take(self, sample: ImuSample, *, begins_anew: bool) -> Received:
        before_ns = self._buffer.latest_ns
        begins_anew = _clear_if_behind(self._buffer, sample, begins_anew=begins_anew)
        self._predictor.read_clock(self.clock.offset_ns)
        self.flags = self._predictor.process(sample, is_checked=True)
        return self._received(sample, before_ns, begins_anew=begins_anew)

    def _received(
        self, sample: ImuSample, before_ns: int, *, is_usual: bool = False, begins_anew: bool = False
    ) -> Received:
        flags = self._predictor.catch_up(self.flags) if self.flags & IS_PENDING else self.flags
        line_since_ns = self._buffer.line_since_ns if flags & IS_LINE else None
        brought = sample, flags & STEPPED != 0, before_ns, line_since_ns, begins_anew, is_usual
        self._usual_flags = NO_FLAGS
        if not flags & HAS_ESTIMATE:
            return Received(*brought)
        stamp_ns, row = self._buffer.latest_ns, self._copy_row()
        estimate = Estimate(stamp_ns, row, flags & FROM_IMU != 0)
        if not flags & IS_SOUND:
            reason = "the estimate is not finite: starting over"
            self._log.report(EventKind.OPTIMISER_FAULT, stamp_ns, "", reason)
            return Received(*brought, estimate, is_sound=False)
        encoder = self._chassis.note(stamp_ns, flags // ENCODER_FLAG)
        base = BaseState(stamp_ns, row, encoder) if flags & HAS_CHASSIS else None
        if flags & CHASSIS_IS_UNSOUND:
            reason = "the state of the chassis is not finite: begun anew"
            self._log.report(EventKind.OPTIMISER_FAULT, stamp_ns, "", reason)
            self._chassis.count()
            self._carry_chassis(NOTHING_OF_JOINT)  # it may have come of what was learnt
        elif flags & FROM_IMU and not flags & UNUSUAL and not self.clock.has_stepped:
            self._usual_flags, self._has_base, self._encoder = flags, base is not None, encoder
        return Received(*brought, estimate, True, base)

    def add_to_chassis(self, message: ImuSample | JointAngle) -> None:
        """Take in a reading of a sensor of the chassis or the turn joint."""
        self._chassis.add(message, self._buffer.arrival_ns)

    def corrected(self, message: Message) -> Message:
        """Return a message as the optimiser is to have it: the encoder's with the zero that was learnt."""
        return self._chassis.corrected(message) if isinstance(message, JointAngle) else message

    def count(self) -> None:
        """Count the samples that were used, and what became of the readings of the chassis until now."""
        self._log.samples += self._predictor.take_count()
        self._chassis.count()

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

    def forget(self) -> None:
        """Give no estimates until the next start, and forget what was learnt of the turn joint."""
        self.stop()
        self._chassis.count()
        self._carry_chassis(NOTHING_OF_JOINT)

    def learnt(self) -> LearntJoint:
        """Return what is known now of the turn joint that holds over a restart."""
        return self._chassis.learnt()
