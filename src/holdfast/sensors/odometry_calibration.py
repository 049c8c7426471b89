"""What the graph estimates of an odometry beside its drift: how and where it is mounted, and the offset of its clock.

One parameter (4,) is the rotation vector delta [rad] by which L is mounted otherwise than `extrinsics` says, in its own
axes, and tau [s], by which its poses are younger than their stamps; another (3,) the lever arm d [m] by which L is
elsewhere, in its axes, too: (52) in docs/math.md. What is believed of all (7,) is delta, d and tau.
"""

from collections.abc import Sequence
from math import radians

import gtsam
import numpy as np

from holdfast.config.sensors import DriftingConfig
from holdfast.messages import Array
from holdfast.sensors.clock import IF_RIGHT_S
from holdfast.sensors.lever_arm import measured_arm
from holdfast.sensors.sensor import CHANGE_RAD, STEADY, Parameter

KNOWN = 1e-7  # sigma [rad, s] of what is known
FOUND_RAD = radians(3.0)  # so well motions must tell how a sensor is mounted; sigma of what they told
TURNED = 5.0  # sigmas of a prior, by which an estimate of the mount is none
SIZE = 4
NO_ARM: Array = np.zeros(3)
NOMINAL: Array = np.zeros(SIZE + 3)  # as configured: mounting, lever arm, clock


class OdometryCalibration:
    """The parameter of one odometry, and the factors on it.

    Args:
        config: of the odometry.
        T_I_L: the pose of its sensor in I, as configured.
    """

    def __init__(self, config: DriftingConfig, T_I_L: gtsam.Pose3) -> None:
        self._T_I_L, self._T_L_I = T_I_L, T_I_L.inverse()
        self._adjoint: Array = T_I_L.AdjointMap()
        self.lever_arm: Array = T_I_L.translation()
        sigmas = np.array([*np.repeat(np.radians(config.mounting_sigma_deg), 3), config.time_offset_sigma_s])
        if_right = np.array([*np.full(3, np.inf), IF_RIGHT_S])
        change = np.array([CHANGE_RAD, CHANGE_RAD, CHANGE_RAD, IF_RIGHT_S])
        prior = Parameter(np.zeros(SIZE), np.maximum(sigmas, KNOWN), if_right, change=change, has_clock=True)
        self.prior = prior if sigmas.any() else None
        self.arm_prior = measured_arm() if self.is_mount_estimated else None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is estimated of the odometry."""
        return tuple(one for one in (self.prior, self.arm_prior) if one is not None)

    @property
    def is_mount_estimated(self) -> bool:
        """Whether the rotation of the mounting is not known."""
        return self.prior is not None and self.prior.sigmas[0] > KNOWN

    def prior_about(self, delta: Array, sigma_rad: float = FOUND_RAD) -> Parameter:
        """Return the prior of one that is mounted otherwise, by a rotation vector (3,); it must be estimated."""
        assert self.prior is not None
        sigmas = np.concatenate([np.maximum(self.prior.sigmas[:3], sigma_rad), self.prior.sigmas[3:]])
        return self.prior._replace(mean=np.concatenate([delta, self.prior.mean[3:]]), sigmas=sigmas)

    def is_turned(self, prior: Parameter, belief: Array) -> bool:
        """Whether what is believed (7,) has left a prior, or the configured one, further than the mount is doubted.

        Small turns are what it is linear in. A sensor that is turned far moves otherwise from the first metre, and
        turns the estimate with it, degree by degree.
        """
        assert self.prior is not None
        sigma_rad = max(prior.sigmas[0], self.prior.sigmas[0])
        return apart_rad(prior.mean[:3], belief[:3]) > TURNED * float(sigma_rad)

    def of_sensor(self, motion: gtsam.Pose3) -> gtsam.Pose3:
        """Return the motion of L, as it is configured, that goes with a motion of I."""
        return self._T_L_I.compose(motion).compose(self._T_I_L)

    def motion(self, motion: gtsam.Pose3, belief: Array) -> gtsam.Pose3:
        """Return a motion of I with another mounting: C motion C^-1, C = T_I_L (Exp(delta), d) T_L_I."""
        correction = self._T_I_L.compose(mounted(belief)).compose(self._T_L_I)
        return correction.compose(motion).compose(correction.inverse())

    def after(self, nav: gtsam.NavState, angular_velocity: Array, belief: Array, beyond: Array = STEADY) -> gtsam.Pose3:
        """Return the pose of I at the time when a pose of the odometry with the stamp of a state was measured.

        `beyond` (6,) is by how much its mean twist until then differs from that of the state.
        """
        twist = np.concatenate([angular_velocity, nav.bodyVelocity()]) + beyond
        return nav.pose().compose(gtsam.Pose3.Expmap(twist * belief[-1]))

    def anchored_factor(
        self, keys: Sequence[int], motion: gtsam.Pose3, rate: Array, beyond: Array, noise: gtsam.noiseModel.Base
    ) -> gtsam.NonlinearFactor:
        """Return the factor on a frame, a node and the parameter: the node's pose after tau is `motion` from the frame.

        Args:
            keys: of the frame, the node, the parameter and the lever arm if that is estimated, too.
            motion: of I from the frame to the pose, as the configured mounting has it.
            rate: (3,) angular velocity of I at the node [rad/s].
            beyond: (6,) by how much the mean twist over tau differs from that at the node.
            noise: of the error (6,), rotation first.
        """
        frame_key, node_key, parameter_key, *arm_keys = keys

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            frame, node = values.atNavState(frame_key).pose(), values.atNavState(node_key)
            parameter = values.atVector(parameter_key)
            belief = joined(parameter, *map(values.atVector, arm_keys))
            twist = np.concatenate([rate, node.bodyVelocity()]) + beyond
            by_twist = np.zeros((6, 6), order="F")
            shift = gtsam.Pose3.Expmap(twist * parameter[3], by_twist)
            expected = self.motion(motion, belief)
            moved = frame.between(node.pose()).compose(shift)
            off = expected.between(moved)
            if jacobians is None:
                return gtsam.Pose3.Logmap(off)
            by_off = np.zeros((6, 6), order="F")
            residual: Array = gtsam.Pose3.Logmap(off, by_off)
            jacobians[0] = np.zeros((6, 9))
            jacobians[0][:, :6] = -by_off @ moved.inverse().AdjointMap()
            jacobians[1] = np.zeros((6, 9))
            jacobians[1][:, :6] = by_off @ shift.inverse().AdjointMap()
            by_velocity = by_off @ by_twist[:, 3:] * parameter[3]
            jacobians[1][:, :3] += by_velocity @ gtsam.SO3.Hat(node.bodyVelocity())
            jacobians[1][:, 6:] = by_velocity
            by_mounting, by_arm = np.hsplit(by_off @ self._by_mounting(expected, off, belief), 2)
            jacobians[2] = np.column_stack([by_mounting, by_off @ twist])
            if arm_keys:
                jacobians[3] = by_arm
            return residual

        return gtsam.CustomFactor(noise, list(keys), error)

    def drift_factor(
        self, keys: Sequence[int], motion: gtsam.Pose3, noise: gtsam.noiseModel.Base
    ) -> gtsam.NonlinearFactor:
        """Return the factor on two frames and the parameter: the second is `motion` from the first, and does not move.

        Args:
            keys: of the frames, the parameter and the lever arm if that is estimated, too.
            motion: of I from the first to the second, as the configured mounting has it.
            noise: of the error (9,): rotation, translation, velocity of the second frame.
        """
        before_key, key, parameter_key, *arm_keys = keys

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            before, here = values.atNavState(before_key).pose(), values.atNavState(key)
            belief = joined(values.atVector(parameter_key), *map(values.atVector, arm_keys))
            expected = self.motion(motion, belief)
            moved = before.between(here.pose())
            off = expected.between(moved)
            by_off = np.zeros((6, 6), order="F")
            residual = np.concatenate([gtsam.Pose3.Logmap(off, by_off), here.bodyVelocity()])
            if jacobians is not None:
                jacobians[0] = np.zeros((9, 9))
                jacobians[0][:6, :6] = -by_off @ moved.inverse().AdjointMap()
                jacobians[1] = np.eye(9)
                jacobians[1][:6, :6] = by_off
                jacobians[1][6:, :3] = gtsam.SO3.Hat(here.bodyVelocity())
                by_mounting, by_arm = np.hsplit(by_off @ self._by_mounting(expected, off, belief), 2)
                jacobians[2] = np.zeros((9, SIZE))
                jacobians[2][:6, :3] = by_mounting
                if arm_keys:
                    jacobians[3] = np.vstack([by_arm, np.zeros((3, 3))])
            return residual

        return gtsam.CustomFactor(noise, list(keys), error)

    def _by_mounting(self, expected: gtsam.Pose3, off: gtsam.Pose3, belief: Array) -> Array:
        """Return the derivative (6, 6) of the tangent of `off` = expected^-1 moved by delta and d."""
        by_turned = np.eye(6)
        by_turned[:3, :3] = gtsam.Rot3.ExpmapDerivative(-belief[:3])
        by_turned[3:, :3] = gtsam.SO3.Hat(belief[3:6]) @ by_turned[:3, :3]
        by_correction = (expected.inverse().AdjointMap() - np.eye(6)) @ self._adjoint
        result: Array = -off.inverse().AdjointMap() @ by_correction @ by_turned
        return result


def mounted(belief: Array) -> gtsam.Pose3:
    """Return the pose of L as it is in L as it is configured."""
    return gtsam.Pose3(gtsam.Rot3.Expmap(belief[:3]), belief[3:6])


def joined(parameter: Array, arm: Array = NO_ARM) -> Array:
    """Return what is believed of an odometry (7,), of its parameter (4,) and its lever arm (3,)."""
    return np.concatenate([parameter[:3], arm, parameter[3:]])


def apart_rad(a: Array, b: Array) -> float:
    """Return the angle between the rotations of two rotation vectors (3,) [rad]."""
    return float(np.linalg.norm(gtsam.Rot3.Logmap(gtsam.Rot3.Expmap(a).between(gtsam.Rot3.Expmap(b)))))
