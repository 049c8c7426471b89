"""A lidar that looks ahead through turning prisms, on a cabin that turns: most of what it sees is new."""

import gtsam
import numpy as np
import pytest
from yard import error, slow_rad, sweep, through_prisms

pytest.importorskip("small_gicp")

from holdfast.lidar_odometry.masked import Masked, Masking
from holdfast.lidar_odometry.small_gicp import SmallGicp


@pytest.fixture(scope="module")
def turned():
    """Most of a turn with 0.2 rad/s: the first pose, and the others with their errors."""
    rng, odometry = np.random.default_rng(1), Masked(SmallGicp(1), Masking())
    poses = [odometry.register(sweep(k, rng, slow_rad, gyroscope=True, rays=through_prisms(rng))) for k in range(120)]
    return poses, np.array([error(pose, poses[0], slow_rad) for pose in poses])


def test_it_holds_the_turn(turned):
    poses, errors = turned
    assert abs(gtsam.Rot3(poses[-1].T_L0_L[:3, :3]).yaw()) > 1.0
    assert np.degrees(np.linalg.norm(errors[:, :3], axis=1)).max() < 0.5
    assert np.linalg.norm(errors[:, 3:], axis=1).max() < 0.1


def test_no_map_is_begun_anew_and_the_world_is_not_taken_for_the_machine(turned):
    poses, _ = turned
    assert not any(pose.restarted for pose in poses)
    assert max(pose.cut for pose in poses) < 0.02
