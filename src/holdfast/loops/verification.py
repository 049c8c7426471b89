"""Whether two submaps show the same place, and how one lies on the other: GICP from the predicted relative pose."""

from typing import NamedTuple

import gtsam
import numpy as np
import small_gicp

from holdfast.messages import Array

PARTNERS_M = (1.5, 0.5)  # distance to a partner in the first, coarse pass, and in the second
MIN_OVERLAP = 0.6  # of the points have a partner within the second distance
MAX_RESIDUAL = 1.5  # of the library's planes, 3 cm thick
FLOOR_RAD, FLOOR_M = 5e-4, 0.005  # what deskewing and motion within a submap leave, in sigma per axis
AGREES = 5.0  # sigma of the prediction
WEAK_M = 0.5  # if even the best direction is known no better, a match tells nothing
REACH_M = 10.0  # at which a rotation moves points as far as a translation, when directions are compared
FLAT = 0.01  # normals of flat ground vary by 0.1 rad: what so few of them look to is no information
PLANE_M = 0.03  # thickness of the library's planes, the unit of its residuals
CORRELATION = 3.0  # points of one surface share the error of its plane
EPSILON_RAD, EPSILON_M = 1e-5, 1e-4


class Match(NamedTuple):
    """A registration that was verified, or why it was not.

    Attributes:
        T: pose of the later in the earlier submap.
        covariance: (6, 6) rotation [rad], then translation [m], in the later.
        overlap: fraction of points with a partner.
        residual: root mean square of the distances to planes, in their thickness.
        refusal: empty if it was accepted.
    """

    T: gtsam.Pose3
    covariance: Array
    overlap: float
    residual: float
    refusal: str = ""


class Target(NamedTuple):
    """A submap with its search tree."""

    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree


def verified(target: Target, source: Target, predicted: gtsam.Pose3, doubt: Array) -> Match:
    """Register a later submap on an earlier one, and judge the result.

    Args:
        target: of the earlier.
        source: of the later.
        predicted: pose of the later in the earlier.
        doubt: (6, 6) covariance of the prediction.
    """
    T = predicted.matrix()
    for partner_m in PARTNERS_M:
        result = small_gicp.align(
            target.cloud,
            source.cloud,
            target.tree,
            T,
            registration_type="GICP",
            max_correspondence_distance=partner_m,
            rotation_epsilon=EPSILON_RAD,
            translation_epsilon=EPSILON_M,
            max_iterations=30,
        )
        T = result.T_target_source
    overlap = result.num_inliers / source.cloud.size()
    residual = float(np.sqrt(2.0 * result.error / max(result.num_inliers, 1)))
    found = gtsam.Pose3(T)
    if not result.converged or result.num_inliers < 100:
        return Match(found, np.eye(6), overlap, residual, "did not converge")
    P = _covariance(source.cloud, result.num_inliers, residual)
    off = gtsam.Pose3.Logmap(predicted.between(found))
    refusal = ""
    if overlap < MIN_OVERLAP:
        refusal = "too little overlap"
    elif residual > MAX_RESIDUAL:
        refusal = "surfaces do not fit"
    elif np.sqrt(np.linalg.eigvalsh(P[3:, 3:]).min()) > WEAK_M:
        refusal = "degenerate"
    elif off @ np.linalg.solve(P + doubt, off) > AGREES**2 + 6.0:
        refusal = "far from the estimate"
    return Match(found, P, overlap, residual, refusal)


def _covariance(cloud: small_gicp.PointCloud, inliers: int, residual: float) -> Array:
    """Return the covariance (6, 6) of a match, rotation then translation, as far as surfaces look in each direction.

    A point tells of motion along its normal n only: J = (p x n, n), in units in which both parts are alike. The mean
    of J J^T shows directions in which the surfaces slide; their information is that beyond what noisy normals make.
    The Hessian of GICP does not, as its planes have an extent.
    """
    points, normals = np.asarray(cloud.points())[:, :3], np.asarray(cloud.normals())[:, :3]
    J = np.hstack([np.cross(points, normals) / REACH_M, normals])
    seen, directions = np.linalg.eigh(J.T @ J / len(J))
    information = inliers * np.maximum(seen - FLAT, 1e-5 * FLAT) / (CORRELATION * (PLANE_M * residual) ** 2)
    units = np.repeat([1.0 / REACH_M, 1.0], 3)
    P: Array = (directions / information) @ directions.T * np.outer(units, units)
    return P + np.diag(np.repeat([FLOOR_RAD, FLOOR_M], 3) ** 2)
