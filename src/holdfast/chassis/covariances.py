"""How well pose and twist of the chassis are known, of many states at once."""

from typing import Any, NamedTuple

import numpy as np

from holdfast.config.model import Config
from holdfast.geometry.rotations import skew
from holdfast.messages import Array
from holdfast.sensors.mount import Mount


class BaseCovariances(NamedTuple):
    """Covariances (N, 6, 6) of pose and twist of B, rotation before translation, in the axes of B."""

    pose: Array
    twist: Array


class BaseUncertainty:
    """What the estimate and the turn joint leave uncertain of the chassis: (38) and (39) in docs/math.md.

    Not part of every `BaseState`, because it takes as long as the state itself.
    """

    def __init__(self, config: Config) -> None:
        self._mount = Mount(config, config.frames.base)
        R_B_J = self._mount.T_J_S.rotation().matrix().T
        self._axis: Array = R_B_J[:, 2].copy()  # of the joint, in B
        self._arm: Array = R_B_J @ self._mount.T_J_S.translation()  # where B's origin is from it
        self._across_axis: Array = np.eye(3) - np.outer(self._axis, self._axis)
        self._of_axis, self._of_arm = skew(self._axis), skew(self._arm)
        self._of_lever = skew(self._mount.T_I_A.translation())
        by_angle = np.concatenate([-self._axis, self._of_arm @ self._axis])
        self._by_angle: Array = np.outer(by_angle, by_angle)  # what a variance of the angle makes of the pose

    def covariances(self, P: Array, velocities: Array, chassis: Any, rate_variances: Array) -> BaseCovariances:
        """Return the covariances of some states of the chassis.

        Args:
            P: (N, 9, 9) covariances of the estimates of the cabin's IMU.
            velocities: (N, 3) of I in I [m/s].
            chassis: (N,) of `CHASSIS`, what came of each.
            rate_variances: (N,) of the components of the estimate's angular velocity [rad^2/s^2].
        """
        angle_variances = chassis["joint_angle_sigma_rad"] ** 2
        R_B_I, p_B_I = self._mount.T_S_I(chassis["joint_angle_rad"])
        to_B = np.zeros((len(P), 6, 6))  # the adjoint
        to_B[:, :3, :3] = to_B[:, 3:, 3:] = R_B_I
        to_B[:, 3:, :3] = skew(p_B_I) @ R_B_I
        pose = to_B @ P[:, :6, :6] @ to_B.transpose(0, 2, 1) + angle_variances[:, None, None] * self._by_angle
        G = self._sources_to_twist(R_B_I, chassis)
        J = np.zeros((len(P), 3, 9))
        J[:, :, :3] = skew(velocities)
        J[:, :, 6:] = np.eye(3)
        sources = np.zeros((len(P), 8, 8))
        sources[:, :3, :3] = J @ P @ J.transpose(0, 2, 1)
        sources[:, range(3, 6), range(3, 6)] = rate_variances[:, None]
        sources[:, 6, 6] = angle_variances
        sources[:, 7, 7] = chassis["turn_rate_sigma_rad_s"] ** 2
        return BaseCovariances(pose, G @ sources @ G.transpose(0, 2, 1))

    def _sources_to_twist(self, R_B_I: Array, chassis: Any) -> Array:
        """Return what (N, 6, 8) the sources of error make of the twist of B.

        The sources are velocity of I in I, angular velocity of I in I, angle of the joint, rate of the chassis.
        """
        rates = chassis["angular_velocity"]
        velocities_J = chassis["velocity"] - skew(rates) @ self._arm
        G = np.zeros((len(rates), 6, 8))
        G[:, :3, 3:6] = self._across_axis @ R_B_I
        G[:, :3, 6] = rates @ self._of_axis.T
        G[:, :3, 7] = self._axis
        G[:, 3:, :3] = R_B_I
        G[:, 3:, 3:6] = -R_B_I @ self._of_lever
        G[:, 3:, 6] = velocities_J @ self._of_axis.T
        G[:, 3:] -= self._of_arm @ G[:, :3]
        return G
