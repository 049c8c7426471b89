"""Each library on a cabin that slews and stops."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from yard import PERIOD_S, SLEWED_S, START_NS, error, slow_rad, standing, sweep

from holdfast.lidar_odometry.registration import METHODS, make_registration
from holdfast.lidar_odometry.sweep import Sweep

SWEEPS = round(SLEWED_S / 0.2)


def run(method, sweeps, **options):
    """The errors (N, 6) of a method's poses, and the poses."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    odometry = make_registration(method, 1)
    poses = [odometry.register(each) for each in sweeps]
    if cores is not None:  # an adapter may confine its process
        os.sched_setaffinity(0, cores)
    return np.array([error(pose, poses[0], **options) for pose in poses]), poses


@pytest.fixture(scope="module")
def slewing():
    rng = np.random.default_rng(3)
    return [sweep(k, rng) for k in range(SWEEPS)]


@pytest.fixture(scope="module")
def small_gicp(slewing):
    pytest.importorskip("small_gicp")
    return run("small-gicp", slewing)


def test_the_extra_lidar_needs_no_scipy():
    pytest.importorskip("small_gicp")
    program = "import sys; sys.modules['scipy'] = None; import holdfast.lidar_odometry.small_gicp"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_slew_and_back_leaves_no_yaw_and_no_drift(small_gicp):
    errors, _ = small_gicp
    assert np.degrees(np.abs(errors[-1, 2])) < 0.1
    assert np.linalg.norm(errors[-1, 3:]) < 0.01


def test_starting_and_stopping_within_a_sweep_costs_little(small_gicp):
    errors, _ = small_gicp
    assert np.degrees(np.abs(errors[:, 2])).max() < 0.25
    assert np.linalg.norm(errors[:, 3:], axis=1).max() < 0.08


def test_the_gyroscope_takes_what_starting_and_stopping_costs(small_gicp):
    rng = np.random.default_rng(3)
    errors, _ = run("small-gicp", [sweep(k, rng, gyroscope=True) for k in range(SWEEPS)])
    assert np.degrees(np.abs(errors[:, 2])).max() < 0.03
    assert np.linalg.norm(errors[:, 3:], axis=1).max() < 0.4 * np.linalg.norm(small_gicp[0][:, 3:], axis=1).max()


def test_a_standing_machine_does_not_drift():
    rng = np.random.default_rng(4)
    errors, _ = run("small-gicp", [sweep(k, rng, standing) for k in range(20)], angle=standing)
    assert np.linalg.norm(errors[1:, 3:], axis=1).max() < 5e-3
    assert np.linalg.norm(errors[-10:, 3:].mean(axis=0)) < 3e-3
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.02


def test_without_times_a_slow_machine_is_followed_all_the_same():
    rng = np.random.default_rng(5)

    def slow(t):
        return 0.02 * np.asarray(t)

    sweeps = [sweep(k, rng, slow, times=False) for k in range(10)]
    errors, poses = run("small-gicp", sweeps, angle=slow)
    assert [pose.stamp_ns for pose in poses] == [each.stamp_ns for each in sweeps]
    assert np.degrees(np.abs(errors[-1, 2])) < 0.05


def test_the_same_sweeps_give_the_same_bits(slewing):
    first, second = (run("small-gicp", slewing[3:8])[1] for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.T_L0_L, b.T_L0_L)


def test_a_sweep_that_fits_nowhere_begins_a_new_map(slewing):
    lifted = [replace(each, points=each.points + np.array([0.0, 0.0, 9.0])) for each in slewing[3:5]]
    _, poses = run("small-gicp", [*slewing[:3], *lifted])
    assert [pose.restarted for pose in poses] == [False, False, False, True, False]
    assert [pose.covariance is None for pose in poses] == [True, False, False, True, False]


def test_a_gap_begins_a_new_map_where_the_lidar_was_last(slewing):
    _, poses = run("small-gicp", [*slewing[:3], *slewing[9:11]])
    assert [pose.restarted for pose in poses] == [False, False, False, True, False]
    np.testing.assert_array_equal(poses[3].T_L0_L, poses[2].T_L0_L)


@pytest.mark.parametrize("method", ["small-gicp", "genz-icp"])
def test_the_stamp_is_the_instant_to_which_the_pose_belongs(method):
    """At a steady rate a wrong instant shows as an error of yaw: 100 ms would be 1.1 deg."""
    pytest.importorskip(METHODS[method][0])
    rng = np.random.default_rng(7)
    errors, poses = run(method, [sweep(k, rng, slow_rad) for k in range(14)], angle=slow_rad)
    at_s = np.array([pose.stamp_ns - START_NS for pose in poses]) * 1e-9
    delay_s = errors[at_s > 1.4, 2].mean() / 0.2
    assert abs(delay_s) < 0.03


def test_kiss_icp_deskews_to_the_end_of_the_sweep():
    """Its poses here err by more than the instants differ, so its deskewing is asked itself."""
    pytest.importorskip("kiss_icp")
    from holdfast.lidar_odometry.kiss_icp import KissIcp

    swept = Sweep(START_NS, "lidar", np.full((3, 3), 5.0), np.array([0.0, 0.1, 0.2]))
    odometry = KissIcp(1)
    motion = np.eye(4)
    motion[0, 3] = 0.6  # between two sweeps
    moved = odometry._odometry.preprocessor.preprocess(swept.points, swept.phases(), motion)
    np.testing.assert_allclose(moved[:, 0], [4.4, 4.7, 5.0])
    rng = np.random.default_rng(2)
    swept = sweep(0, rng, standing)
    assert odometry.register(swept).stamp_ns == swept.stamp_ns + round(swept.offsets_s.max() * 1e9)


def test_a_lidar_that_drives_already_in_its_first_sweep_is_followed():
    speed_m_s = np.array([4.0, 0.0, 0.0])
    odometry, rng = make_registration("small-gicp", 1), np.random.default_rng(6)
    poses = [odometry.register(sweep(k, rng, standing, velocity=speed_m_s)) for k in range(6)]
    moved_m = np.diff([pose.T_L0_L[:3, 3] for pose in poses], axis=0)
    assert np.abs(moved_m[1:] - PERIOD_S * speed_m_s).max() < 0.02
    assert np.abs(moved_m[0] - PERIOD_S * speed_m_s).max() < 0.04
