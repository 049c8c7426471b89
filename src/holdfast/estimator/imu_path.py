"""The half of the estimator that answers at IMU rate: it never waits for the other half, which optimises."""

from holdfast.chassis.kinematics import BaseKinematics
from holdfast.config.model import Config
from holdfast.estimator.predictor import Predictor
from holdfast.event_log import EventLog
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import Step
from holdfast.state import BaseState, Estimate, OptimisedState, Outcome


class Received:
    """What a usable sample of the IMU brought.

    Attributes:
        step: to it from the sample before; None where the IMU was silent.
        before_ns: stamp of the sample before, 0 at the first.
        line_since_ns: start of the straight line that it makes certain, if there is one.
        has_stepped_back: the clock went back before it.
    """

    __slots__ = ("before_ns", "has_stepped_back", "line_since_ns", "step")

    def __init__(self, step: Step | None, before_ns: int, line_since_ns: int | None, has_stepped_back: bool) -> None:
        self.step = step
        self.before_ns = before_ns
        self.line_since_ns = line_since_ns
        self.has_stepped_back = has_stepped_back


def receive(buffer: ImuBuffer, sample: ImuSample) -> Received:
    """Append a checked sample; where the clock has gone back for good, nothing of before is kept."""
    before_ns = buffer.latest_ns
    has_stepped_back = sample.stamp_ns + buffer.offset_ns < before_ns
    if has_stepped_back:
        buffer.clear()
    step, line_since_ns = buffer.add(sample)
    return Received(step, before_ns, line_since_ns, has_stepped_back)


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
        self._serves_chassis = {one[0] for one in (config.joint, config.base_imu) if one is not None}
        self.predictor: Predictor | None = None
        self.has_imu = True
        self._was_ahead = False  # the state, of the sample before

    def serves_chassis(self, sensor: str) -> bool:
        """Whether a sensor is the encoder or the IMU of the chassis."""
        return sensor in self._serves_chassis

    def receive(self, sample: ImuSample) -> Received | None:
        """Take in a sample; None if it cannot be used."""
        outcome = self._buffer.check(sample)
        if outcome is not Outcome.USED:
            self._log.count(sample.sensor, outcome)
            return None
        self._log.samples += 1
        received = receive(self._buffer, sample)
        if received.has_stepped_back:
            self.predictor = None
        return received

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

    def chassis(self, estimate: Estimate) -> BaseState | None:
        """Return the state of the chassis at an estimate, if it is known."""
        return None if self._base is None else self._base.at(estimate)

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
