"""A smooth odometry frame has no steps, and every step that is put into one is found with its size."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.evaluation.smoothness import Inertial, drift_m, steps
from holdfast.evaluation.states import States
from holdfast.state import Trajectory

RATE_HZ = 100.0
COUNT = 1000


@pytest.fixture
def smooth():
    """A machine on a circle that slews to and fro, as an ideal IMU feels it."""
    t = np.arange(COUNT) / RATE_HZ
    angle, speed = 0.3 * t, 4.0 * 0.3
    positions = np.stack([4.0 * np.cos(angle), 4.0 * np.sin(angle), 0.1 * t], axis=1)
    velocities = np.stack([-speed * np.sin(angle), speed * np.cos(angle), np.full(COUNT, 0.1)], axis=1)
    accelerations = -(0.3**2) * positions * [1, 1, 0]
    yaw, rate = np.sin(0.6 * t), 0.6 * np.cos(0.6 * t)
    poses = Trajectory((t * 1e9).round().astype(np.int64), positions, Rotation.from_euler("z", yaw[:, None]).as_quat())
    rates = np.stack([np.zeros(COUNT), np.zeros(COUNT), rate], axis=1)
    return States(poses, velocities), Inertial(rates, accelerations, np.arange(COUNT) > 0, np.zeros((COUNT, 3)))


def moved(states, row, shift):
    positions = states.poses.positions.copy()
    positions[row:] += shift
    return replace(states, poses=replace(states.poses, positions=positions))


def test_smooth_motion_has_steps_far_below_the_bound_of_the_odometry_frame(smooth):
    shift, rotation = steps(*smooth)
    assert np.isnan(shift[0])
    assert np.nanmax(shift) < 1e-6  # the third derivative of this motion over one period
    assert np.nanmax(rotation) < 1e-4


def test_a_step_of_position_is_found_where_it_is_with_its_size(smooth):
    states, inertial = smooth
    shift, rotation = steps(moved(states, 400, [0.003, 0.0, 0.004]), inertial)
    assert np.nanargmax(shift) == 400
    assert shift[400] == pytest.approx(0.005, abs=1e-6)
    assert np.nanmax(np.delete(shift, 400)) < 1e-6
    assert np.nanmax(rotation) < 1e-4


def test_a_turn_is_found_where_it_is_with_its_size(smooth):
    states, inertial = smooth
    turned = (Rotation.from_rotvec([0.0, 0.0, 0.01]) * Rotation.from_quat(states.poses.quaternions)).as_quat()
    quaternions = np.where(np.arange(COUNT)[:, None] >= 300, turned, states.poses.quaternions)
    shift, rotation = steps(replace(states, poses=replace(states.poses, quaternions=quaternions)), inertial)
    assert np.nanargmax(rotation) == 300
    assert rotation[300] == pytest.approx(np.degrees(0.01), abs=1e-4)
    assert np.nanmax(shift) < 1e-6


def test_a_velocity_that_changes_at_once_is_a_step_of_one_period(smooth):
    states, inertial = smooth
    velocities = states.velocities + np.where(np.arange(COUNT)[:, None] >= 500, [0.3, 0.0, 0.0], 0.0)
    positions = states.poses.positions + np.maximum(np.arange(COUNT) - 499, 0)[:, None] / RATE_HZ * [0.3, 0.0, 0.0]
    shift, _ = steps(States(replace(states.poses, positions=positions), velocities), inertial)
    assert shift[500] == pytest.approx(0.003, abs=1e-6)
    assert np.nanmax(np.delete(shift, 500)) < 1e-6


def test_where_the_imu_was_silent_nothing_is_a_step(smooth):
    states, inertial = smooth
    received = inertial.received & (np.arange(COUNT) != 400)
    shift, rotation = steps(moved(states, 400, [1.0, 0.0, 0.0]), replace(inertial, received=received))
    assert np.isnan([shift[400], rotation[400]]).all()
    assert np.nanmax(shift) < 1e-6


def test_drift_does_not_depend_on_where_the_odometry_frame_lies(smooth):
    truth, _ = smooth
    states = moved(truth, COUNT - 1, [0.0, 0.3, 0.4])
    T = Rotation.from_euler("xyz", [0.1, -0.2, 2.0])
    poses = Trajectory(
        states.poses.stamps_ns,
        T.apply(states.poses.positions) + np.array([5.0, 6.0, 7.0]),
        (T * Rotation.from_quat(states.poses.quaternions)).as_quat(),
    )
    drift, distance = drift_m(replace(states, poses=poses), truth)
    assert drift == pytest.approx(0.5)
    assert distance == pytest.approx(np.hypot(4.0 * 0.3, 0.1) * (COUNT - 1) / RATE_HZ, rel=1e-5)
