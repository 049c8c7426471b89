"""Whether a file has its quaternions in the order w x y z, which nothing in the file itself tells.

Read in the other order a unit quaternion is another unit quaternion, and the angles between two of them are the same;
but the axes are others. So the rotations of estimate and reference from second to second are compared as vectors in the
world: frames of the body change nothing of them, the yaw of a world neither their vertical part nor the horizontal one.
"""

import numpy as np

from holdfast.evaluation import quaternions
from holdfast.evaluation.association import Pairs
from holdfast.messages import Array

STEP_NS = 1_000_000_000
LEAST_RAD = 0.5  # of rotation in all, below which nothing is told
UNLIKE, LIKE = 0.5, 0.1  # of the squared rotation of the reference, that are left over


def reordered(pairs: Pairs) -> tuple[str, ...]:
    """Return which of `estimate` and `reference` would agree with the other as w x y z, where they do not as they are.

    A turn about the vertical alone does not tell which of the two it is; then it is both.
    """
    if not pairs.oriented:
        return ()
    stamps = pairs.reference.stamps_ns
    index = np.unique(np.searchsorted(stamps, np.arange(stamps[0], stamps[-1], STEP_NS)))
    estimate, reference = (one.quaternions[index] for one in (pairs.estimate, pairs.reference))
    if np.linalg.norm(_turns(reference), axis=1).sum() < LEAST_RAD or _left_over(estimate, reference) < UNLIKE:
        return ()
    found = {"estimate": (_from_wxyz(estimate), reference), "reference": (estimate, _from_wxyz(reference))}
    return tuple(name for name, given in found.items() if _left_over(*given) < LIKE)


def _from_wxyz(q: Array) -> Array:
    return np.roll(q, -1, axis=1)


def _left_over(estimate: Array, reference: Array) -> float:
    a, b = _turns(estimate), _turns(reference)
    return float(np.square(a - b).sum() / np.square(b).sum())


def _turns(q: Array) -> Array:
    """Return the vertical part and the horizontal length of the rotation vectors (N - 1, 2) in the world [rad]."""
    between = quaternions.multiply(q[1:], quaternions.conjugate(q[:-1]))
    between = np.where(between[:, 3:] < 0.0, -between, between)
    length = np.linalg.norm(between[:, :3], axis=1, keepdims=True)
    scale = np.divide(quaternions.angle_rad(between)[:, None], length, out=np.full_like(length, 2.0), where=length > 0)
    vector = between[:, :3] * scale
    turns: Array = np.stack([vector[:, 2], np.hypot(vector[:, 0], vector[:, 1])], axis=1)
    return turns
