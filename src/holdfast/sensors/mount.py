"""Where a sensor sits: fixed to the IMU, or on the chassis beyond the turn joint; and how its frame moves there."""

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.geometry.rotations import about_z
from holdfast.messages import Array
from holdfast.sensors.sensor import Joint, State

STILL = Joint(0.0, 0.0)


class Mount:
    """The pose of a frame S in I, which beyond the joint depends on its angle: (36) in docs/math.md.

    J is the joint as it sits in the chassis: its origin on the axis, its z along it. Without a joint in between J is S.

    Attributes:
        is_beyond_joint: whether S turns below the cabin.
        T_I_A: the joint as it sits in the cabin, its origin on the axis, its z along it; R_J_A = Rz(q).
        T_J_S: the pose of S in J.

    Args:
        config: its extrinsics and its turn joint.
        frame: name of S.
    """

    def __init__(self, config: Config, frame: str) -> None:
        self.is_beyond_joint = config.is_beyond_joint(frame)
        joint = config.turn_joint
        if not self.is_beyond_joint or joint is None:
            self.T_I_A, self.T_J_S = gtsam.Pose3(config.T_I(frame)), gtsam.Pose3()
            return
        T_P_C = gtsam.Pose3(joint.matrix())
        unturned = gtsam.Pose3(T_P_C.rotation().inverse(), np.zeros(3))
        self.T_I_A = gtsam.Pose3(config.T_I(joint.child)) * unturned
        T_P_J = gtsam.Pose3(gtsam.Rot3(), T_P_C.translation())
        self.T_J_S = T_P_J.inverse() * gtsam.Pose3(config.T(joint.parent, frame))

    def T_I_S(self, joint: Joint = STILL) -> gtsam.Pose3:
        """Return the pose of S in I."""
        return self._T_I_J(joint) * self.T_J_S

    def T_S_I(self, angles_rad: Array) -> tuple[Array, Array]:
        """Return the poses of I in S at angles of the joint (N,): rotations (N, 3, 3), translations (N, 3) [m]."""
        turned = about_z(-angles_rad if self.is_beyond_joint else np.zeros(len(angles_rad)))
        R_I_J = self.T_I_A.rotation().matrix() @ turned
        p_I_S = self.T_I_A.translation() + R_I_J @ self.T_J_S.translation()
        R_S_I: Array = (R_I_J @ self.T_J_S.rotation().matrix()).transpose(0, 2, 1)
        return R_S_I, -(R_S_I @ p_I_S[:, :, None])[:, :, 0]

    def velocity(self, state: State) -> tuple[Array, Array]:
        """Return the velocity (3,) of S in its own axes [m/s], and its derivative (3, 9) by the `NavState`.

        v_S = R_S_I (R_I_W v_W + omega x p_I_A + (omega - q' a) x R_I_J p_J_S), a the joint's axis: (37).
        """
        joint = state.joint or STILL
        T_I_J = self._T_I_J(joint)
        axis = T_I_J.rotation().rotate(np.array([0.0, 0.0, 1.0]))
        on_chassis = T_I_J.rotation().rotate(self.T_J_S.translation())
        v_I, omega = state.nav.bodyVelocity(), state.angular_velocity
        v = v_I + np.cross(omega, self.T_I_A.translation()) + np.cross(omega - joint.rate_rad_s * axis, on_chassis)
        R_S_I: Array = (T_I_J.rotation() * self.T_J_S.rotation()).matrix().T
        H = np.zeros((3, 9))
        H[:, :3], H[:, 6:] = R_S_I @ gtsam.SO3.Hat(v_I), R_S_I
        return R_S_I @ v, H

    def _T_I_J(self, joint: Joint) -> gtsam.Pose3:
        if not self.is_beyond_joint:
            return self.T_I_A
        turned = self.T_I_A.rotation().compose(gtsam.Rot3.Rz(-joint.angle_rad))
        return gtsam.Pose3(turned, self.T_I_A.translation())
