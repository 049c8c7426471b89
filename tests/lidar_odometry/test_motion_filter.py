"""What the filter makes of registrations and forces; everything in closed form."""

import gtsam
import numpy as np
import pytest

from holdfast.lidar_odometry.deskew import Rates
from holdfast.lidar_odometry.motion_filter import QUIET, UNMEASURED, MotionFilter

INTERVAL_S = 0.2
TIMES_S = np.arange(-0.4, 0.3, 0.005)
GRAVITY = np.array([0.0, 0.0, -9.81])
LEVER = np.array([0.5, 0.0, 2.0])
NO_AXES = np.zeros((3, 0))
REGISTERED = np.eye(3) * 0.003**2
SLOPE = gtsam.Rot3.RzRyRx(0.1, -0.15, 0.4)  # the axes of the first sweep against the level


def velocity_m_s(t):
    """Of a machine that speeds up and brakes within a second, along its own x axis."""
    return 1.0 - np.cos(2.0 * np.pi * t)


def driven_m(t):
    return t - np.sin(2.0 * np.pi * t) / (2.0 * np.pi)


def pose(t):
    """Of the lidar in the axes of the first sweep; the attitude does not change."""
    return gtsam.Pose3(gtsam.Rot3(), np.array([driven_m(t), 0.0, 0.0]) + LEVER)


def rates(t, rng, *, shaken_m_s2=0.0, bias=0.0, forces=True):
    """Readings around a time."""
    along = 2.0 * np.pi * np.sin(2.0 * np.pi * (t + TIMES_S))
    force = np.array([1.0, 0.0, 0.0]) * along[:, None] - SLOPE.unrotate(GRAVITY) + bias
    force += shaken_m_s2 * rng.standard_normal(force.shape)
    turning = np.zeros((len(TIMES_S), 3))
    return Rates(TIMES_S, turning, force, LEVER) if forces else Rates(TIMES_S, turning)


def run(count, unheld=NO_AXES, **options):
    """Errors of the predicted positions (N, 3) and of the velocities after correction (N, 3), and the last filter."""
    rng = np.random.default_rng(4)
    machine = MotionFilter.beginning().placed(pose(0.0), rates(0.0, rng, **options))
    positions, velocities = [], []
    for number in range(1, count):
        t = number * INTERVAL_S
        around = rates(t, rng, **options)
        machine, guess = machine.predicted(pose(t - INTERVAL_S), around, -INTERVAL_S, 0.0)
        positions.append(guess.translation() - pose(t).translation())
        measured = pose(t).compose(gtsam.Pose3(gtsam.Rot3(), rng.normal(0.0, 0.003, 3)))
        machine = machine.corrected(measured, around, REGISTERED, unheld)
        velocities.append(machine.moving(pose(t), around).velocity - [velocity_m_s(t), 0.0, 0.0])
    return np.array(positions), np.array(velocities), machine


def rms(errors):
    return float(np.sqrt(np.mean(errors[10:] ** 2)))


def test_an_accelerometer_predicts_what_a_constant_velocity_cannot():
    positions, velocities, _ = run(100)
    assert rms(positions) < 0.004
    assert rms(velocities) < 0.01
    assert rms(run(100, forces=False)[0]) > 0.05


def test_gravity_on_a_slope_and_a_bias_are_told_from_the_motion():
    _, _, machine = run(150, bias=np.array([0.1, -0.1, 0.05]))
    # the attitude does not change, so only their sum is known
    known = machine.moving(pose(0.0), rates(0.0, np.random.default_rng(0))).gravity
    np.testing.assert_allclose(known, SLOPE.unrotate(GRAVITY) - [0.1, -0.1, 0.05], atol=0.01)


def test_an_accelerometer_that_is_shaken_is_believed_less_and_one_that_is_quiet_more():
    quiet, shaken = run(300)[2].noise, run(300, shaken_m_s2=3.0)[2].noise
    assert QUIET <= quiet < 0.02
    assert 0.5 * 3.0 * np.sqrt(0.005) < shaken < 2.0 * 3.0 * np.sqrt(0.005)
    assert rms(run(300, shaken_m_s2=3.0)[0]) < 0.02
    assert run(300, shaken_m_s2=300.0)[2].noise == pytest.approx(UNMEASURED)


def test_an_imu_that_falls_silent_and_comes_back_makes_no_jump():
    """Without it the filter follows the lidar, 2 m above, instead of the IMU."""
    machine, rng = run(60)[2], np.random.default_rng(5)
    for number in range(60, 75):
        t = number * INTERVAL_S
        around = rates(t, rng, forces=not 64 <= number < 68)
        machine, guess = machine.predicted(pose(t - INTERVAL_S), around, -INTERVAL_S, 0.0)
        # the lever is 2 m; without it the machine speeds up by 6 m/s^2 unseen
        assert np.linalg.norm(guess.translation() - pose(t).translation()) < 0.5
        machine = machine.corrected(pose(t), around, REGISTERED, NO_AXES)
    assert np.linalg.norm(guess.translation() - pose(t).translation()) < 0.02


@pytest.mark.parametrize("jump_m", [0.05, 0.3])
def test_a_registration_that_jumps_is_not_taken_for_a_velocity_that_the_imu_would_have_felt(jump_m):
    machine, rng = run(60)[2], np.random.default_rng(6)
    for number in range(60, 66):
        t = number * INTERVAL_S
        around = rates(t, rng)
        machine, guess = machine.predicted(pose(t - INTERVAL_S), around, -INTERVAL_S, 0.0)
        assert np.linalg.norm(guess.translation() - pose(t).translation()) < 0.02
        jump = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, jump_m if number == 60 else 0.0, 0.0]))
        machine = machine.corrected(pose(t).compose(jump), around, REGISTERED, NO_AXES)


def test_without_an_imu_it_is_a_velocity():
    rng, errors = np.random.default_rng(7), []
    machine = MotionFilter.beginning().placed(gtsam.Pose3(), rates(0.0, rng, forces=False))
    for number in range(1, 30):
        around = rates(number * INTERVAL_S, rng, forces=False)
        at = gtsam.Pose3(gtsam.Rot3(), np.array([max(number - 15, 0) * INTERVAL_S * 2.0, 0.0, 0.0]))
        before = gtsam.Pose3(gtsam.Rot3(), np.array([max(number - 16, 0) * INTERVAL_S * 2.0, 0.0, 0.0]))
        machine, guess = machine.predicted(before, around, -INTERVAL_S, 0.0)
        errors.append(np.linalg.norm(guess.translation() - at.translation()))
        machine = machine.corrected(at, around, REGISTERED, NO_AXES)
    assert errors[15] > 0.3  # the first step of 0.4 m is unforeseen
    assert max(errors[17:]) < 0.05


def test_the_covariance_holds_the_velocity():
    _, velocities, machine = run(100)
    sigma = np.sqrt(machine.covariance[3, 3])
    assert np.mean(np.abs(velocities[10:]) < 3.0 * sigma) > 0.95


def test_a_direction_that_a_sweep_does_not_hold_teaches_nothing():
    _, _, machine = run(40, np.array([[1.0], [0.0], [0.0]]))
    sigmas = np.sqrt(machine.covariance.diagonal())
    assert sigmas[3] > 1.0
    assert sigmas[4] < 0.02
