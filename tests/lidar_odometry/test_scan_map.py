"""What joins the map, and when: the world that stays, once it has shown that it does."""

import gtsam
import numpy as np
import pytest
from yard import BOXES, T_W_L, cast, rays_that_return, standing

pytest.importorskip("small_gicp")

import small_gicp

from holdfast.lidar_odometry.planes import Planes, points_of
from holdfast.lidar_odometry.scan_map import WAIT_M, WAIT_NS, Placed, ScanMap

NOTHING = np.zeros((0, 3))
HALF_M = np.array([3.4, 1.3, 1.3])
STEP_NS = 2 * 10**8
RAYS = rays_that_return(np.random.default_rng(1))
AHEAD = RAYS[RAYS[:, 0] > 0.8]
STANDS = np.zeros(40)


def truck(number):
    """That stood 8 m to the east until the 10th sweep and drives off to the east with 3 m/s; seen from behind."""
    return np.array([12.0 + 0.6 * max(number - 10, 0), 0.0, 1.6])


def sweep(number, rays=RAYS, moved_m=0.0, *, with_truck=True):
    """A sweep, and all of its points in L."""
    pose = T_W_L(0.0, standing).compose(gtsam.Pose3(gtsam.Rot3(), np.array([moved_m, 0.0, 0.0])))
    middle = truck(number)
    boxes = np.vstack([BOXES, np.concatenate([middle - HALF_M, middle + HALF_M])]) if with_truck else BOXES
    directions = rays @ pose.rotation().matrix().T
    distances = cast(np.tile(pose.translation(), (len(rays), 1)), directions, boxes)
    points = rays[distances < 60.0] * distances[distances < 60.0, None]
    cloud = Planes.around(small_gicp.voxelgrid_sampling(points, 0.35, 1), 1).cloud
    return Placed(cloud, pose, number * STEP_NS), points


class Recorded:
    """The points in the world that a grid is given."""

    def __init__(self):
        self.clouds = []

    def insert(self, cloud, T):
        self.clouds.append(in_the_world(cloud, T))


def in_the_world(cloud, T):
    return points_of(cloud) @ T[:3, :3].T + T[:3, 3]


def all_of(number, **options):
    """The points in the world of a sweep."""
    placed, _ = sweep(number, **options)
    return in_the_world(placed.cloud, placed.T_L0_L.matrix())


def mapped(count, met_by_last=1.0, moved_m=STANDS, **options):
    """The clouds that are in the map after so many sweeps."""
    scan_map = ScanMap(0.5, 1)
    scan_map._voxels = Recorded()
    for number in range(count):
        placed, points = sweep(number, moved_m=moved_m[number], **options)
        scan_map.add(placed, points, NOTHING, met=met_by_last if number == count - 1 else 1.0)
    return scan_map._voxels.clouds


def on_the_truck(world, number):
    return int(np.all(np.abs(world - truck(number)) < HALF_M + 0.02, axis=1).sum())


def test_the_rear_of_a_truck_that_drives_off_does_not_get_into_the_map():
    clouds = mapped(32)
    waited = WAIT_NS // STEP_NS
    assert len(clouds) == 32 - waited
    drove_off = range(13, len(clouds))
    seen = sum(on_the_truck(all_of(number), number) for number in drove_off)
    kept = sum(on_the_truck(clouds[number], number) for number in drove_off)
    assert seen > 200
    assert kept < 0.35 * seen  # before what is low on it the ground is as near


def test_the_world_gets_into_it_whole():
    for number, world in enumerate(mapped(25, with_truck=False)):
        assert len(world) > 0.995 * len(all_of(number, with_truck=False))


def test_a_map_that_has_just_begun_does_not_wait():
    assert len(mapped(5)) == 5


def test_a_lidar_that_looks_ahead_does_not_wait():
    assert len(mapped(25, rays=AHEAD)) == 25


def test_a_sweep_that_meets_little_of_the_map_brings_in_all_that_wait():
    assert len(mapped(20, met_by_last=0.6, with_truck=False)) == 20


def test_a_lidar_that_has_moved_on_does_not_wait_for_the_time():
    clouds = mapped(20, moved_m=0.45 * WAIT_M * np.maximum(np.arange(20) - 15, 0), with_truck=False)
    assert len(clouds) == 17  # the newest three are within 2 m
