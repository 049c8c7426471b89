"""The turn joint over time: readings of the encoder and of the base IMU enter the filter.

A reading that is ahead of the cabin's estimate waits until that has reached its stamp; the others are taken in as they
come, so that the cabin's next sample need not wait for them.
"""

from bisect import insort
from math import copysign, sqrt
from typing import NamedTuple

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.chassis.encoder import JointModel, RepeatMonitor
from holdfast.chassis.joint_filter import JointFilter
from holdfast.config.model import Config
from holdfast.event_log import EventLog
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.sensor import StampFilter
from holdfast.state import EncoderState, Outcome

MAX_WAITING = 4096
CORRECTED_S = 0.1  # so long an error in proportion to the cabin's turning adds up before the encoder corrects it
USUAL_PERIOD_S = 0.01  # of the base IMU, until it is known
ACCEPT_AFTER_NS = 5_000_000_000  # an encoder that contradicts two gyroscopes for so long
MAX_STEP_RAD = 2.5e-4  # that the encoder may correct the angle at once: T_O_B does not step
SETTLE_S = 0.5  # in which the rest of the correction flows in
AT_ONCE_NS = 50_000_000  # a longer silence of the cabin's IMU is crossed from reading to reading

_Reading = tuple[int, str, float, bool]  # stamp, sensor, angle [rad] or rate [rad/s], whether it is an angle


class JointMotion(NamedTuple):
    """The turn joint at one time.

    Attributes:
        angle_rad: of the joint, not wrapped.
        angle_sigma_rad: of the angle, that of the encoder's zero included.
        rate_rad_s: of the chassis about the axis of the joint.
        rate_sigma_rad_s: of that rate.
    """

    angle_rad: float
    angle_sigma_rad: float
    rate_rad_s: float
    rate_sigma_rad_s: float


class TurnJoint:
    """Follows the joint and the turning of the chassis about its axis.

    Args:
        encoder: model of the encoder.
        gyro: model of the base IMU's gyroscope, None where there is none.
        config: of the estimator.
        log: where it is counted what became of each reading.
    """

    def __init__(self, encoder: JointModel, gyro: BaseGyro | None, config: Config, log: EventLog) -> None:
        self._model, self._gyro, self._log = encoder, gyro, log
        imu = config.imu
        self._cabin_density2 = imu.gyroscope_noise_density**2
        self._motion_ratio2 = imu.gyroscope_error_ratio**2 * CORRECTED_S
        self._silent_density2 = config.motion_model.angular_rate_density**2
        # without a base gyroscope nothing but the encoder itself contradicts the encoder
        max_age_ns = self._model.max_age_ns
        self._filter = JointFilter(self._gyro, max_age_ns, max_age_ns if self._gyro is None else ACCEPT_AFTER_NS)
        self._repeats = RepeatMonitor(self._model.variance)
        self._waiting: list[_Reading] = []
        self._stamps = StampFilter()
        self._gyro_ns = self._angle_ns = self._used_ns = 0  # newest readings, and the newest of the encoder in use
        self._gyro_period_s = USUAL_PERIOD_S
        self._corrected_rad = 0.0  # by the readings since the last estimate
        self._held_rad = 0.0  # of the correction of the angle, what is not let out yet
        self.state = EncoderState.ABSENT

    def add(self, message: ImuSample | JointAngle, imu_arrival_ns: int) -> None:
        """Take in a reading, let it wait for its stamp, or count why not; what waits is counted when it is taken.

        Args:
            message: in the order of arrival.
            imu_arrival_ns: when the newest sample of the cabin's IMU arrived.
        """
        if isinstance(message, JointAngle):
            outcome, value, offset_ns = self._model.check(message), self._model.angle(message), self._model.offset_ns
        elif self._gyro is not None:
            outcome, value, offset_ns = self._gyro.check(message), self._gyro.rate(message), self._gyro.offset_ns
        else:
            outcome, value, offset_ns = Outcome.IGNORED, 0.0, 0
        stamp = message.stamp_ns + offset_ns
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp, message, imu_arrival_ns)
        if outcome is not Outcome.USED:
            self._log.count(message.sensor, outcome)
            return
        reading = stamp, message.sensor, value, isinstance(message, JointAngle)
        reached_ns = self._filter.stamp_ns
        if reached_ns is not None and stamp <= reached_ns:
            self._take(*reading)
            return
        insort(self._waiting, reading)
        if len(self._waiting) > MAX_WAITING:
            self._log.count(self._waiting.pop(0)[1], Outcome.LATE)

    def _check_stamp(self, stamp_ns: int, message: ImuSample | JointAngle, imu_arrival_ns: int) -> Outcome:
        reached_ns = self._filter.stamp_ns
        if reached_ns is None:
            return Outcome.BEFORE_START
        if stamp_ns < reached_ns - self._model.max_age_ns:
            return Outcome.LATE
        return self._stamps.check(message.sensor, stamp_ns, message.arrival_ns, reached_ns, imu_arrival_ns)

    def advance(self, stamp_ns: int, cabin_rate_rad_s: float, *, from_imu: bool) -> JointMotion | None:
        """Go on to the next estimate, taking in every reading on the way; return None if no angle was ever read.

        Args:
            stamp_ns: of the estimate, not before the last one.
            cabin_rate_rad_s: mean rate of the cabin about the axis since the estimate before, bias removed.
            from_imu: False where the cabin's IMU was silent.
        """
        joint, waiting = self._filter, self._waiting
        density2 = self._silent_density2
        if from_imu:
            density2 = self._cabin_density2 + self._motion_ratio2 * cabin_rate_rad_s**2
        step_ns = 0 if joint.stamp_ns is None else stamp_ns - joint.stamp_ns
        at_once, had_encoder = step_ns <= AT_ONCE_NS, self.state is EncoderState.OK
        if at_once:
            joint.predict(stamp_ns, cabin_rate_rad_s, density2)
        while waiting and waiting[0][0] <= stamp_ns:
            reading = waiting.pop(0)
            if not at_once:
                joint.predict(reading[0], cabin_rate_rad_s, density2)
            self._take(*reading)
        if not at_once:
            joint.predict(stamp_ns, cabin_rate_rad_s, density2)
        self.state = self._judge_encoder(stamp_ns)
        if not joint.is_known:
            return None
        corrected_rad, self._corrected_rad = self._corrected_rad, 0.0
        if abs(corrected_rad) > MAX_STEP_RAD and (self._gyro is not None or not had_encoder):
            self._held_rad += corrected_rad - copysign(MAX_STEP_RAD, corrected_rad)
        held_rad = self._held_rad = self._held_rad * max(0.0, 1.0 - step_ns * 1e-9 / SETTLE_S)
        angle_sigma = sqrt(joint.angle_variance + self._model.zero_variance + held_rad**2)
        return JointMotion(joint.angle_rad - held_rad, angle_sigma, joint.rate_rad_s, sqrt(joint.rate_variance))

    def _take(self, stamp_ns: int, sensor: str, value: float, is_angle: bool) -> None:
        joint = self._filter
        before_rad = joint.angle_rad if joint.is_known else None
        outcome = self._take_angle(stamp_ns, value) if is_angle else self._take_rate(stamp_ns, value)
        if before_rad is not None:
            self._corrected_rad += joint.angle_rad - before_rad
        self._log.count(sensor, outcome)

    def _take_rate(self, stamp_ns: int, rate_rad_s: float) -> Outcome:
        assert self._gyro is not None
        since_ns = stamp_ns - self._gyro_ns
        if since_ns > 0:
            self._gyro_ns = stamp_ns
            if since_ns <= self._gyro.max_gap_ns:
                self._gyro_period_s = since_ns * 1e-9
        self._filter.add_rate(stamp_ns, rate_rad_s, self._gyro.noise_variance / self._gyro_period_s)
        return Outcome.USED

    def _take_angle(self, stamp_ns: int, angle_rad: float) -> Outcome:
        hidden_rad, rotation_rad = 0.0, self._filter.rotation_until(stamp_ns)
        if stamp_ns > self._angle_ns:
            self._angle_ns = stamp_ns
            noise = None
            if self._gyro is not None and stamp_ns - self._gyro_ns <= self._gyro.max_gap_ns:
                noise = self._cabin_density2 + self._gyro.noise_variance, self._filter.bias_variance
            hidden_rad = self._repeats.hidden_rotation(stamp_ns, angle_rad, rotation_rad, noise)
        if self._repeats.is_frozen:
            return Outcome.FROZEN
        outcome = self._filter.add_angle(stamp_ns, angle_rad, self._model.variance + hidden_rad**2, rotation_rad)
        if outcome is Outcome.USED and stamp_ns > self._used_ns:
            self._used_ns = stamp_ns
        return outcome

    def _judge_encoder(self, stamp_ns: int) -> EncoderState:
        if not self._filter.is_known:
            return EncoderState.ABSENT
        is_frozen = self._repeats.is_frozen
        newest_ns = self._angle_ns if is_frozen else self._used_ns
        if stamp_ns - newest_ns > self._model.max_age_ns:
            return EncoderState.LATE
        return EncoderState.FROZEN if is_frozen else EncoderState.OK
