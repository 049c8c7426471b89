"""The published track against the fixes of a receiver: the paper's measure, and the innovation of each fix.

Only fixes count that are good in truth and within nominal times; each is compared with the antenna's position as it was
published for the time of the fix, which is before the fix could be used.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation import quaternions
from holdfast.evaluation.association import Association, associate
from holdfast.evaluation.evidence import Fixes, Published, Truth
from holdfast.messages import Array
from holdfast.state import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class AtFixes:
    """M fixes of all antennas, one antenna after the other.

    Attributes:
        stamps_ns: (M,).
        fix_errors: (M, 3) fix minus truth in W [m].
        residuals: (M, 3) published antenna minus fix in W [m].
        lever_arms: (M, 3) of the antennas in I [m].
    """

    stamps_ns: NDArray[np.int64]
    fix_errors: Array
    residuals: Array
    lever_arms: Array


def at_fixes(poses: Trajectory, truth: Truth, good: NDArray[np.bool_]) -> AtFixes:
    """Compare published poses (N,), of which (N,) are `good`, with the fixes between two of them."""
    stamps, parts = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 9))]
    for fixes in truth.antennas:
        after = np.searchsorted(poses.stamps_ns, fixes.stamps_ns).clip(1, len(good) - 1)
        chosen = fixes.good & good[after] & good[after - 1]
        if chosen.sum() > 1:
            paired, residuals = _residuals(poses, fixes, chosen)
            errors = fixes.errors[np.isin(fixes.stamps_ns, paired)]
            stamps.append(paired)
            parts.append(np.hstack([errors, residuals, np.tile(fixes.lever_arm, (len(paired), 1))]))
    rows = np.concatenate(parts)
    return AtFixes(np.concatenate(stamps), rows[:, :3], rows[:, 3:6], rows[:, 6:])


def _residuals(poses: Trajectory, fixes: Fixes, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Array]:
    identity = np.tile([0.0, 0.0, 0.0, 1.0], (int(chosen.sum()), 1))
    reference = Trajectory(fixes.stamps_ns[chosen], fixes.positions[chosen], identity)
    x, y, z = fixes.lever_arm.tolist()
    pairs = associate(poses, reference, Association(reference_lever_arm=(x, y, z)))
    residuals: Array = pairs.estimate.positions - pairs.reference.positions
    return pairs.reference.stamps_ns, residuals


def nis(published: Published, found: AtFixes) -> Array:
    """Return the normalised innovation squared (M,) of each fix; 3 on the mean where covariances are consistent.

    nu^T (H P H^T + R)^-1 nu with nu the residual, P the published covariance before the fix,
    H = [-R_W_I (p_I_G)x, R_W_I], and R the true second moment of the errors of the fixes; no mean is removed.
    """
    if len(found.stamps_ns) < 4:
        return np.zeros(0)
    poses = published.world.poses
    at = (np.searchsorted(poses.stamps_ns, found.stamps_ns, side="right") - 1).clip(0)
    R_W_I = quaternions.rotate(poses.quaternions[at][:, None, :], np.eye(3)[None]).transpose(0, 2, 1)
    H = np.concatenate([-R_W_I @ _cross_matrices(found.lever_arms), R_W_I], axis=2)
    noise = found.fix_errors.T @ found.fix_errors / len(found.fix_errors)
    S = H @ published.covariances[at][:, :6, :6] @ H.transpose(0, 2, 1) + noise
    values: Array = np.einsum("ij,ij->i", found.residuals, np.linalg.solve(S, found.residuals[:, :, None])[:, :, 0])
    return values


def _cross_matrices(v: Array) -> Array:
    """Return the matrices (M, 3, 3) of the cross product with v (M, 3)."""
    matrices = np.zeros((len(v), 3, 3))
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return matrices - matrices.transpose(0, 2, 1)
