"""Readings of the turn joint's encoder and of the base IMU on their way into the filter: `holdfast.kernel.turn_joint`.

A reading that is ahead of the cabin's estimate waits until that has reached its stamp; the others are taken in as they
come, so that the cabin's next sample need not wait for them.
"""

from dataclasses import replace
from math import inf, sqrt
from typing import Any

import numpy as np

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.chassis.encoder import JointModel
from holdfast.chassis.encoder_zero import ZeroReport, fill_zero
from holdfast.chassis.kept_joint import begin_with, learnt_joint
from holdfast.config.model import Config
from holdfast.event_log import EventLog
from holdfast.events import Outcome
from holdfast.kernel import layout
from holdfast.kernel.joint_filter import ANY_RATE_RAD2_S2, LAG_SIGMA_S, LAG_WALK_S_SQRT_S, MAX_LAG_S
from holdfast.kernel.turn_joint import ABSENT, CORRECTED_S, add_reading
from holdfast.messages import ImuSample, JointAngle
from holdfast.sensors.imu import as_doubles
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT, LearntJoint
from holdfast.sensors.stamp_filter import StampFilter
from holdfast.state import EncoderState

MAX_WAITING = 4096
ROTATIONS = 4096  # rows for what the joint has turned, some seconds
USUAL_PERIOD_S = 0.01  # of the base IMU, until it is known
ACCEPT_AFTER_NS = 5_000_000_000  # an encoder that contradicts two gyroscopes for so long
FROZEN_SIGMAS = 10.0  # rotated by so many sigmas of a reading without a new one, an encoder is frozen

STAMP = layout.JOINT.names.index("stamp_ns")  # type: ignore[union-attr]

OUTCOMES = Outcome.USED, Outcome.LATE, Outcome.INNOVATION, Outcome.FROZEN  # as `kernel.joint_filter` numbers them
# and `kernel.turn_joint`; the last where there is none
ENCODERS = (
    EncoderState.OK,
    EncoderState.ABSENT,
    EncoderState.LATE,
    EncoderState.FROZEN,
    EncoderState.WRONG_ZERO,
    None,
)
NOT_MEASURED = np.zeros(3)


def joint_record(encoder: JointModel, gyro: BaseGyro | None, config: Config) -> Any:
    """Return (1,) of `JOINT` of which nothing is known yet; without a base gyroscope its bias and the lag are fixed."""
    record: Any = np.zeros(1, layout.JOINT)
    joint, imu = record[0], config.imu
    joint["stamp_ns"] = joint["refused_ns"] = joint["rate_ns"] = layout.NEVER
    joint["encoder"], joint["gyro_period_s"] = ABSENT, USUAL_PERIOD_S
    joint["P"][4] = ANY_RATE_RAD2_S2
    # without a base gyroscope nothing but the encoder itself contradicts the encoder
    joint["max_age_ns"] = joint["accept_after_ns"] = encoder.max_age_ns
    joint["memory_ns"] = encoder.max_age_ns + round(MAX_LAG_S * 1e9)
    if gyro is not None:
        joint["has_gyro"], joint["accept_after_ns"], joint["gyro_gap_ns"] = 1, ACCEPT_AFTER_NS, gyro.max_gap_ns
        joint["P"][7], joint["P"][9] = gyro.bias_variance, LAG_SIGMA_S**2
        joint["bias_walk"], joint["lag_walk"] = gyro.walk_variance, LAG_WALK_S_SQRT_S**2
        joint["gyro_density2"] = gyro.noise_variance
    joint["angle_variance"] = encoder.variance
    joint["cabin_density2"] = imu.gyroscope_noise_density**2
    joint["motion_ratio2"] = imu.gyroscope_error_ratio**2 * CORRECTED_S
    joint["silent_density2"] = config.motion_model.angular_rate_density**2
    joint["repeats"]["step_rad"], joint["repeats"]["least_rad"] = inf, FROZEN_SIGMAS * sqrt(encoder.variance)
    return record


class TurnJoint:
    """Follows the joint and the turning of the chassis about its axis.

    Attributes:
        record: (2,) of `JOINT`: as it is, and as it was when nothing was known; as those below for
            `holdfast.kernel.turn_joint`.
        rotations: by how much the joint has turned.
        waiting: readings that are ahead of the estimate.

    Args:
        encoder: model of the encoder.
        gyro: model of the base IMU's gyroscope, None where there is none.
        config: of the estimator.
        log: where it is counted what became of each reading.
        learnt: what was learnt before.
    """

    def __init__(
        self,
        encoder: JointModel,
        gyro: BaseGyro | None,
        config: Config,
        log: EventLog,
        learnt: LearntJoint = NOTHING_OF_JOINT,
    ) -> None:
        self._model, self._gyro, self._config, self._log = encoder, gyro, config, log
        self._sensors = config.base_imu[0] if config.base_imu else "", config.joint[0] if config.joint else ""
        self.record: Any = np.zeros(2, layout.JOINT)
        self._one = self.record[0]
        self._begin_with(learnt)
        self.record[0] = self.record[1]
        self._numbers = memoryview(self.record.view(np.int64).data)  # the same, five times faster to read
        self._last = max(self._sensors)  # of two at one stamp
        self.rotations: Any = np.zeros(ROTATIONS, layout.ROTATION)
        self.waiting: Any = np.zeros(MAX_WAITING, layout.JOINT_READING)
        self._stamps = StampFilter()
        names = self._sensors[1], self._sensors[0], config.imu_name
        self._zero = ZeroReport(self._one["zero"], names, config.imu.gyroscope_error_ratio, log)

    def _begin_with(self, learnt: LearntJoint) -> None:
        """Begin with what was learnt when the clock goes back next, or for the first time."""
        first = joint_record(self._model, self._gyro, self._config)
        fill_zero(first[0]["zero"], self._model, self._gyro, self._config.imu)
        if self._gyro is not None:
            begin_with(first, learnt, self._model, self._gyro)
        self.record[1], self._learnt = first[0], learnt

    def learnt(self) -> LearntJoint:
        """Return what is known now that holds over a restart."""
        return self._learnt if self._gyro is None else learnt_joint(self._one["zero"], self._learnt)

    def keep_learnt(self) -> None:
        """Keep what was learnt when the clock goes back next."""
        self._begin_with(self.learnt())

    @property
    def encoder(self) -> EncoderState | None:
        """Whether the encoder can be used."""
        return ENCODERS[self._one["encoder"]]

    def add(self, message: ImuSample | JointAngle, imu_arrival_ns: int) -> None:
        """Take in a reading, let it wait for its stamp, or count why not; what is taken in is counted by `count`.

        Args:
            message: in the order of arrival.
            imu_arrival_ns: when the newest sample of the cabin's IMU arrived.
        """
        rate = force = NOT_MEASURED
        if isinstance(message, JointAngle):
            outcome, value, offset_ns = self._model.check(message), self._model.angle(message), self._model.offset_ns
        elif self._gyro is not None:
            outcome, value, offset_ns = self._gyro.check(message), self._gyro.rate(message), self._gyro.offset_ns
            rate = as_doubles(message.angular_velocity, "angular_velocity")
            force = as_doubles(message.specific_force, "specific_force")
        else:
            outcome, value, offset_ns = Outcome.IGNORED, 0.0, 0
        stamp_ns = message.stamp_ns + offset_ns
        if outcome is Outcome.USED:
            outcome = self._check_stamp(stamp_ns, message, imu_arrival_ns)
        if outcome is not Outcome.USED:
            self._log.count(message.sensor, outcome)
            return
        order, is_angle = int(message.sensor == self._last), int(isinstance(message, JointAngle))
        add_reading(self.record, self.rotations, self.waiting, stamp_ns, order, is_angle, value, rate, force)
        self._zero.review(stamp_ns, self._learnt)

    def corrected(self, reading: JointAngle) -> JointAngle:
        """Return a reading with the zero that was learnt, as far as that has come in."""
        applied_rad = float(self._one["zero"]["applied_rad"])
        return replace(reading, angle_rad=reading.angle_rad + applied_rad) if applied_rad else reading

    def count(self) -> None:
        """Count what became of the readings that were taken since the last call."""
        counts = self._one["counts"]
        for is_angle, outcome in np.argwhere(counts):
            self._log.count(self._sensors[is_angle], OUTCOMES[outcome], int(counts[is_angle, outcome]))
        counts[:] = 0

    def _check_stamp(self, stamp_ns: int, message: ImuSample | JointAngle, imu_arrival_ns: int) -> Outcome:
        reached_ns: int = self._numbers[STAMP]
        if reached_ns == layout.NEVER:
            return Outcome.BEFORE_START
        if stamp_ns < reached_ns - self._model.max_age_ns:
            return Outcome.LATE
        return self._stamps.check(message.sensor, stamp_ns, message.arrival_ns, reached_ns, imu_arrival_ns)
