"""The chassis B: its pose and twist from the cabin's estimate, the turn joint and the gyroscope in the chassis.

Where `extrinsics` join B to the cabin, the same maths holds with a joint that reads zero.
"""

from typing import Any

import gtsam
import numpy as np

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.chassis.encoder import JointModel
from holdfast.chassis.turn_joint import ENCODERS, TurnJoint
from holdfast.config.model import Config
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.kernel import layout
from holdfast.messages import Array, ImuSample, JointAngle
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT, LearntJoint
from holdfast.sensors.mount import Mount
from holdfast.state import EncoderState

NO_JOINT = np.zeros(2, layout.JOINT), np.zeros(0, layout.ROTATION), np.zeros(0, layout.JOINT_READING)


class BaseGeometry:
    """Where the cabin turns on the chassis.

    A is the joint as it sits in the cabin, J as it sits in the chassis: both have their origin on the axis and their z
    along it, and R_J_A = Rz(q). Without a `turn_joint` both are B.
    """

    def __init__(self, config: Config) -> None:
        mount = Mount(config, config.frames.base)
        self._T_I_A, self._T_J_B = mount.T_I_A, mount.T_J_S
        self._R_B_J: Array = self._T_J_B.rotation().matrix().T.copy()

    def T_I_B(self, angle_rad: float) -> gtsam.Pose3:
        """Return the pose of the chassis in the IMU's frame at an angle of the joint: (36)."""
        at_angle = gtsam.Pose3(self._T_I_A.rotation().compose(gtsam.Rot3.Rz(-angle_rad)), self._T_I_A.translation())
        return at_angle * self._T_J_B

    def record(self, *, has_joint: bool) -> Any:
        """Return it as (1,) of `MOUNT`."""
        record: Any = np.zeros(1, layout.MOUNT)
        for name, T in (("T_I_A", self._T_I_A), ("T_J_B", self._T_J_B)):
            record[0][name]["R"], record[0][name]["p"] = T.rotation().matrix(), T.translation()
        record[0]["has_chassis"], record[0]["has_joint"] = 1, has_joint
        return record


class BaseKinematics:
    """Takes in readings of encoder and base IMU as they arrive, for the state of the chassis at each estimate.

    Attributes:
        encoder: whether it can be used; None where there is no turn joint.
        records: mount, joint, rotations and waiting readings, on which `holdfast.kernel.turn_joint` works.

    Args:
        config: of the estimator; without a chassis that is joined to the IMU nothing is done.
        log: where counts and events go: what became of each reading, when the encoder fails and works again.
        learnt: what was learnt of the turn joint before.
    """

    def __init__(self, config: Config, log: EventLog, learnt: LearntJoint = NOTHING_OF_JOINT) -> None:
        self._log = log
        self._encoder_name = config.joint[0] if config.joint else ""
        self._joint = _turn_joint(config, log, learnt)
        mount: Any = np.zeros(1, layout.MOUNT)
        if config.has_base():
            mount = BaseGeometry(config).record(has_joint=self._joint is not None)
        self.records: tuple[Any, ...] = mount, *NO_JOINT
        if self._joint is not None:
            self.records = mount, self._joint.record, self._joint.rotations, self._joint.waiting
        self.encoder = None if self._joint is None else self._joint.encoder

    def add(self, message: ImuSample | JointAngle, imu_arrival_ns: int) -> None:
        """Take in a sample of the base IMU or a reading of the encoder, in the order of arrival.

        Args:
            message: what came; without a turn joint it is not needed.
            imu_arrival_ns: when the newest sample of the cabin's IMU arrived.
        """
        if self._joint is None:
            self._log.count(message.sensor, Outcome.IGNORED)
        else:
            self._joint.add(message, imu_arrival_ns)

    def corrected(self, reading: JointAngle) -> JointAngle:
        """Return a reading of the encoder with the zero that was learnt."""
        return reading if self._joint is None else self._joint.corrected(reading)

    def learnt(self) -> LearntJoint:
        """Return what is known now of the turn joint that holds over a restart."""
        return NOTHING_OF_JOINT if self._joint is None else self._joint.learnt()

    def keep_learnt(self) -> None:
        """Keep what was learnt of the turn joint when the clock goes back next."""
        if self._joint is not None:
            self._joint.keep_learnt()

    def count(self) -> None:
        """Count what became of the readings that an estimate has taken in."""
        if self._joint is not None:
            self._joint.count()

    def note(self, stamp_ns: int, code: int) -> EncoderState | None:
        """Return whether the encoder can be used after an estimate, and report where that has changed.

        Args:
            stamp_ns: of the estimate.
            code: number of its state in `ENCODERS`.
        """
        encoder = ENCODERS[code]
        if encoder is not self.encoder:
            self.encoder = encoder
            if encoder is not None:
                self._log.report(EventKind.ENCODER, stamp_ns, self._encoder_name, encoder)
        return encoder


def _turn_joint(config: Config, log: EventLog, learnt: LearntJoint) -> TurnJoint | None:
    if config.turn_joint is None or config.joint is None or not config.has_base():
        return None
    gyro = None
    if config.base_imu is not None:
        name, base_imu = config.base_imu
        T_J_S = config.T(config.turn_joint.parent, config.frame_of(name)).copy()
        T_J_S[:3, 3] -= config.turn_joint.matrix()[:3, 3]
        gyro = BaseGyro(base_imu, T_J_S)
    return TurnJoint(JointModel(config.joint[1]), gyro, config, log, learnt)
