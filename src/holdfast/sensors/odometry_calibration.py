"""What the graph estimates of an odometry beside its drift: how and where it is mounted, its clock, and its scale.

One parameter (4,) is the rotation vector delta [rad] by which L is mounted otherwise than `extrinsics` says, in its own
axes, and tau [s], by which its poses are younger than their stamps; another (3,) the lever arm d [m] by which L is
elsewhere, in its axes, too; a third (1,) is lambda, the logarithm of how many times too short its distances are, as
those of wheels and cameras may be: (52) in docs/math.md. What is believed of all (8,) is delta, d, lambda and tau.
"""

from collections.abc import Iterable, Sequence
from math import exp, radians

import gtsam
import numpy as np

from holdfast.config.sensors import DriftingConfig
from holdfast.messages import Array
from holdfast.sensors.clock import IF_RIGHT_S
from holdfast.sensors.lever_arm import measured_arm
from holdfast.sensors.scale import measured_scale
from holdfast.sensors.sensor import CHANGE_RAD, STEADY, Parameter

KNOWN = 1e-7  # sigma [rad, s] of what is known
FOUND_RAD = radians(3.0)  # so well motions must tell how a sensor is mounted; sigma of what they told
STEPPED_S = 0.02  # sigma of what motions tell of a clock that has stepped
TURNED = 5.0  # sigmas of a prior, by which an estimate of the mount is none
AT_MOUNT_AND_CLOCK, AT_ARM, AT_SCALE = [0, 1, 2, 7], [3, 4, 5], [6]  # elements of what is believed, by parameter
SIZE = 8
NOMINAL: Array = np.zeros(SIZE)  # as configured


class OdometryCalibration:
    """The parameters of one odometry, and the factors on them.

    Args:
        config: of the odometry.
        T_I_L: the pose of its sensor in I, as configured.

    Attributes:
        lever_arm: (3,) of L as configured [m].
        prior: of the mounting's rotation and the clock; None if both are known.
        arm_prior: of the lever arm; None if it is known.
        scale_prior: of the scale; None if it is known.
        parameters: all that is estimated of the odometry.
    """

    def __init__(self, config: DriftingConfig, T_I_L: gtsam.Pose3) -> None:
        self._T_I_L, self._T_L_I = T_I_L, T_I_L.inverse()
        self._adjoint: Array = T_I_L.AdjointMap()
        self.lever_arm: Array = T_I_L.translation()
        sigmas = np.array([*np.repeat(np.radians(config.mounting_sigma_deg), 3), config.time_offset_sigma_s])
        if_right = np.array([*np.full(3, np.inf), IF_RIGHT_S])
        change = np.array([CHANGE_RAD, CHANGE_RAD, CHANGE_RAD, IF_RIGHT_S])
        prior = Parameter(np.zeros(4), np.maximum(sigmas, KNOWN), if_right, change=change, has_clock=True)
        self.prior = prior if sigmas.any() else None
        self.arm_prior = measured_arm() if self.is_mount_estimated else None
        self.scale_prior = measured_scale(config.scale_sigma) if config.scale_sigma > 0.0 else None
        parts = (self.prior, AT_MOUNT_AND_CLOCK), (self.arm_prior, AT_ARM), (self.scale_prior, AT_SCALE)
        self.parameters = tuple(one for one, _ in parts if one is not None)
        self._elements = [elements for one, elements in parts if one is not None]

    def joined(self, vectors: Iterable[Array]) -> Array:
        """Return what is believed of the odometry (8,), of the vectors of its parameters."""
        belief = NOMINAL.copy()
        for elements, vector in zip(self._elements, vectors, strict=True):
            belief[elements] = vector
        return belief

    @property
    def is_mount_estimated(self) -> bool:
        """Whether the rotation of the mounting is not known."""
        return self.prior is not None and self.prior.sigmas[0] > KNOWN

    def prior_about(self, delta: Array, sigma_rad: float = FOUND_RAD) -> Parameter:
        """Return the prior of one that is mounted otherwise, by a rotation vector (3,); it must be estimated."""
        assert self.prior is not None
        sigmas = np.concatenate([np.maximum(self.prior.sigmas[:3], sigma_rad), self.prior.sigmas[3:]])
        return self.prior._replace(mean=np.concatenate([delta, self.prior.mean[3:]]), sigmas=sigmas)

    def prior_by_clock(self, known: Array, sigmas: Array, early_s: float) -> Parameter:
        """Return the prior of one whose stamps are early by so much from now on.

        What is known (4,) of the mount and its sigmas (4,) stay.
        """
        assert self.prior is not None
        mean, about = np.array([*known[:3], early_s]), np.array([*sigmas[:3], STEPPED_S])
        return self.prior._replace(mean=mean, sigmas=np.maximum(about, KNOWN), if_right=None)

    def is_turned(self, prior: Parameter, belief: Array) -> bool:
        """Whether what is believed (8,) has left a prior, or the configured one, further than the mount is doubted.

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
        """Return a motion of I as it is believed, of one as it is configured: of L, whose distances are scaled."""
        measured, T_I_L = self.of_sensor(motion), self._T_I_L.compose(mounted(belief))
        of_sensor = gtsam.Pose3(measured.rotation(), exp(belief[6]) * measured.translation())
        return T_I_L.compose(of_sensor).compose(T_I_L.inverse())

    def after(
        self, nav: gtsam.NavState, angular_velocity: Array, duration_s: float, beyond: Array = STEADY
    ) -> gtsam.Pose3:
        """Return the pose of I at the time when a pose was measured, by so much after its stamp, which a state has.

        `beyond` (6,) is by how much its mean twist until then differs from that of the state.
        """
        twist = np.concatenate([angular_velocity, nav.bodyVelocity()]) + beyond
        return nav.pose().compose(gtsam.Pose3.Expmap(twist * duration_s))

    def anchored_factor(
        self,
        keys: Sequence[int],
        motion: gtsam.Pose3,
        rate: Array,
        beyond: Array,
        noise: gtsam.noiseModel.Base,
        *,
        known_s: float = 0.0,
    ) -> gtsam.NonlinearFactor:
        """Return the factor on a frame, a node and the parameter: the node's pose after tau is `motion` from the frame.

        Args:
            keys: of the frame, the node and the parameters.
            motion: of I from the frame to the pose, as the configured mounting has it.
            rate: (3,) angular velocity of I at the node [rad/s].
            beyond: (6,) by how much the mean twist over tau differs from that at the node.
            noise: of the error (6,), rotation first.
            known_s: what of tau is in the time of the node already.
        """
        frame_key, node_key, *parameter_keys = keys
        measured = self.of_sensor(motion)

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            frame, node = values.atNavState(frame_key).pose(), values.atNavState(node_key)
            belief = self.joined(map(values.atVector, parameter_keys))
            twist = np.concatenate([rate, node.bodyVelocity()]) + beyond
            by_twist = np.zeros((6, 6), order="F")
            left_s = belief[-1] - known_s
            shift = gtsam.Pose3.Expmap(twist * left_s, by_twist)
            moved = frame.between(node.pose()).compose(shift)
            residual, by_moved, by_belief = self._compared(measured, moved, belief)
            if jacobians is None:
                return residual
            jacobians[0] = np.zeros((6, 9))
            jacobians[0][:, :6] = -by_moved @ moved.inverse().AdjointMap()
            jacobians[1] = np.zeros((6, 9))
            jacobians[1][:, :6] = by_moved @ shift.inverse().AdjointMap()
            by_velocity = by_moved @ by_twist[:, 3:] * left_s
            jacobians[1][:, :3] += by_velocity @ gtsam.SO3.Hat(node.bodyVelocity())
            jacobians[1][:, 6:] = by_velocity
            by_belief[:, -1] = by_moved @ twist
            for k, elements in enumerate(self._elements):
                jacobians[2 + k] = by_belief[:, elements]
            return residual

        return gtsam.CustomFactor(noise, list(keys), error)

    def drift_factor(
        self, keys: Sequence[int], motion: gtsam.Pose3, noise: gtsam.noiseModel.Base
    ) -> gtsam.NonlinearFactor:
        """Return the factor on two frames and the parameter: the second is `motion` from the first, and does not move.

        Args:
            keys: of the frames and the parameters.
            motion: of I from the first to the second, as the configured mounting has it.
            noise: of the error (9,): rotation, translation, velocity of the second frame.
        """
        before_key, key, *parameter_keys = keys
        measured = self.of_sensor(motion)

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            before, here = values.atNavState(before_key).pose(), values.atNavState(key)
            belief = self.joined(map(values.atVector, parameter_keys))
            moved = before.between(here.pose())
            residual, by_moved, by_belief = self._compared(measured, moved, belief)
            if jacobians is not None:
                jacobians[0] = np.zeros((9, 9))
                jacobians[0][:6, :6] = -by_moved @ moved.inverse().AdjointMap()
                jacobians[1] = np.eye(9)
                jacobians[1][:6, :6] = by_moved
                jacobians[1][6:, :3] = gtsam.SO3.Hat(here.bodyVelocity())
                for k, elements in enumerate(self._elements):
                    jacobians[2 + k] = np.vstack([by_belief[:, elements], np.zeros((3, len(elements)))])
            return np.concatenate([residual, here.bodyVelocity()])

        return gtsam.CustomFactor(noise, list(keys), error)

    def _compared(self, measured: gtsam.Pose3, moved: gtsam.Pose3, belief: Array) -> tuple[Array, Array, Array]:
        """Return by how much I moved otherwise than L has measured, and derivatives by its motion and what is believed.

        The motion is brought to L, and scaled there: a scale on what was measured would shrink its noise, too.

        Returns:
            residual: (6,) in the tangent of I.
            by_moved: (6, 6) by the tangent of the motion of I.
            by_belief: (6, 8); zero by the clock, of which the motion knows.
        """
        T_I_L, shrunk = self._T_I_L.compose(mounted(belief)), exp(-belief[6])
        of_sensor = T_I_L.inverse().compose(moved).compose(T_I_L)
        seen = gtsam.Pose3(of_sensor.rotation(), shrunk * of_sensor.translation())
        by_off = np.zeros((6, 6), order="F")
        residual = self._adjoint @ gtsam.Pose3.Logmap(measured.between(seen), by_off)
        by_sensor = self._adjoint @ by_off
        by_sensor[:, 3:] *= shrunk
        by_mount, by_belief = np.zeros((6, 6)), np.zeros((6, SIZE))
        by_mount[:3, :3] = gtsam.Rot3.ExpmapDerivative(belief[:3])
        by_mount[3:, 3:] = gtsam.Rot3.Expmap(-belief[:3]).matrix()
        by_belief[:, :6] = by_sensor @ (np.eye(6) - of_sensor.inverse().AdjointMap()) @ by_mount
        by_belief[:, 6] = -by_sensor[:, 3:] @ of_sensor.rotation().unrotate(of_sensor.translation())
        return residual, by_sensor @ T_I_L.inverse().AdjointMap(), by_belief


def mounted(belief: Array) -> gtsam.Pose3:
    """Return the pose of L as it is in L as it is configured."""
    return gtsam.Pose3(gtsam.Rot3.Expmap(belief[:3]), belief[3:6])


def apart_rad(a: Array, b: Array) -> float:
    """Return the angle between the rotations of two rotation vectors (3,) [rad]."""
    return float(np.linalg.norm(gtsam.Rot3.Logmap(gtsam.Rot3.Expmap(a).between(gtsam.Rot3.Expmap(b)))))
