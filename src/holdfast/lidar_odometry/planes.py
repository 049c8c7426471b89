"""A plane around each point of a thinned sweep, of as many neighbours as the lidar's rings allow.

Ten neighbours follow a surface where the rings are closer than twice the points' spacing. Where they are farther apart,
as those of a lidar with 16 or 32 rings, or on a flat field, all ten lie on the point's own ring: the plane through them
turns about the ring by chance, and as the rings move with the lidar, so does the map that is made of them. More
neighbours reach the next rings, and cost time.
"""

import numpy as np
import small_gicp

from holdfast.messages import Array

NEIGHBOURS, NEIGHBOURS_OF_SPARSE = 10, 30  # with 80 a plane is wider than what it should follow
SAMPLES = 500
# eigenvalues, width of a neighbourhood to length; a ring's is below 0.001, and of three rings above 0.3
LINE = 0.02
SPARSE = 0.22  # of the points on lines; it is 0.02 to 0.2 with 128 rings and 0.25 to 0.6 with 16 or 32


def estimate_planes(cloud: small_gicp.PointCloud, tree: small_gicp.KdTree, threads: int) -> None:
    """Give each point of a cloud the covariance of a plane, in place; `tree` is of the same points."""
    is_sparse = share_on_lines(np.asarray(cloud.points())[:, :3], tree) > SPARSE
    small_gicp.estimate_covariances(cloud, tree, NEIGHBOURS_OF_SPARSE if is_sparse else NEIGHBOURS, threads)


def share_on_lines(points: Array, tree: small_gicp.KdTree) -> float:
    """Return the share of points (N, 3) [m] whose nearest NEIGHBOURS lie on a line, of up to SAMPLES."""
    sampled = points[:: max(1, len(points) // SAMPLES)]
    around = points[tree.batch_knn_search(sampled, NEIGHBOURS)[0]]
    apart = around - around.mean(axis=1, keepdims=True)
    variances = np.linalg.eigvalsh(apart.transpose(0, 2, 1) @ apart)
    return float((variances[:, 1] < LINE * variances[:, 2]).mean())
