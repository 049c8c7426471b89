"""Heading from motion: a batch of fixes and IMU, and when it is not yet certain."""

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, G, machine, ns
from rig import NO_BIAS, buffered, position

from holdfast.graph.alignment import BatchAligner, joint_covariance
from holdfast.graph.alignment_problem import BiasPrior, Evidence, Problems
from holdfast.graph.first_guess import level_attitude
from holdfast.sensors.preintegration import ImuNoise
from holdfast.sensors.registry import sensors_of

CONFIG = machine()
PRIOR = BiasPrior(NO_BIAS, np.repeat([0.1, 0.01], 3))
LIMIT_RAD = np.radians(5.0)
STRAIGHT = Drive(start_s=-10.0, radius_m=1e5, speed=1e-5, tilt=0.0, heave_m=0.0)  # 1 m/s, never turning


def aligned(motion, times, *, offset=lambda _: (0.0, 0.0, 0.0), limit_rad=LIMIT_RAD, motions=(), claim_m=0.01):
    sensors = {"gnss": sensors_of(CONFIG)["gnss"]}
    noise = ImuNoise(CONFIG.imu, CONFIG.graph.position_integration_sigma, G)
    aligner = BatchAligner(Problems(buffered(motion, times[-1] + 0.1), noise, sensors, {}))
    fixes = [position(motion, t, ARM, offset(t), sigma_m=claim_m) for t in times]
    return aligner.solve(Evidence(fixes, [], motions), PRIOR, limit_rad)


@pytest.mark.parametrize("yaw_rad", [-2.5, 0.3, 3.1])
def test_a_curve_gives_attitude_velocity_and_position_whatever_the_heading(yaw_rad):
    drive, times = Drive(start_s=-3.0, yaw_rad=yaw_rad), np.arange(0.1, 4.0, 0.2)
    found = aligned(drive, times)
    assert found.reason.startswith("heading from motion, ")
    assert found.heading_sigma_rad < LIMIT_RAD
    assert found.state.stamp_ns == ns(times[-1])
    error = found.state.nav.localCoordinates(drive.nav(times[-1]))
    assert (abs(error) < 4.0 * np.sqrt(np.diag(found.state.covariance)[:9])).all()
    assert np.linalg.norm(found.state.angular_velocity - drive.readings(times[-1])[1]) < 0.01


def test_a_heading_that_is_less_sure_than_is_needed_is_refused_with_both_numbers():
    found = aligned(Drive(start_s=-3.0), np.arange(0.1, 2.0, 0.2), limit_rad=1e-5)
    assert found.state is None
    assert "heading is known to" in found.reason and "0.0 deg are needed" in found.reason


def test_an_even_straight_drive_fits_more_than_one_heading():
    found = aligned(STRAIGHT, np.arange(0.1, 6.0, 0.2))
    assert found.state is None
    assert found.reason == "the motion so far fits more than one heading"


def test_relative_motions_of_an_odometry_make_an_even_straight_drive_certain():
    """An odometry that moves along x, where GNSS sees the machine go, is the heading."""
    times = np.arange(0.1, 6.0, 0.2)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([0.002, 0.01, 1e6], 3))
    step = STRAIGHT.pose(0.0).between(STRAIGHT.pose(0.2))
    motions = [
        gtsam.BetweenFactorNavState(
            gtsam.symbol("x", k), gtsam.symbol("x", k + 1), gtsam.NavState(step, np.zeros(3)), noise
        )
        for k in range(len(times) - 1)
    ]
    found = aligned(STRAIGHT, times, motions=motions)
    assert found.state is not None
    assert (
        abs(found.state.nav.attitude().rpy()[2] - STRAIGHT.nav(6.0).attitude().rpy()[2]) < 4.0 * found.heading_sigma_rad
    )


def test_fixes_that_no_motion_of_the_imu_explains_are_refused():
    found = aligned(Drive(start_s=-3.0), np.arange(0.1, 4.0, 0.2), offset=lambda t: (3.0 * np.sin(9.0 * t), 0.0, 0.0))
    assert found.state is None
    assert "GNSS and IMU disagree" in found.reason


@pytest.mark.parametrize("claimed", [0.1, 10.0])
def test_the_heading_is_known_as_well_as_residuals_show_whatever_is_claimed(claimed):
    """A claim that is ten times too large must not keep the machine from starting, nor one too small make it sure."""
    drive, times = Drive(start_s=-10.0), np.arange(0.1, 20.0, 0.5)
    for seed in range(5):
        errors = np.random.default_rng(seed).normal(0.0, 0.05, (len(times), 3))
        at = dict(zip(times, errors, strict=True))
        honest, found = (aligned(drive, times, offset=at.get, claim_m=0.05 * factor) for factor in (1.0, claimed))
        assert found.state is not None, found.reason
        assert 0.5 < found.heading_sigma_rad / honest.heading_sigma_rad < 2.0
        turned = found.state.nav.attitude().compose(drive.nav(times[-1]).attitude().inverse())
        assert abs(turned.rpy()[2]) < 3.0 * found.heading_sigma_rad


def test_the_sigma_of_the_heading_is_that_of_its_errors_where_claims_are_ten_times_too_large():
    """What decides whether to start may be modest; what is told then is neither."""
    drive, times, found = Drive(start_s=-10.0), np.arange(0.1, 20.0, 0.5), []
    for seed in range(24):
        errors = np.random.default_rng(seed).normal(0.0, 0.05, (len(times), 3))
        told = aligned(drive, times, offset=dict(zip(times, errors, strict=True)).get, claim_m=0.5)
        R_W_I = told.state.nav.attitude()
        off_rad = gtsam.Rot3.Logmap(R_W_I.compose(drive.nav(times[-1]).attitude().inverse()))[2]
        found.append((off_rad / told.heading_sigma_rad) ** 2)
        P_W = R_W_I.matrix() @ told.state.covariance[:3, :3] @ R_W_I.matrix().T
        assert np.sqrt(P_W[2, 2]) == pytest.approx(told.heading_sigma_rad, rel=0.01)
    assert 0.3 < np.mean(found) < 2.0


def test_a_claim_that_is_too_large_still_bounds_the_position():
    """What all fixes are off by, no residual shows."""
    found = aligned(Drive(start_s=-10.0), np.arange(0.1, 20.0, 0.5), claim_m=1.0)
    assert np.sqrt(np.diag(found.state.covariance)[3:6]).min() > 0.9


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, -0.2), (-1.2, 0.7)])
def test_the_level_attitude_puts_the_specific_force_upright(roll, pitch):
    force = gtsam.Rot3.RzRyRx(roll, pitch, 2.0).unrotate(np.array([0.0, 0.0, G]))
    level = level_attitude(force)
    np.testing.assert_allclose(level.rotate(force), [0.0, 0.0, G], atol=1e-9)
    assert level.rpy() == pytest.approx([roll, pitch, 0.0])


@pytest.mark.parametrize("seed", range(40))
def test_what_hardly_anything_tells_has_no_covariance_or_a_true_one(seed):
    """Information that is lost in rounding beside other may come out as less than none."""
    rng = np.random.default_rng(seed)
    graph, at = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key in range(3):
        at.insert(key, np.zeros(1))
        graph.add(gtsam.PriorFactorVector(key, np.zeros(1), gtsam.noiseModel.Isotropic.Sigma(1, 1e9)))
    for _ in range(2):
        blocks = [block for key in range(3) for block in (key, rng.normal(0.0, 1e3, (1, 1)))]
        linear = gtsam.JacobianFactor(*blocks, np.zeros(1), gtsam.noiseModel.Unit.Create(1))
        graph.add(gtsam.LinearContainerFactor(linear, at))
    try:
        covariance = joint_covariance(graph, at, [0], 1)
    except np.linalg.LinAlgError:
        return
    assert covariance[0, 0] > 0.0


def test_what_nothing_tells_has_no_covariance():
    graph, at = gtsam.NonlinearFactorGraph(), gtsam.Values()
    at.insert(0, np.zeros(2))
    linear = gtsam.JacobianFactor(0, np.array([[1.0, 0.0]]), np.zeros(1), gtsam.noiseModel.Unit.Create(1))
    graph.add(gtsam.LinearContainerFactor(linear, at))
    with pytest.raises(np.linalg.LinAlgError, match="nothing tells"):
        joint_covariance(graph, at, [0], 2)
