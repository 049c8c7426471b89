"""The half of the estimator that answers at IMU rate: it never waits for the other half, which optimises."""

from math import isfinite

import gtsam
import numpy as np

from holdfast.chassis.kinematics import BaseKinematics
from holdfast.config.model import Config
from holdfast.estimator.clock import MAX_SILENCE_NS, Clock
from holdfast.estimator.predictor import Predictor
from holdfast.event_log import EventLog
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import Step
from holdfast.state import BaseState, Estimate, EventKind, OptimisedState, Outcome, is_finite


class Received:
    """What a usable sample of the IMU brought.

    Attributes:
        sample: in continuous time.
        step: to it from the sample before; None where the IMU was silent.
        before_ns: stamp of the sample before, 0 at the first.
        line_since_ns: start of the straight line that it makes certain, if there is one.
        begins_anew: nothing of before is known at its time.
    """

    __slots__ = ("before_ns", "begins_anew", "line_since_ns", "sample", "step")

    def __init__(
        self, sample: ImuSample, step: Step | None, before_ns: int, line_since_ns: int | None, begins_anew: bool
    ) -> None:
        self.sample = sample
        self.step = step
        self.before_ns = before_ns
        self.line_since_ns = line_since_ns
        self.begins_anew = begins_anew


def receive(buffer: ImuBuffer, sample: ImuSample, *, begins_anew: bool = False) -> Received:
    """Append a checked sample; where the clock has gone back or one begins anew, nothing of before is kept."""
    before_ns = buffer.latest_ns
    begins_anew |= sample.stamp_ns + buffer.offset_ns < before_ns
    if begins_anew:
        buffer.clear()
    step, line_since_ns = buffer.add(sample)
    return Received(sample, step, before_ns, line_since_ns, begins_anew)


class ImuPath:
    """Checks samples, propagates the newest optimised state to them, and carries it on to the chassis.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        log: where counts and events go.
    """

    def __init__(self, config: Config, buffer: ImuBuffer, log: EventLog) -> None:
        self._config = config
        self._buffer = buffer
        self._log = log
        self._base = BaseKinematics(config, log) if config.has_base() else None
        self._T_W_O: gtsam.Pose3 | None = None  # the last that was found to be finite
        self._serves_chassis = {one[0] for one in (config.joint, config.base_imu) if one is not None}
        self.predictor: Predictor | None = None
        self.clock = Clock(buffer, log)
        self.has_imu = True
        self._was_ahead = False  # the state, of the sample before

    def serves_chassis(self, sensor: str) -> bool:
        """Whether a sensor is the encoder or the IMU of the chassis."""
        return sensor in self._serves_chassis

    def receive(self, sample: ImuSample) -> Received | None:
        """Take in a sample; None if it cannot be used."""
        buffer, clock = self._buffer, self.clock
        read = clock.read_sample(sample) if clock.offset_ns else sample
        outcome, latest_ns = buffer.check(read), buffer.latest_ns
        if outcome is not Outcome.USED:
            by_arrival = clock.by_arrival(read) if buffer.is_stuck else None
            if by_arrival is None:
                self._log.count(sample.sensor, outcome)
                return None
            read = by_arrival
        elif buffer.has_new_clock:
            carried = None if self.predictor is None else clock.step(read)
            if carried is None:
                return self._begin_anew(sample)
            read = carried
        elif read.stamp_ns + buffer.offset_ns - latest_ns > MAX_SILENCE_NS and self._is_lost_at(read):
            return self._begin_anew(sample)
        self._log.samples += 1
        return receive(buffer, read)

    def _is_lost_at(self, sample: ImuSample) -> bool:
        """Whether the motion before a sample is unknown for too long: no samples, and no measurements instead."""
        latest_ns, predictor = self._buffer.latest_ns, self.predictor
        reached_ns = latest_ns if predictor is None else max(latest_ns, predictor.stamp_ns)
        return latest_ns > 0 and sample.stamp_ns + self._buffer.offset_ns - reached_ns > MAX_SILENCE_NS

    def _begin_anew(self, sample: ImuSample) -> Received:
        """Take in a sample of which nobody knows how long after the one before it was measured."""
        self.predictor, self.clock = None, Clock(self._buffer, self._log)
        self._log.samples += 1
        return receive(self._buffer, sample, begins_anew=True)

    def propagate(self, received: Received) -> Estimate | None:
        """Carry the state to the sample just received; None before the start, or where the state is ahead."""
        predictor, stamp = self.predictor, self._buffer.latest_ns
        if predictor is None:
            return None
        if stamp <= predictor.stamp_ns:
            self._was_ahead = True  # a measurement in a silent stretch has led the state past this sample
            return None
        self.has_imu = received.step is not None
        estimate = predictor.add(stamp, received.step, is_line=received.line_since_ns is not None)
        if self._was_ahead:
            self._was_ahead, estimate = False, estimate._replace(from_imu=False)
        return estimate

    def is_sound(self, estimate: Estimate) -> bool:
        """Whether an estimate is finite; what is not must never get out, and is reported as a fault."""
        if estimate.T_W_O is not self._T_W_O and np.isfinite(estimate.T_W_O.matrix()).all():
            self._T_W_O = estimate.T_W_O
        if is_finite(estimate.nav) and estimate.T_W_O is self._T_W_O:
            return True
        self._log.report(EventKind.OPTIMISER_FAULT, estimate.stamp_ns, "", "the estimate is not finite: starting over")
        return False

    def chassis(self, estimate: Estimate) -> BaseState | None:
        """Return the state of the chassis at an estimate, if it is known."""
        base = None if self._base is None else self._base.at(estimate)
        if base is None or isfinite(base.joint_angle_rad + base.joint_rate_rad_s + sum(base.velocity.tolist())):
            return base
        self._base = BaseKinematics(self._config, self._log)
        reason = "the state of the chassis is not finite: begun anew"
        self._log.report(EventKind.OPTIMISER_FAULT, estimate.stamp_ns, "", reason)
        return None

    def add_to_chassis(self, message: ImuSample | JointAngle) -> None:
        """Take in a reading of a sensor of the chassis or the turn joint."""
        if self._base is not None:
            self._base.add(message, self._buffer.arrival_ns)
        else:
            self._log.count(message.sensor, Outcome.IGNORED)

    def start(self, state: OptimisedState, gravity: float) -> None:
        """Begin with a first state, gravity in m/s^2."""
        self.predictor = Predictor(self._config, self._buffer, gravity, state)

    def anchor(self, state: OptimisedState, *, is_recovery: bool) -> None:
        """Continue from a new optimised state."""
        assert self.predictor is not None
        self.predictor.anchor(state, is_recovery=is_recovery)

    def settle(self) -> OptimisedState:
        """Let the propagated state take the place of the optimised one, and return it."""
        assert self.predictor is not None
        return self.predictor.settle()

    def stop(self) -> None:
        """Give no estimates until the next start."""
        self.predictor = None
