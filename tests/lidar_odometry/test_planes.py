"""Planes around points follow the surface, whether a lidar has many rings or few."""

import numpy as np
import pytest
from yard import ELEVATIONS_DEG, standing, sweep

pytest.importorskip("small_gicp")
import small_gicp

from holdfast.lidar_odometry.planes import SPARSE, Planes, points_of, share_on_lines

FEW_DEG = np.linspace(15.0, -15.0, 16)
SPACING_M = 0.35


def thinned(elevations_deg):
    """A sweep of the yard, thinned."""
    rng = np.random.default_rng(5)
    points = sweep(0, rng, standing, times=False, elevations_deg=elevations_deg).points
    return small_gicp.voxelgrid_sampling(points, SPACING_M)


def tilts_of_ground(cloud):
    """Angles (N,) of the planes around points on the bare ground to it [rad]."""
    points = points_of(cloud)
    on_ground = np.flatnonzero((points[:, 2] < -2.9) & (np.hypot(points[:, 0], points[:, 1]) < 16.0))
    normals = np.array([np.linalg.eigh(cloud.cov(k)[:3, :3])[1][:, 0] for k in on_ground])
    return np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0))


@pytest.mark.parametrize(("elevations_deg", "are_few"), [(ELEVATIONS_DEG, False), (FEW_DEG, True)])
def test_few_rings_are_told_from_many(elevations_deg, are_few):
    cloud = thinned(elevations_deg)
    assert (share_on_lines(points_of(cloud), small_gicp.KdTree(cloud)) > SPARSE) == are_few


@pytest.mark.parametrize("elevations_deg", [ELEVATIONS_DEG, FEW_DEG])
def test_planes_lie_on_the_ground(elevations_deg):
    planes = Planes.around(thinned(elevations_deg), 1)
    assert np.median(tilts_of_ground(planes.cloud)) < 0.01


def test_a_sweep_of_fewer_points_than_neighbours_has_planes_too():
    planes = Planes.around(small_gicp.PointCloud(np.random.default_rng(2).uniform(-5.0, 5.0, (8, 3))), 1)
    assert np.isfinite(planes.cloud.covs()).all()
