"""What has come into a sweep, and what was hidden before; never the world that stays."""

import gtsam
import numpy as np
import pytest
from yard import BOXES, ELEVATIONS_DEG, T_W_L, cast, rays_that_return, slow_rad, through_prisms

from holdfast.lidar_odometry.free_space import AGES, AROUND_M, FreeSpace

NOTHING = np.zeros((0, 3))
HALF_M = np.array([1.3, 3.4, 1.3])  # of a truck that drives along y
STEP_S = 0.4
FEW_DEG = np.linspace(25.0, -45.0, 18)
RAYS = rays_that_return(np.random.default_rng(1))


def seen(pose, truck=None, rays=RAYS):
    """Points in L that an instant of the lidar at a pose returns, and which of them lie on the truck."""
    boxes = BOXES if truck is None else np.vstack([BOXES, np.concatenate([truck - HALF_M, truck + HALF_M])])
    directions = rays @ pose.rotation().matrix().T
    distances = cast(np.tile(pose.translation(), (len(rays), 1)), directions, boxes)
    returned = distances < 60.0
    world = pose.translation() + directions[returned] * distances[returned, None]
    on_truck = np.zeros(len(world), bool) if truck is None else np.all(np.abs(world - truck) < HALF_M + 0.02, axis=1)
    return rays[returned] * distances[returned, None], on_truck


def apart_m(points, pose, truck):
    """How far points in L are from the truck."""
    world = points @ pose.rotation().matrix().T + pose.translation()
    return np.linalg.norm(np.maximum(np.abs(world - truck) - HALF_M, 0.0), axis=1)


def lidar(at_s):
    return T_W_L(at_s, slow_rad)


def drives(number):
    """A truck 10 m to the east that drives north with 2 m/s."""
    return np.array([10.0, -9.0 + 2.0 * STEP_S * number, 1.5])


@pytest.fixture(scope="module", params=[ELEVATIONS_DEG, FEW_DEG], ids=["many rings", "few rings"])
def passed(request):
    """A turning lidar that a truck drives past, and the next sweep."""
    space, rays = FreeSpace(), rays_that_return(np.random.default_rng(1), request.param)
    for number in range(12):
        at_s = STEP_S * number
        space.add(seen(lidar(at_s), drives(number), rays)[0], NOTHING, lidar(at_s), at_s)
    pose = lidar(12 * STEP_S)
    return space, pose, *seen(pose, drives(12), rays)


def test_a_truck_that_drives_by_is_not_of_the_world(passed):
    space, pose, points, on_truck = passed
    assert on_truck.sum() > 50
    differs = space.differing(points, pose)
    low = points[:, 2] < -1.5  # there a ring of the ground beside is as near, if the next one is far
    assert differs[on_truck & ~low].mean() > 0.9
    assert differs[on_truck & low].mean() > 0.7  # what is above it tells


def test_the_world_stays_but_for_what_is_around_the_truck(passed):
    space, pose, points, _ = passed
    far = apart_m(points, pose, drives(12)) > 2.0 * AROUND_M
    assert space.differing(points, pose)[far].mean() < 0.01


def test_one_point_alone_takes_nothing_with_it():
    space, rng = FreeSpace(), np.random.default_rng(2)
    for number in range(12):
        space.add(seen(lidar(STEP_S * number))[0], NOTHING, lidar(STEP_S * number), STEP_S * number)
    points, _ = seen(lidar(12 * STEP_S))
    before = space.differing(points, lidar(12 * STEP_S))
    alone = rng.choice(np.flatnonzero(points[:, 2] > -2.0), 8, replace=False)
    points[alone] *= 0.7
    came = space.differing(points, lidar(12 * STEP_S)) & ~before
    assert came[alone].sum() >= 6
    assert came.sum() <= len(alone)


def test_what_the_truck_has_hidden_is_not_used_at_once():
    space = FreeSpace()
    space.add(seen(lidar(0.0), drives(10))[0], NOTHING, lidar(0.0), 0.0)
    bare, _ = seen(lidar(0.0))
    hidden = space.differing(bare, lidar(0.0))
    truck = np.concatenate([drives(10) - HALF_M, drives(10) + HALF_M])
    directions = bare / np.linalg.norm(bare, axis=1, keepdims=True) @ lidar(0.0).rotation().matrix().T
    behind = (
        cast(np.tile(lidar(0.0).translation(), (len(bare), 1)), directions, truck[None])
        < np.linalg.norm(bare, axis=1) - 0.1
    )
    assert hidden[behind].mean() > 0.3
    far = np.linalg.norm(bare[:, None] - bare[hidden & behind][None], axis=2).min(axis=1) > 4.0 * AROUND_M
    assert not hidden[~behind & far].any()


def test_who_parks_is_of_the_world_after_the_last_view():
    space, pose = FreeSpace(), lidar(0.0)
    points, on_truck = seen(pose, drives(10))
    space.add(seen(pose)[0], NOTHING, pose, 0.0)
    assert space.differing(points, pose)[on_truck].mean() > 0.5
    for number in range(1, AGES[-1] + 1):
        space.add(points, NOTHING, pose, STEP_S * number)
    assert not space.differing(points, pose).any()


def test_the_ground_that_an_arm_gives_free_has_not_come():
    space, pose = FreeSpace(), lidar(0.0)
    points, _ = seen(pose)
    azimuths = np.arctan2(points[:, 1], points[:, 0])
    behind_arm = (np.abs(azimuths) < 0.3) & (points[:, 2] < -1.0)
    arm = points[behind_arm] * (2.0 / np.linalg.norm(points[behind_arm], axis=1, keepdims=True))
    space.add(points[~behind_arm], arm, pose, 0.0)
    assert not space.differing(points, pose).any()


def test_a_part_of_the_machine_that_no_ray_comes_back_from_hides_the_ground():
    space, pose = FreeSpace(), lidar(0.0)
    points, _ = seen(pose)
    blocked = np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.3
    space.add(points[~blocked], NOTHING, pose, 0.0)
    assert not space.differing(points, pose).any()


def test_at_a_wrong_pose_nothing_is_cut():
    space = FreeSpace()
    space.add(seen(lidar(0.0))[0], NOTHING, lidar(0.0), 0.0)
    points, _ = seen(lidar(0.0))
    lifted = lidar(0.0).compose(gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 3.0])))
    assert not space.differing(points, lifted).any()


def ahead(rng):
    """Unit vectors of a lidar that looks ahead."""
    return through_prisms(rng, 96).reshape(-1, 3)


def test_what_a_lidar_that_looks_ahead_turns_to_has_not_come():
    space, rng = FreeSpace(), np.random.default_rng(2)
    for number in range(12):
        at_s = STEP_S * number
        points, _ = seen(lidar(at_s), rays=ahead(rng))
        assert space.differing(points, lidar(at_s)).mean() < 0.03
        space.add(points, NOTHING, lidar(at_s), at_s)


def test_a_truck_before_a_lidar_that_looks_ahead_has():
    space, rng, pose = FreeSpace(), np.random.default_rng(3), lidar(0.0)
    for number in range(4):
        space.add(seen(pose, drives(number), ahead(rng))[0], NOTHING, pose, STEP_S * number)
    points, on_truck = seen(pose, drives(8), ahead(rng))
    assert on_truck.sum() > 50
    assert space.differing(points, pose)[on_truck].mean() > 0.7
