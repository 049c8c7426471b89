"""The chassis B: its pose and twist from the cabin's estimate, the turn joint and the gyroscope in the chassis.

Where `extrinsics` join B to the cabin, the same maths holds with a joint that reads zero.
"""

from math import cos, sin

import gtsam
import numpy as np

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.chassis.encoder import JointModel
from holdfast.chassis.turn_joint import TurnJoint
from holdfast.config.model import Config
from holdfast.event_log import EventLog
from holdfast.messages import Array, ImuSample, JointAngle
from holdfast.sensors.mount import Mount
from holdfast.state import BaseState, EncoderState, Estimate, EventKind, Outcome


class BaseGeometry:
    """Where the cabin turns on the chassis, and what that makes of an estimate.

    A is the joint as it sits in the cabin, J as it sits in the chassis: both have their origin on the axis and their z
    along it, and R_J_A = Rz(q). Without a `turn_joint` both are B.
    """

    def __init__(self, config: Config) -> None:
        mount = Mount(config, config.frames.base)
        self._T_I_A, self._T_J_B = mount.T_I_A, mount.T_J_S
        self._R_I_A, self._p_I_A = self._T_I_A.rotation(), self._T_I_A.translation()
        self._R_A_I: Array = self._T_I_A.rotation().matrix().T.copy()
        self._rows: list[list[float]] = self._R_A_I.tolist()
        self._R_B_J: Array = self._T_J_B.rotation().matrix().T.copy()
        self._is_aligned = bool((np.eye(3) == self._R_B_J).all())  # as a rule
        self._arm_A: list[float] = (self._R_A_I @ self._T_I_A.translation()).tolist()
        self._arm_J: list[float] = self._T_J_B.translation().tolist()

    def T_I_B(self, angle_rad: float) -> gtsam.Pose3:
        """Return the pose of the chassis in the IMU's frame at an angle of the joint: (36)."""
        return gtsam.Pose3(self._R_I_A.compose(gtsam.Rot3.Rz(-angle_rad)), self._p_I_A) * self._T_J_B

    def cabin_rates(self, estimate: Estimate) -> list[float]:
        """Return the angular velocity (3,) of the cabin in A [rad/s]; the last is that about the joint's axis."""
        return self._in_A(estimate.angular_velocity)

    def _in_A(self, vector_I: Array) -> list[float]:
        """Turn a vector (3,) from I to A; floats, because it runs at every sample."""
        x, y, z = vector_I.tolist()
        return [a * x + b * y + c * z for a, b, c in self._rows]

    def twist(
        self, estimate: Estimate, rates_A: list[float], angle_rad: float, rate_rad_s: float
    ) -> tuple[Array, Array]:
        """Return the velocity of B's origin [m/s] and the angular velocity of B [rad/s], each (3,) in B: (37).

        Args:
            estimate: of the cabin's IMU.
            rates_A: what `cabin_rates` says of it.
            angle_rad: of the joint.
            rate_rad_s: of the chassis about the joint's axis.
        """
        wx, wy, wz = rates_A
        vx, vy, vz = self._in_A(estimate.nav.bodyVelocity())
        sx, sy, sz = self._arm_A
        vx, vy, vz = vx + wy * sz - wz * sy, vy + wz * sx - wx * sz, vz + wx * sy - wy * sx
        c, s = cos(angle_rad), sin(angle_rad)
        vx, vy, wx, wy, wz = c * vx - s * vy, s * vx + c * vy, c * wx - s * wy, s * wx + c * wy, rate_rad_s
        rx, ry, rz = self._arm_J
        vx, vy, vz = vx + wy * rz - wz * ry, vy + wz * rx - wx * rz, vz + wx * ry - wy * rx
        velocity, angular_velocity = np.array([vx, vy, vz]), np.array([wx, wy, wz])
        if self._is_aligned:
            return velocity, angular_velocity
        return self._R_B_J @ velocity, self._R_B_J @ angular_velocity


class BaseKinematics:
    """Takes in readings of encoder and base IMU as they arrive, and gives a `BaseState` for each estimate of the cabin.

    Args:
        config: `frames.base` must be joined to the IMU, by `extrinsics` or by `turn_joint`.
        log: where counts and events go: what became of each reading, when the encoder fails and works again.
    """

    def __init__(self, config: Config, log: EventLog) -> None:
        self.geometry = BaseGeometry(config)
        self._log = log
        self._config = config
        self._encoder_name = config.joint[0] if config.joint else ""
        self._joint = self._new_joint()
        self._stamp_ns = 0  # of the estimate before
        self._axis_rate_rad_s = 0.0  # of the cabin about the joint's axis, at the estimate before

    def _new_joint(self) -> TurnJoint | None:
        config = self._config
        if config.turn_joint is None or config.joint is None:
            return None
        gyro = None
        if config.base_imu is not None:
            name, base_imu = config.base_imu
            gyro = BaseGyro(base_imu, config.T(config.frame_of(name), config.turn_joint.parent)[:3, 2])
        return TurnJoint(JointModel(config.joint[1]), gyro, config, self._log)

    @property
    def encoder(self) -> EncoderState | None:
        """Whether the encoder can be used; None where there is no turn joint."""
        return None if self._joint is None else self._joint.state

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

    def at(self, estimate: Estimate) -> BaseState | None:
        """Return the state of the chassis at an estimate; None before the first reading of the encoder."""
        geometry, stamp = self.geometry, estimate.stamp_ns
        if stamp < self._stamp_ns:
            self._joint = self._new_joint()  # the clock has gone back: no reading of before compares with one of now
        self._stamp_ns, joint = stamp, self._joint
        rates_A = geometry.cabin_rates(estimate)
        before_rad_s, self._axis_rate_rad_s = self._axis_rate_rad_s, rates_A[2]
        angle, rate, angle_sigma, rate_sigma, encoder = 0.0, rates_A[2], 0.0, 0.0, None
        if joint is not None:
            before = joint.state
            mean_rad_s = 0.5 * (before_rad_s + rates_A[2]) if estimate.from_imu else rates_A[2]
            motion = joint.advance(stamp, mean_rad_s, from_imu=estimate.from_imu)
            encoder = joint.state
            if encoder is not before:
                self._log.report(EventKind.ENCODER, stamp, self._encoder_name, encoder)
            if motion is None:
                return None
            angle, angle_sigma, rate, rate_sigma = motion
        T_W_B = estimate.nav.pose() * geometry.T_I_B(angle)
        return BaseState(
            stamp,
            estimate.T_W_O.between(T_W_B),
            T_W_B,
            *geometry.twist(estimate, rates_A, angle, rate),
            angle,
            rates_A[2] - rate,
            angle_sigma,
            rate_sigma,
            encoder,
        )
