"""Estimates one after the other as arrays, so that what is written of them is computed for many at once."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import gtsam
import numpy as np

from holdfast.geometry.rotations import quaternions_xyzw
from holdfast.messages import Array
from holdfast.state import PUBLISHED, BaseState, Estimate


class Poses(NamedTuple):
    """Poses of one frame in another: translations (N, 3) [m], quaternions (N, 4) x, y, z, w, rotations (N, 3, 3)."""

    translations: Array
    quaternions: Array
    rotations: Array

    @classmethod
    def of(cls, poses: Iterable[gtsam.Pose3]) -> "Poses":
        """Return the arrays of some poses."""
        every = list(poses)
        rotations = np.array([pose.rotation().matrix() for pose in every]).reshape(-1, 3, 3)
        translations = np.array([pose.translation() for pose in every]).reshape(-1, 3)
        return cls(translations, quaternions_xyzw(rotations), rotations)


class Rows(NamedTuple):
    """Estimates, and the chassis at each of them or at none.

    Attributes:
        stamps_ns: (N,).
        chassis: (N,) or (0,) of `CHASSIS`.
        velocities: (N, 3) of I in I [m/s].
        angular_velocities: (N, 3) of I in I [rad/s].
        covariances: (N, 9, 9) of the states.
    """

    stamps_ns: list[int]
    chassis: Any
    T_W_O: Poses
    T_W_I: Poses
    T_O_I: Poses
    T_O_B: Poses
    T_W_B: Poses
    velocities: Array
    angular_velocities: Array
    covariances: Array

    @classmethod
    def of(cls, estimates: Sequence[Estimate], bases: Sequence[BaseState] = ()) -> "Rows":
        """Return the arrays of some estimates; `bases` are as many or none."""
        rows, chassis = table(estimates)["estimate"], table(bases)["chassis"]
        nav, W_O, O_B, W_B = rows["nav"], rows["T_W_O"], chassis["T_O_B"], chassis["T_W_B"]
        R_O_W, R_I_W = W_O["R"].transpose(0, 2, 1), nav["R"].transpose(0, 2, 1)
        translations = W_O["p"], nav["p"], turned(R_O_W, nav["p"] - W_O["p"]), O_B["p"], W_B["p"]
        rotations = W_O["R"], nav["R"], R_O_W @ nav["R"], O_B["R"], W_B["R"]
        q, n, m = quaternions_xyzw(np.concatenate(rotations)), len(rows), len(chassis)
        quaternions = q[:n], q[n : 2 * n], q[2 * n : 3 * n], q[3 * n : 3 * n + m], q[3 * n + m :]
        T_W_O, T_W_I, T_O_I, T_O_B, T_W_B = map(Poses, translations, quaternions, rotations)
        return cls(
            [estimate.stamp_ns for estimate in estimates],
            chassis,
            T_W_O,
            T_W_I,
            T_O_I,
            T_O_B,
            T_W_B,
            turned(R_I_W, nav["v"]),
            rows["angular_velocity"],
            rows["covariance"],
        )


def table(rows: Sequence[Estimate] | Sequence[BaseState]) -> Any:
    """Return rows as one array (N,) of `PUBLISHED`."""
    return np.frombuffer(b"".join(bytes(one.row) for one in rows), PUBLISHED)


def turned(R: Array, vectors: Array) -> Array:
    """Return vectors (N, 3) turned by rotations (N, 3, 3)."""
    found: Array = (R @ vectors[:, :, None])[:, :, 0]
    return found


def quaternion_xyzw(rotation: gtsam.Rot3) -> Array:
    """Return the quaternion (4,) x, y, z, w."""
    coefficients: Array = rotation.toQuaternion().coeffs()  # type: ignore[attr-defined]  # absent from the stubs
    return coefficients
