import gtsam
import numpy as np
import pytest

from holdfast.lidar_odometry.deskew import Moving, Rates, deskew

RNG = np.random.default_rng(1)
OFFSETS_S = np.linspace(0.0, 0.2, 512)
WORLD = RNG.uniform(-20, 20, (512, 3))


def seen(pose):
    """WORLD as a lidar at T_W_L(t) measures it, point k at OFFSETS_S[k]."""
    return np.array([pose(t).transformTo(point) for t, point in zip(OFFSETS_S, WORLD, strict=True)])


@pytest.mark.parametrize("at_s", [0.0, 0.1, 0.2])
def test_a_constant_motion_is_undone_at_any_instant(at_s):
    rate, velocity = np.array([0.1, -0.2, 0.6]), np.array([1.5, -0.4, 0.1])

    def pose(t):  # constant angular velocity, and a constant velocity on the axes of the instant
        return gtsam.Pose3(gtsam.Rot3.Expmap(rate * (t - at_s)), velocity * (t - at_s))

    moved = deskew(seen(pose), OFFSETS_S, at_s, Rates.constant(rate), Moving(velocity))
    np.testing.assert_allclose(moved, WORLD, atol=1e-9)


def test_a_gyroscope_undoes_a_turn_that_starts_within_the_sweep():
    def angle(t):
        return 0.5 * 3.0 * max(0.0, t - 0.05) ** 2

    times_s = np.arange(-0.1, 0.3, 0.005)
    rates = Rates(times_s, np.array([[0.0, 0.0, 3.0 * max(0.0, t - 0.05)] for t in times_s]))
    points = seen(lambda t: gtsam.Pose3(gtsam.Rot3.Yaw(angle(t) - angle(0.1)), np.zeros(3)))
    moved = deskew(points, OFFSETS_S, 0.1, rates, Moving())
    assert np.abs(points - WORLD).max() > 0.3
    np.testing.assert_allclose(moved, WORLD, atol=1e-3)


@pytest.mark.parametrize("at_s", [0.0, 0.07, 0.1])
def test_forces_undo_a_lever_and_an_acceleration_on_a_slope(at_s):
    """An IMU that speeds up, turns and rolls; the lidar 3 m above and 1 m before it."""
    lever, turning, gravity = np.array([1.0, 0.2, 3.0]), np.array([0.3, -0.1, 0.8]), np.array([0.4, -0.3, -9.8])
    velocity, acceleration = np.array([1.5, -0.4, 0.1]), np.array([2.0, 1.0, -0.5])

    def imu(t):  # in the axes of the instant
        after_s = t - at_s
        return gtsam.Pose3(gtsam.Rot3.Expmap(turning * after_s), velocity * after_s + 0.5 * acceleration * after_s**2)

    times_s = np.arange(-0.1, 0.3, 0.002)
    forces = np.array([imu(t).rotation().unrotate(acceleration - gravity) for t in times_s])
    rates = Rates(times_s, np.tile(turning, (len(times_s), 1)), forces, lever)
    arm = gtsam.Pose3(gtsam.Rot3(), lever)
    points = seen(lambda t: (arm.inverse() * imu(t)) * arm)
    moved = deskew(points, OFFSETS_S, at_s, rates, Moving(velocity, gravity))
    assert np.abs(points - WORLD).max() > 1.0
    np.testing.assert_allclose(moved, WORLD, atol=1e-4)


def test_the_last_rate_holds_beyond_what_was_measured():
    rates = Rates(np.array([0.0, 0.1]), np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5]]))
    assert rates.rotation(-0.4, 0.6).yaw() == pytest.approx(0.5)


def test_times_of_points_need_no_order_and_no_regularity():
    order = RNG.permutation(512)
    rate = np.array([0.0, 0.0, 0.6])
    offsets_s = np.sort(RNG.uniform(0, 0.2, 512))
    points = np.array(
        [gtsam.Rot3.Expmap(rate * (t - 0.1)).unrotate(point) for t, point in zip(offsets_s, WORLD, strict=True)]
    )
    moved = deskew(points[order], offsets_s[order], 0.1, Rates.constant(rate), Moving())
    # half a step of time at 0.6 rad/s and 35 m
    np.testing.assert_allclose(moved, WORLD[order], atol=0.6 * 0.5 * 0.2 / 511 * 35)
