"""Odometry: its motion as the IMU sees it, through the extrinsics, with the noise carried along."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion import NOT_TURNED, T_I_L, Drive, scans, tilted_circle
from numeric import PLACED, assert_jacobians, residual

from holdfast.config.sensors import OdometryConfig
from holdfast.errors import EstimatorError
from holdfast.events import Outcome
from holdfast.messages import SensorPose
from holdfast.point_cloud import Layout, PointCloud
from holdfast.sensors.odometry import CONFIGURED, MAX_SCALE, OdometryModel, OdometryNoise, is_possible

XI, XJ = gtsam.symbol("x", 0), gtsam.symbol("x", 1)
CONFIG = OdometryConfig(kind="odometry", topic="/lidar", robust_loss={"kind": "none"})
DRIFTLESS = {"drift_m_per_sqrt_m": 0.0, "drift_rad_per_sqrt_m": 0.0, "drift_rad_per_sqrt_rad": 0.0}
MODEL = OdometryModel("lidar", CONFIG, T_I_L)
NOISE = OdometryNoise(MODEL)
UP = np.array([0.0, 0.0, 1.0])


def noise_of(T_I_L=NOT_TURNED, **settings):
    return OdometryNoise(OdometryModel("lidar", CONFIG.model_copy(update=settings), T_I_L))


def on_track(scan):
    return MODEL.convert(scan, PLACED).T_I0_I


def pair(nav_i, nav_j):
    values = gtsam.Values()
    values.insert(XI, nav_i)
    values.insert(XJ, nav_j)
    return values


def test_a_scan_is_refused_where_a_pose_is_needed():
    scan = PointCloud(1, 1, "lidar", "lidar", Layout((), 0, 0, 0, 0, False), np.zeros(0, np.uint8))
    with pytest.raises(EstimatorError, match=r"lidar: a PointCloud came \(allowed: SensorPose\)"):
        MODEL.convert(scan, PLACED)


def test_a_covariance_of_a_kilometre_says_that_the_motion_was_not_measured():
    for sigma_m, begins in ((1e3, True), (0.5, False)):
        covariance = np.diag(np.repeat([10.0**2, sigma_m**2], 3))
        message = SensorPose(1, 1, "lidar", np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), covariance)
        assert MODEL.convert(message, PLACED).begins_anew is begins


@pytest.mark.parametrize("motion", [tilted_circle(), Drive(start_s=-3.0)])
def test_the_track_of_the_lidar_becomes_the_track_of_the_imu(motion):
    for k, scan in enumerate(scans(motion, 0.0, 3.0)):
        expected = motion.pose(0.0).between(motion.pose(k / 5.0))
        assert on_track(scan).equals(expected, 1e-9)


def test_the_factor_is_zero_at_the_truth_whatever_the_velocity():
    motion = tilted_circle()
    first, second = scans(motion, 1.0, 1.2)
    factor = NOISE.relative_factor(XI, XJ, on_track(first).between(on_track(second)))
    truth = pair(motion.nav(1.0), motion.nav(1.2))
    np.testing.assert_allclose(residual(factor, truth)[:6], np.zeros(6), atol=1e-7)
    # 3 m/s against a sigma of 1e6 m/s
    np.testing.assert_allclose(residual(factor, truth)[6:], np.zeros(3), atol=1e-5)


def test_the_residual_counts_sigmas_of_the_motion_seen_by_the_lidar():
    """Without extrinsics: 0.03 m along x at sigma 0.02 m, 0.004 rad at 0.002 rad."""
    noise = noise_of(**DRIFTLESS)
    motion = gtsam.Pose3(gtsam.Rot3.Yaw(0.1), np.array([0.3, 0.0, 0.0]))
    factor = noise.relative_factor(XI, XJ, motion)
    shifted = motion * gtsam.Pose3(gtsam.Rot3(), np.array([0.03, 0.0, 0.0]))
    assert factor.error(pair(gtsam.NavState(), gtsam.NavState(shifted, np.zeros(3)))) == pytest.approx(0.5 * 1.5**2)
    turned = motion * gtsam.Pose3(gtsam.Rot3.Yaw(0.004), np.zeros(3))
    assert factor.error(pair(gtsam.NavState(), gtsam.NavState(turned, np.zeros(3)))) == pytest.approx(0.5 * 2.0**2)


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_the_factor_has_the_jacobians_that_it_claims(seed):
    rng = np.random.default_rng(seed)
    navs = [
        gtsam.NavState(gtsam.Rot3.Expmap(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 5.0, 3), rng.normal(0.0, 2.0, 3))
        for _ in range(2)
    ]
    motion = navs[0].pose().between(navs[1].pose()) * gtsam.Pose3.Expmap(rng.normal(0.0, 0.02, 6))
    assert_jacobians(NOISE.relative_factor(XI, XJ, motion), pair(*navs))


def test_the_noise_is_carried_from_the_lidar_to_the_imu():
    """Sampled: noise at the lidar, seen at the IMU, has the covariance that the factor weighs with."""
    motion = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.05, 0.3), np.array([0.4, 0.1, 0.02]))
    T_L_motion = T_I_L.inverse() * motion * T_I_L
    distance, angle = np.linalg.norm(T_L_motion.translation()), np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation()))
    rotation = np.hypot(CONFIG.drift_rad_per_sqrt_m * distance**0.5, CONFIG.drift_rad_per_sqrt_rad * angle**0.5)
    translation = np.hypot(CONFIG.translation_sigma_m, CONFIG.drift_m_per_sqrt_m * distance**0.5)
    sigmas = np.repeat([np.hypot(CONFIG.rotation_sigma_rad, rotation), translation], 3)
    rng = np.random.default_rng(5)
    count = 20_000
    noisy = [T_I_L * T_L_motion * gtsam.Pose3.Expmap(e) * T_I_L.inverse() for e in rng.normal(0.0, sigmas, (count, 6))]
    seen = np.array([gtsam.Pose3.Logmap(motion.between(sample)) for sample in noisy])
    claimed = NOISE.covariance(motion)
    scale = np.sqrt(np.diag(claimed))
    correlation = claimed / np.outer(scale, scale)
    # a sample covariance is uncertain by sqrt(2 / N); five of those
    np.testing.assert_allclose(np.cov(seen.T) / np.outer(scale, scale), correlation, atol=5.0 * np.sqrt(2.0 / count))
    assert abs(correlation[:3, 3:]).max() > 0.01  # the lever arm couples rotation and motion


def test_drift_grows_with_the_root_of_distance_and_rotation():
    noise = noise_of()
    still, turned, driven = (
        np.diag(noise.covariance(motion))
        for motion in (
            gtsam.Pose3(),
            gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.zeros(3)),
            gtsam.Pose3(gtsam.Rot3(), np.array([40.0, 0.0, 0.0])),
        )
    )
    assert turned[0] - still[0] == pytest.approx(CONFIG.drift_rad_per_sqrt_rad**2)
    assert turned[3] == pytest.approx(still[3])
    assert driven[3] - still[3] == pytest.approx(CONFIG.drift_m_per_sqrt_m**2 * 40.0)
    assert driven[0] - still[0] == pytest.approx(CONFIG.drift_rad_per_sqrt_m**2 * 40.0)


def test_a_standing_odometry_hardly_drifts_and_a_moving_one_as_configured():
    """What two scans cannot distinguish from their own noise, twice 2 cm, is no distance."""
    still = NOISE.drift(gtsam.Pose3(gtsam.Rot3(), np.array([0.03, 0.0, 0.0])), 1.0)
    moving = NOISE.drift(gtsam.Pose3(gtsam.Rot3(), np.array([4.04, 0.0, 0.0])), 1.0)
    assert (still[3:] < 2e-4).all() and (still[:3] < 2e-5).all()
    np.testing.assert_allclose(moving[3:], CONFIG.drift_m_per_sqrt_m * 2.0, rtol=0.01)


def test_an_anchored_scan_has_half_the_variance_of_a_motion_between_two():
    noise = noise_of(**DRIFTLESS)
    pose = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([5.0, 2.0, 0.0]))
    shifted = pose * gtsam.Pose3(gtsam.Rot3(), np.array([0.03, 0.0, 0.0]))
    values = pair(gtsam.NavState(), gtsam.NavState(shifted, np.zeros(3)))
    anchored, relative = (
        factor(XI, XJ, pose).error(values) for factor in (noise.anchored_factor, noise.relative_factor)
    )
    assert anchored == pytest.approx(2.0 * relative) and relative > 0.5


def test_the_drift_between_two_poses_on_the_track_has_the_configured_size():
    motion = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([1.5, 0.2, 0.0]))
    factor = NOISE.drift_factor(XI, XJ, motion, 1.0, UP)
    here = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 1.0), np.array([100.0, 5.0, 1.0]))
    sigma = NOISE.drift(motion, 1.0)
    for index in (2, 4):
        off = np.zeros(6)
        off[index] = 2.0 * sigma[index]
        moved = here * motion * T_I_L * gtsam.Pose3.Expmap(off) * T_I_L.inverse()  # the sensor drifts, not the IMU
        values = pair(gtsam.NavState(here, np.zeros(3)), gtsam.NavState(moved, np.zeros(3)))
        assert factor.error(values) == pytest.approx(2.0, rel=1e-3)


def test_a_track_whose_yaw_drifts_less_than_its_tilt_is_stiff_about_the_vertical_alone():
    noise, up = noise_of(T_I_L), np.array([0.6, 0.0, 0.8])
    noise.learnt = CONFIGURED._replace(tilt_drift=2.0, yaw_drift=0.5)
    motion = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([1.5, 0.2, 0.0]))
    factor, sigma = noise.drift_factor(XI, XJ, motion, 1.0, up), noise.drift(motion, 1.0)[0]
    for axis, times in ((up, 0.5), (np.array([0.0, 1.0, 0.0]), 2.0), (np.array([0.8, 0.0, -0.6]), 2.0)):
        turn = gtsam.Pose3(gtsam.Rot3.Expmap(times * sigma * T_I_L.rotation().unrotate(axis)), np.zeros(3))
        moved = motion * T_I_L * turn * T_I_L.inverse()
        values = pair(gtsam.NavState(), gtsam.NavState(moved, np.zeros(3)))
        assert factor.error(values) == pytest.approx(0.5, rel=1e-3)


def test_a_pseudo_global_pose_leaves_roll_and_pitch_to_the_imu():
    noise = noise_of(**DRIFTLESS)
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.05, 2.0), np.array([3.0, 4.0, 1.0]))
    values = gtsam.Values()
    errors = {}
    for name, rotation in (("yaw", gtsam.Rot3.Yaw(0.01)), ("roll", gtsam.Rot3.Roll(0.01))):
        values = gtsam.Values()
        R = rotation * pose.rotation()
        values.insert(XI, gtsam.NavState(R, pose.translation(), np.array([9.0, 0.0, 0.0])))
        errors[name] = noise.pseudo_global_factor(XI, pose).error(values)
    assert errors["yaw"] > 0.5 * (0.01 / CONFIG.rotation_sigma_rad) ** 2
    assert errors["roll"] < 0.01 * errors["yaw"]


def test_a_jump_is_distinguished_from_noise_by_the_motion_of_the_imu():
    motion = gtsam.Pose3(gtsam.Rot3.Yaw(0.1), np.array([0.3, 0.0, 0.0]))
    noise = gtsam.Pose3.Expmap(3.0 * np.repeat([0.002, 0.02], 3))
    assert NOISE.jump(motion * noise, motion) is None
    assert NOISE.jump(motion * gtsam.Pose3(gtsam.Rot3(), np.array([0.5, 0.0, 0.0])), motion) is not None


def test_an_odometry_that_proves_to_be_worse_is_trusted_less_up_to_a_bound():
    noise, motion = noise_of(), gtsam.Pose3(gtsam.Rot3(), np.array([0.3, 0.0, 0.0]))
    before = noise.covariance(motion)
    noise.trust_less(3.0)
    np.testing.assert_allclose(noise.covariance(motion), 9.0 * before)
    for _ in range(10):
        noise.trust_less(3.0)
    assert noise.scale == MAX_SCALE


def test_no_machine_moves_at_more_than_a_hundred_metres_per_second_nor_turns_at_more_than_ten_radians():
    driven = gtsam.Pose3(gtsam.Rot3.Yaw(1.0), np.array([0.0, 20.0, 0.0]))
    turned = gtsam.Pose3(gtsam.Rot3.Yaw(-2.0), np.array([0.0, 1.0, 0.0]))
    for motion in driven, turned:
        assert is_possible(motion, 0.201)
        assert not is_possible(motion, 0.199)


def test_velocity_is_free():
    motion = tilted_circle()
    factor = NOISE.relative_factor(XI, XJ, motion.pose(0.0).between(motion.pose(0.2)))
    still = pair(
        gtsam.NavState(motion.pose(0.0), np.zeros(3)), gtsam.NavState(motion.pose(0.2), np.array([30.0, 0.0, 0.0]))
    )
    assert factor.error(still) < 1e-8


# --- conversion -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["position", "quaternion"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_pose_that_is_not_finite_is_refused(field, value):
    scan = scans(Drive(), 0.0, 0.1)[0]
    broken = getattr(scan, field).copy()
    broken[1] = value
    assert MODEL.convert(replace(scan, **{field: broken}), PLACED) is Outcome.NOT_FINITE


@pytest.mark.parametrize("value", [1e300, -1e12])
def test_a_position_beyond_any_site_is_out_of_range(value):
    scan = scans(Drive(), 0.0, 0.1)[0]
    assert MODEL.convert(replace(scan, position=np.array([0.0, value, 0.0])), PLACED) is Outcome.OUT_OF_RANGE


def test_the_time_offset_is_applied():
    scan = scans(Drive(), 0.0, 0.1)[0]
    early = OdometryModel("lidar", CONFIG.model_copy(update={"time_offset_s": -0.1}), T_I_L).convert(scan, PLACED)
    assert (early.stamp_ns, early.sensor) == (scan.stamp_ns - 100_000_000, "lidar")
