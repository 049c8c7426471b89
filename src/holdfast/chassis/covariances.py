"""How well pose and twist of the chassis are known, of many states at once."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.config.model import Config
from holdfast.geometry.skew import skew
from holdfast.messages import Array
from holdfast.sensors.mount import Mount
from holdfast.sensors.sensor import Joint
from holdfast.state import BaseState, Estimate


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

    def covariances(
        self, estimates: Sequence[Estimate], bases: Sequence[BaseState], rate_variances: Array
    ) -> BaseCovariances:
        """Return the covariances of some states of the chassis.

        Args:
            estimates: of the cabin's IMU.
            bases: what came of each.
            rate_variances: (N,) of the components of the estimate's angular velocity [rad^2/s^2].
        """
        P = np.array([estimate.covariance for estimate in estimates])
        angle_variances = np.array([base.joint_angle_sigma_rad**2 for base in bases])
        T_B_I = [self._mount.T_I_S(Joint(base.joint_angle_rad, 0.0)).inverse() for base in bases]
        to_B = np.array([pose.AdjointMap() for pose in T_B_I])
        pose = to_B @ P[:, :6, :6] @ to_B.transpose(0, 2, 1) + angle_variances[:, None, None] * self._by_angle
        G = self._sources_to_twist(to_B[:, :3, :3], bases)
        J = np.zeros((len(bases), 3, 9))
        J[:, :, :3] = skew(np.array([estimate.nav.bodyVelocity() for estimate in estimates]))
        J[:, :, 6:] = np.eye(3)
        sources = np.zeros((len(bases), 8, 8))
        sources[:, :3, :3] = J @ P @ J.transpose(0, 2, 1)
        sources[:, range(3, 6), range(3, 6)] = rate_variances[:, None]
        sources[:, 6, 6] = angle_variances
        sources[:, 7, 7] = [base.turn_rate_sigma_rad_s**2 for base in bases]
        return BaseCovariances(pose, G @ sources @ G.transpose(0, 2, 1))

    def _sources_to_twist(self, R_B_I: Array, bases: Sequence[BaseState]) -> Array:
        """Return what (N, 6, 8) the sources of error make of the twist of B.

        The sources are velocity of I in I, angular velocity of I in I, angle of the joint, rate of the chassis.
        """
        velocities = np.array([base.velocity for base in bases])
        rates = np.array([base.angular_velocity for base in bases])
        velocities_J = velocities - skew(rates) @ self._arm
        G = np.zeros((len(bases), 6, 8))
        G[:, :3, 3:6] = self._across_axis @ R_B_I
        G[:, :3, 6] = rates @ self._of_axis.T
        G[:, :3, 7] = self._axis
        G[:, 3:, :3] = R_B_I
        G[:, 3:, 3:6] = -R_B_I @ self._of_lever
        G[:, 3:, 6] = velocities_J @ self._of_axis.T
        G[:, 3:] -= self._of_arm @ G[:, :3]
        return G
