"""Closed-form alignment of an estimate with its reference: none, yaw and translation, or a rigid motion."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from holdfast.errors import RecordingError
from holdfast.evaluation import quaternions
from holdfast.evaluation.association import IDENTITY, Pairs
from holdfast.messages import Array
from holdfast.state import Trajectory

AlignmentName = Literal["none", "yaw", "se3"]

_DEGENERATE = 1e-12  # fraction of the scatter of the positions below which a rotation cannot be observed


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The rigid motion that is applied to the estimate: p -> R p + t, R_est -> R R_est.

    Attributes:
        quaternion: (4,) x, y, z, w.
        translation: (3,) [m].
    """

    name: AlignmentName
    quaternion: Array
    translation: Array

    def apply(self, pairs: Pairs) -> Pairs:
        """Move the estimate."""
        moved = Trajectory(
            pairs.estimate.stamps_ns,
            quaternions.rotate(self.quaternion, pairs.estimate.positions) + self.translation,
            quaternions.multiply(self.quaternion, pairs.estimate.quaternions),
        )
        return replace(pairs, estimate=moved)


def align(pairs: Pairs, name: AlignmentName) -> Alignment:
    """Find the motion that minimises the sum of squared distances between the positions of the pairs.

    `none`: the identity; what a machine that works in the frame of the site needs.
    `yaw`: rotation about the vertical and translation, closed form of the plane's Procrustes problem.
    `se3`: rotation and translation without scale (Horn, Closed-form solution of absolute orientation using unit
        quaternions, J. Opt. Soc. Am. A 4, 1987; the result is that of Umeyama 1991 without scale).

    Raises:
        RecordingError: the positions do not determine the rotation, for example because they do not move.
    """
    if name == "none":
        return Alignment(name, IDENTITY, np.zeros(3))
    centre_estimate = pairs.estimate.positions.mean(axis=0)
    centre_reference = pairs.reference.positions.mean(axis=0)
    correlation = (pairs.estimate.positions - centre_estimate).T @ (pairs.reference.positions - centre_reference)
    quaternion = _yaw_only(correlation) if name == "yaw" else _horn(correlation)
    return Alignment(name, quaternion, centre_reference - quaternions.rotate(quaternion, centre_estimate))


def _yaw_only(correlation: Array) -> Array:
    """Maximise trace(Rz(yaw) * correlation) over yaw."""
    sine, cosine = correlation[0, 1] - correlation[1, 0], correlation[0, 0] + correlation[1, 1]
    if np.hypot(sine, cosine) <= _DEGENERATE * max(1.0, np.abs(correlation).max()):
        raise RecordingError("the tracks do not move horizontally, so yaw cannot be aligned; use --align none")
    half_yaw = np.arctan2(sine, cosine) / 2.0
    return np.array([0.0, 0.0, np.sin(half_yaw), np.cos(half_yaw)])


def _horn(correlation: Array) -> Array:
    """Return the eigenvector of Horn's symmetric 4x4 matrix, ordered x, y, z, w here, with the largest eigenvalue."""
    skew = np.array(
        [
            correlation[1, 2] - correlation[2, 1],
            correlation[2, 0] - correlation[0, 2],
            correlation[0, 1] - correlation[1, 0],
        ]
    )
    matrix = np.empty((4, 4))
    matrix[:3, :3] = correlation + correlation.T - np.trace(correlation) * np.eye(3)
    matrix[:3, 3] = matrix[3, :3] = skew
    matrix[3, 3] = np.trace(correlation)
    values, vectors = np.linalg.eigh(matrix)
    if values[3] - values[2] <= _DEGENERATE * max(1.0, abs(values[3])):
        raise RecordingError("the tracks are straight or stand still, so se3 cannot be aligned; use --align yaw")
    best: Array = vectors[:, 3]
    return best
