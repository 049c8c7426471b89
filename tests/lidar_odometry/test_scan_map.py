"""What joins the map, and when: the world that stays, once it has shown that it does."""

import gtsam
import numpy as np
import pytest
from yard import BOXES, T_W_L, cast, rays_that_return, standing

small_gicp = pytest.importorskip("small_gicp")

from holdfast.lidar_odometry.planes import Planes, points_of  # noqa: E402
from holdfast.lidar_odometry.scan_map import WAIT_M, WAIT_NS, Placed, ScanMap  # noqa: E402

NOTHING = np.zeros((0, 3))
HALF_M = np.array([3.4, 1.3, 1.3])
STEP_NS = 2 * 10**8
RAYS = rays_that_return(np.random.default_rng(1))
AHEAD = RAYS[RAYS[:, 0] > 0.8]


def truck(number):
    """That stood 8 m to the east until the 10th sweep and drives off to the east with 3 m/s; seen from behind."""
    return np.array([12.0 + 0.6 * max(number - 10, 0), 0.0, 1.6])


def sweep(number, rays=RAYS, moved_m=0.0, *, with_truck=True):
    """A sweep, all of its points in L, and its number of points on the truck."""
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
        self.clouds.append(points_of(cloud) @ T[:3, :3].T + T[:3, 3])


def mapped(count, **options):
    scan_map = ScanMap(0.5, 1)
    scan_map._voxels = Recorded()
    for number in range(count):
        placed, points = sweep(number, **options)
        scan_map.add(placed, points, NOTHING, met=1.0)
    return scan_map._voxels.clouds


def on_the_truck(world, number):
    return int(np.all(np.abs(world - truck(number)) < HALF_M + 0.02, axis=1).sum())


def test_the_rear_of_a_truck_that_drives_off_does_not_get_into_the_map():
    clouds = mapped(32)
    waited = WAIT_NS // STEP_NS
    assert len(clouds) == 32 - waited
    drove_off = range(13, len(clouds))
    seen = sum(on_the_truck(_in_the_world(number), number) for number in drove_off)
    kept = sum(on_the_truck(clouds[number], number) for number in drove_off)
    assert seen > 200
    assert kept < 0.35 * seen  # before what is low on it the ground is as near


def test_the_world_gets_into_it_whole():
    for number, world in enumerate(mapped(25, with_truck=False)):
        assert len(world) > 0.995 * len(_in_the_world(number, with_truck=False))


def test_a_map_that_has_just_begun_does_not_wait():
    assert len(mapped(5)) == 5


def test_a_lidar_that_looks_ahead_does_not_wait():
    assert len(mapped(25, rays=AHEAD)) == 25


def test_a_sweep_that_meets_little_of_the_map_brings_in_all_that_wait():
    scan_map = ScanMap(0.5, 1)
    scan_map._voxels = Recorded()
    for number in range(20):
        placed, points = sweep(number, with_truck=False)
        scan_map.add(placed, points, NOTHING, met=0.6 if number == 19 else 1.0)
    assert len(scan_map._voxels.clouds) == 20


def test_a_lidar_that_has_moved_on_does_not_wait_for_the_time():
    scan_map = ScanMap(0.5, 1)
    scan_map._voxels = Recorded()
    for number in range(20):
        placed, points = sweep(number, moved_m=0.45 * WAIT_M * max(number - 15, 0), with_truck=False)
        scan_map.add(placed, points, NOTHING, met=1.0)
    assert len(scan_map._voxels.clouds) == 17  # the newest three are within 2 m


def _in_the_world(number, **options):
    placed, _ = sweep(number, **options)
    T = placed.T_L0_L.matrix()
    return points_of(placed.cloud) @ T[:3, :3].T + T[:3, 3]
