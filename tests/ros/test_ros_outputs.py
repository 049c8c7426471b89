"""Estimates as ROS messages: covariances against samples of the tangent."""

import gtsam
import numpy as np
import pytest

from holdfast.geometry.rotations import quaternions_xyzw
from holdfast.ros.outputs import odometry, pose_covariances
from holdfast.ros.rows import Poses, Rows, quaternion_xyzw
from holdfast.state import BaseState, Estimate

SAMPLES = 20_000
RATE_VARIANCE = 3e-4
ATTITUDES = {
    "level": gtsam.Rot3(),
    "yawed": gtsam.Rot3.Yaw(2.0),
    "askew": gtsam.Rot3.RzRyRx(0.6, -0.9, -2.4),
    "upside down": gtsam.Rot3.RzRyRx(3.0, 0.2, 1.0),
}


def random_covariance(seed, sigmas):
    """A full covariance (9, 9): every pair of errors is correlated."""
    A = np.random.default_rng(seed).normal(size=(9, 9)) * np.asarray(sigmas)[:, None]
    return A @ A.T / 9.0


# small, so that what is not linear does not matter: an angle of 3e-3 rad is wrong by less than 1e-5
TANGENT = random_covariance(3, [1e-3, 2e-3, 3e-3, 0.02, 0.05, 0.01, 0.02, 0.03, 0.01])


def estimate(rotation, velocity=(3.0, -1.0, 0.5), position=(40.0, -30.0, 5.0), covariance=TANGENT):
    nav = gtsam.NavState(rotation, np.array(position), np.array(velocity))
    bias = gtsam.imuBias.ConstantBias()
    return Estimate.of(1, nav, gtsam.Pose3(), bias, covariance, np.array([0.1, 0.2, 0.3]), True)


def message_of(given, pose):
    """The odometry of one estimate for a pose, without the leading dimension."""
    found = odometry(Rows.of([given]), Poses.of([pose]), np.array([RATE_VARIANCE]))
    return type(found)(*(values[0] for values in found))


def sampled(nav):
    """States drawn from the tangent at a state."""
    errors = np.random.default_rng(5).multivariate_normal(np.zeros(9), TANGENT, SAMPLES)
    return [nav.retract(error) for error in errors]


def assert_is_covariance_of(expected, errors):
    """Within 5 standard deviations of what so many samples can resolve: var(S_ij) = (P_ii P_jj + P_ij^2) / N."""
    found = np.cov(errors.T)
    std = np.sqrt((np.outer(np.diag(found), np.diag(found)) + found**2) / len(errors))
    assert (abs(found - expected) < 5 * std).all()


@pytest.mark.parametrize("name", ATTITUDES)
def test_pose_covariance_is_that_of_samples_in_the_axes_of_the_world(name):
    given = estimate(ATTITUDES[name])
    R0, p0 = given.nav.attitude(), given.nav.position()
    errors = []
    for nav in sampled(given.nav):
        rotation = gtsam.Rot3.Logmap(nav.attitude() * R0.inverse())  # about the fixed axes
        errors.append(np.concatenate([nav.position() - p0, rotation]))
    message = message_of(given, given.nav.pose())
    assert_is_covariance_of(message.pose_covariances.reshape(6, 6), np.array(errors))


@pytest.mark.parametrize("name", ATTITUDES)
def test_twist_covariance_is_that_of_samples_in_the_axes_of_the_body(name):
    given = estimate(ATTITUDES[name])
    R0, v0 = given.nav.attitude(), given.nav.velocity()
    errors = [nav.attitude().unrotate(nav.velocity()) - R0.unrotate(v0) for nav in sampled(given.nav)]
    twist = message_of(given, given.nav.pose()).twist_covariances.reshape(6, 6)
    assert_is_covariance_of(twist[:3, :3], np.array(errors))
    np.testing.assert_array_equal(twist[3:, 3:], RATE_VARIANCE * np.eye(3))
    assert not twist[:3, 3:].any()


@pytest.mark.parametrize("name", ATTITUDES)
def test_turning_the_body_leaves_the_covariance_of_the_position_in_the_world(name):
    in_world = np.diag([0.01, 0.04, 0.09]) + 0.005
    R = ATTITUDES[name].matrix()
    covariance = np.eye(9)
    covariance[3:6, 3:6] = R.T @ in_world @ R
    found = pose_covariances(covariance[None], R[None])[0]
    np.testing.assert_allclose(found[:3, :3], in_world, rtol=0, atol=1e-15)


def test_no_lever_to_the_origin_enters_the_covariance():
    near, far = (estimate(ATTITUDES["askew"], position=p) for p in ((0, 0, 0), (1e4, -1e4, 1e3)))
    P = [message_of(given, given.nav.pose()).pose_covariances for given in (near, far)]
    np.testing.assert_array_equal(*P)


def test_twist_is_the_velocity_in_the_body_whichever_frame_the_pose_has():
    given = estimate(gtsam.Rot3.Yaw(np.pi / 2), velocity=(0.0, 2.0, 0.5))
    T_O_W = gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.array([5.0, 6.0, 7.0]))
    for pose in (given.nav.pose(), T_O_W * given.nav.pose()):
        message = message_of(given, pose)
        np.testing.assert_allclose(message.linear, [2.0, 0.0, 0.5], rtol=0, atol=1e-15)
        np.testing.assert_array_equal(message.angular, [0.1, 0.2, 0.3])
        np.testing.assert_array_equal(message.positions, pose.translation())


def test_quaternions_are_x_y_z_w():
    np.testing.assert_allclose(quaternion_xyzw(gtsam.Rot3.Yaw(0.6)), [0, 0, np.sin(0.3), np.cos(0.3)], atol=1e-15)
    np.testing.assert_allclose(quaternion_xyzw(gtsam.Rot3.Roll(0.6)), [np.sin(0.3), 0, 0, np.cos(0.3)], atol=1e-15)


def test_quaternions_of_matrices_are_those_of_gtsam_also_at_half_a_turn():
    turns = [np.pi * np.array(axis) for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.6, 0.8])]
    drawn = np.random.default_rng(2).normal(0.0, 2.0, (200, 3))
    rotations = [gtsam.Rot3.Expmap(turn) for turn in (np.zeros(3), *turns, *drawn)]
    found = quaternions_xyzw(np.array([rotation.matrix() for rotation in rotations]))
    np.testing.assert_allclose(found, [quaternion_xyzw(rotation) for rotation in rotations], rtol=0, atol=1e-15)


def test_the_poses_of_rows_are_those_of_the_estimates():
    T_W_O = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, 0.2, 2.0), np.array([7.0, -5.0, 1.0]))
    T_O_B, T_W_B = (gtsam.Pose3(gtsam.Rot3.Yaw(yaw), np.array([yaw, 2.0, 3.0])) for yaw in (0.4, -2.5))
    plain = estimate(ATTITUDES["askew"])
    given = Estimate.of(1, plain.nav, T_W_O, gtsam.imuBias.ConstantBias(), TANGENT, np.zeros(3), True)
    base = BaseState.of(1, T_O_B, T_W_B, np.zeros(3), np.zeros(3), (0.0, 0.0, 0.0, 0.0), None)
    rows = Rows.of([plain, given], [base, base])
    expected = (T_W_O, given.nav.pose(), T_W_O.inverse() * given.nav.pose(), T_O_B, T_W_B)
    for poses, pose in zip((rows.T_W_O, rows.T_W_I, rows.T_O_I, rows.T_O_B, rows.T_W_B), expected, strict=True):
        for ours, theirs in zip(poses, Poses.of([pose]), strict=True):
            np.testing.assert_allclose(ours[1], theirs[0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(rows.velocities[1], given.nav.bodyVelocity(), rtol=0, atol=1e-15)
