"""A plane around each point of a thinned sweep, of as many neighbours as the lidar's rings allow.

Ten neighbours follow a surface where the rings are about as close as the points on them. Where they are farther apart,
as those of a lidar with 16 or 32 rings, or on a flat field, all ten lie on the point's own ring: the plane through them
turns about the ring by chance, and as the rings move with the lidar, so does the map that is made of them. More
neighbours reach the next rings, and cost time.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import small_gicp
from numpy.typing import NDArray

from holdfast.messages import Array

NEIGHBOURS, NEIGHBOURS_OF_SPARSE = 10, 30  # with 80 a plane is wider than what it should follow
SAMPLES = 500
LINE = 0.02  # variance across to along; 2 cm of noise make 0.0005 of 3 m of a ring, and thirty points have 0.5 mostly
SPARSE = 0.22  # of the points on lines; it is 0.02 to 0.2 with 128 rings and 0.25 to 0.6 with 16 or 32


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """Points with the covariance of a plane each.

    Attributes:
        cloud: N points with covariances.
        tree: of these points.
        neighbours: of a point that its plane is made of.
    """

    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree
    neighbours: int

    @classmethod
    def around(cls, cloud: small_gicp.PointCloud, threads: int) -> Self:
        """Return the planes around the points of a thinned sweep, which gets its covariances in place."""
        tree = small_gicp.KdTree(cloud, threads)
        is_sparse = share_on_lines(points_of(cloud), tree) > SPARSE
        neighbours = NEIGHBOURS_OF_SPARSE if is_sparse else NEIGHBOURS
        small_gicp.estimate_covariances(cloud, tree, neighbours, threads)
        return cls(cloud, tree, neighbours)

    @property
    def points(self) -> Array:
        """The points (N, 3) [m]."""
        return points_of(self.cloud)

    def neighbourhoods(self, points: Array) -> Array:
        """Return the points (M, k, 3) that the planes around some of them (M, 3) are made of."""
        around: Array = self.points[self.tree.batch_knn_search(points, self.neighbours)[0]]
        return around


def points_of(cloud: small_gicp.PointCloud) -> Array:
    """Return the points (N, 3) of a cloud."""
    return np.asarray(cloud.points())[:, :3]


def share_on_lines(points: Array, tree: small_gicp.KdTree) -> float:
    """Return the share of points (N, 3) [m] whose nearest NEIGHBOURS lie on a line, of up to SAMPLES."""
    sampled = points[:: max(1, len(points) // SAMPLES)]
    variances, _ = spread(points[tree.batch_knn_search(sampled, NEIGHBOURS)[0]])
    return float(are_lines(variances).mean())


def spread(neighbourhoods: Array) -> tuple[Array, Array]:
    """Return how points (N, k, 3) spread: variances (N, 3) [m^2], increasing, and their axes (N, 3, 3) in columns."""
    apart = neighbourhoods - neighbourhoods.mean(axis=1, keepdims=True)
    variances, axes = np.linalg.eigh(apart.transpose(0, 2, 1) @ apart / neighbourhoods.shape[1])
    return variances, axes


def are_lines(variances: Array) -> NDArray[np.bool_]:
    """Return which neighbourhoods are lines, by their variances (N, 3), increasing."""
    return np.asarray(variances[:, 1] < LINE * variances[:, 2])
