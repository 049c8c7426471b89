"""Estimates one after the other as arrays, so that what is written of them is computed for many at once."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.state import BaseState, Estimate


class Poses(NamedTuple):
    """Poses of one frame in another: translations (N, 3) [m], quaternions (N, 4) x, y, z, w, rotations (N, 3, 3)."""

    translations: Array
    quaternions: Array
    rotations: Array

    @classmethod
    def of(cls, poses: Iterable[gtsam.Pose3]) -> "Poses":
        """Return the arrays of some poses."""
        translations, quaternions, rotations = [], [], []
        for pose in poses:
            rotation = pose.rotation()
            translations.append(pose.translation())
            quaternions.append(quaternion_xyzw(rotation))
            rotations.append(rotation.matrix())
        return cls(
            np.array(translations).reshape(-1, 3),
            np.array(quaternions).reshape(-1, 4),
            np.array(rotations).reshape(-1, 3, 3),
        )


class Rows(NamedTuple):
    """Estimates, and the chassis at each of them or at none.

    Attributes:
        stamps_ns: (N,).
        velocities: (N, 3) of I in I [m/s].
        covariances: (N, 9, 9) of the states.
    """

    estimates: Sequence[Estimate]
    bases: Sequence[BaseState]
    stamps_ns: list[int]
    T_W_O: Poses
    T_W_I: Poses
    T_O_I: Poses
    T_O_B: Poses
    velocities: Array
    covariances: Array

    @classmethod
    def of(cls, estimates: Sequence[Estimate], bases: Sequence[BaseState] = ()) -> "Rows":
        """Return the arrays of some estimates; `bases` are as many or none."""
        T_W_I = [estimate.nav.pose() for estimate in estimates]
        T_O_I = [estimate.T_W_O.inverse() * pose for estimate, pose in zip(estimates, T_W_I, strict=True)]
        return cls(
            estimates,
            bases,
            [estimate.stamp_ns for estimate in estimates],
            Poses.of(estimate.T_W_O for estimate in estimates),
            Poses.of(T_W_I),
            Poses.of(T_O_I),
            Poses.of(base.T_O_B for base in bases),
            np.array([estimate.nav.bodyVelocity() for estimate in estimates]),
            np.array([estimate.covariance for estimate in estimates]),
        )


def quaternion_xyzw(rotation: gtsam.Rot3) -> Array:
    """Return the quaternion (4,) x, y, z, w."""
    coefficients: Array = rotation.toQuaternion().coeffs()  # type: ignore[attr-defined]  # absent from the stubs
    return coefficients
