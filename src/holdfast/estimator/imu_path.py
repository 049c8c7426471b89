"""The half of the estimator that answers at IMU rate: it never waits for the other half, which optimises."""

from holdfast.config.model import Config
from holdfast.estimator.base import BaseKinematics
from holdfast.estimator.journal import Journal
from holdfast.estimator.predictor import Predictor
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import Step
from holdfast.state import BaseState, Estimate, OptimisedState, Outcome


class Heard:
    """What a believed sample of the IMU brought: the step to it, and whether the clock went back before it."""

    __slots__ = ("before_ns", "has_stepped_back", "step")

    def __init__(self, step: Step | None, before_ns: int, has_stepped_back: bool) -> None:
        self.step = step  # None where the IMU was silent
        self.before_ns = before_ns  # stamp of the sample before, 0 at the first
        self.has_stepped_back = has_stepped_back


def take_in(buffer: ImuBuffer, sample: ImuSample) -> Heard:
    """Append a checked sample; where the clock has gone back for good, nothing of before is kept."""
    before_ns = buffer.latest_ns
    has_stepped_back = sample.stamp_ns + buffer.offset_ns < before_ns
    if has_stepped_back:
        buffer.clear()
    return Heard(buffer.add(sample), before_ns, has_stepped_back)


class ImuPath:
    """Checks samples, propagates the newest optimised state to them, and carries it on to the chassis.

    Args:
        config: of the estimator.
        buffer: of the IMU's samples.
        journal: where counts and events go.
    """

    def __init__(self, config: Config, buffer: ImuBuffer, journal: Journal) -> None:
        self._config = config
        self._buffer = buffer
        self._journal = journal
        self._base = BaseKinematics(config, journal.tell, journal.count) if config.has_base() else None
        self.predictor: Predictor | None = None
        self.hears_imu = True
        self._was_ahead = False  # the state, of the sample before

    def hear(self, sample: ImuSample) -> Heard | None:
        """Take in a sample; None if it cannot be believed."""
        outcome = self._buffer.check(sample)
        if outcome is not Outcome.USED:
            self._journal.count("imu", outcome, 1)
            return None
        self._journal.samples += 1
        heard = take_in(self._buffer, sample)
        if heard.has_stepped_back:
            self.predictor = None
        return heard

    def propagate(self, heard: Heard) -> Estimate | None:
        """Carry the state to the sample that was just heard; None before the start, or where the state is ahead."""
        predictor, stamp = self.predictor, self._buffer.latest_ns
        if predictor is None:
            return None
        if stamp <= predictor.stamp_ns:
            self._was_ahead = True  # a measurement in a silent stretch has led the state past this sample
            return None
        self.hears_imu = heard.step is not None
        estimate = predictor.add(stamp, heard.step)
        if self._was_ahead:
            self._was_ahead, estimate = False, estimate._replace(from_imu=False)
        return estimate

    def chassis(self, estimate: Estimate) -> BaseState | None:
        """Return the state of the chassis at an estimate, if it is known."""
        return None if self._base is None else self._base.at(estimate)

    def add_to_base(self, message: ImuSample | JointAngle) -> None:
        """Take in what a sensor of the chassis or the turn joint says."""
        if self._base is not None:
            self._base.add(message, self._buffer.arrival_ns)
        else:
            self._journal.count(message.sensor, Outcome.IGNORED, 1)

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
