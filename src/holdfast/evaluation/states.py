"""States against the truth: errors of attitude, position and velocity in the tangent of their covariances."""

from dataclasses import dataclass

import numpy as np

from holdfast.errors import EstimatorError
from holdfast.evaluation import quaternions
from holdfast.messages import Array
from holdfast.state import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """The motion of one frame in another.

    Attributes:
        poses: of N stamps.
        velocities: (N, 3) of the origin, expressed in the other frame [m/s].
    """

    poses: Trajectory
    velocities: Array


@dataclass(frozen=True, slots=True, eq=False)
class StateErrors:
    """Estimates against the truth at N stamps.

    Attributes:
        tangent: (N, 9) from the estimate to the truth: rotation [rad], position [m] and velocity [m/s] in the body
            frame of the estimate: the order and the frame of `Estimate.covariance`.
        position: (N, 3) estimate minus truth in W [m].
        attitude: (N, 3) rotation vector from the truth to the estimate in W [rad]; its z is the error of heading.
    """

    tangent: Array
    position: Array
    attitude: Array


def state_errors(estimate: States, truth: States) -> StateErrors:
    """Compare states of the same stamps.

    Raises:
        EstimatorError: the stamps differ.
    """
    ours, theirs = estimate.poses, truth.poses
    if not np.array_equal(ours.stamps_ns, theirs.stamps_ns):
        raise EstimatorError("states can be compared at equal stamps only")
    into_body = quaternions.conjugate(ours.quaternions)
    rotation = quaternions.multiply(into_body, theirs.quaternions)
    p, v = theirs.positions - ours.positions, truth.velocities - estimate.velocities
    tangent = [rotation_vector(rotation), quaternions.rotate(into_body, p), quaternions.rotate(into_body, v)]
    back = quaternions.multiply(ours.quaternions, quaternions.conjugate(theirs.quaternions))
    return StateErrors(np.concatenate(tangent, axis=1), -p, rotation_vector(back))


def rotation_vector(q: Array) -> Array:
    """Return the logarithms (..., 3) of rotations, axis times angle within [0, pi] [rad]."""
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    # angle / sin(angle / 2), whose limit for no rotation is 2
    scale = np.divide(2.0 * np.arctan2(sine, q[..., 3:]), sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    vector: Array = scale * q[..., :3]
    return vector


def from_rotation_vector(vector: Array) -> Array:
    """Return the rotations (..., 4) about the vectors (..., 3) by their lengths [rad]."""
    half = np.linalg.norm(vector, axis=-1, keepdims=True) / 2.0
    scale = np.sinc(half / np.pi) / 2.0  # sin(half) / (2 half)
    return np.concatenate([scale * vector, np.cos(half)], axis=-1)
