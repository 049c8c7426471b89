"""The mounting, the lever arm and the clock of an odometry as parameters: what its factors say of it."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.config.sensors import OdometryConfig
from holdfast.sensors.odometry_calibration import OdometryCalibration

SIZES = {gtsam.symbol(letter, 0): size for letter, size in (("l", 9), ("x", 9), ("E", 4), ("D", 3), ("B", 1))}
F, X, P, A, S = KEYS = tuple(SIZES)
T_I_L = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.4), np.array([0.8, 0.3, 1.9]))
STEP = 1e-6


def calibration(**settings):
    return OdometryCalibration(OdometryConfig(kind="odometry", topic="/lidar", **settings), T_I_L)


def values_at(rng, parameter):
    values = gtsam.Values()
    for key in (F, X):
        pose = gtsam.Pose3.Expmap(rng.normal(0.0, 1.0, 6))
        values.insert(key, gtsam.NavState(pose, rng.normal(0.0, 1.0, 3)))
    values.insert(P, parameter)
    values.insert(A, rng.normal(0.0, 1.0, 3))
    values.insert(S, rng.normal(0.0, 0.1, 1))
    return values


def numeric(factor, values, key, size):
    columns = []
    for k in range(size):
        ends = []
        for sign in (1.0, -1.0):
            step = gtsam.VectorValues()
            for other, other_size in SIZES.items():
                step.insert(other, np.zeros(other_size) if other != key else sign * STEP * np.eye(size)[k])
            ends.append(factor.unwhitenedError(values.retract(step)))
        columns.append((ends[0] - ends[1]) / (2.0 * STEP))
    return np.array(columns).T


@given(st.integers(0, 10_000))
def test_both_factors_have_the_derivatives_that_they_claim(seed):
    rng = np.random.default_rng(seed)
    values = values_at(rng, rng.normal(0.0, 0.03, 4))
    motion = values.atNavState(F).pose().between(values.atNavState(X).pose()) * gtsam.Pose3.Expmap(
        rng.normal(0, 0.02, 6)
    )
    unit = gtsam.noiseModel.Isotropic.Sigma
    anchored = calibration().anchored_factor(KEYS, motion, np.zeros(3), np.zeros(6), unit(6, 1.0))
    drift = calibration().drift_factor(KEYS, motion, unit(9, 1.0))
    for factor in (anchored, drift):
        claimed = factor.linearize(values).jacobian()[0]
        found = np.hstack([numeric(factor, values, key, size) for key, size in SIZES.items()])
        np.testing.assert_allclose(claimed, found, atol=2e-6 * max(1.0, abs(claimed).max()))


@given(st.integers(0, 10_000))
def test_the_error_is_zero_where_mounting_scale_and_clock_are_as_they_are(seed):
    """A sensor that is turned by delta, d elsewhere, short by s and tau younger than its stamps, as it turns."""
    rng = np.random.default_rng(seed)
    parameter = np.array([*rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.03)])
    rate, velocity = rng.normal(0.0, 0.5, 3), rng.normal(0.0, 1.0, 3)
    beyond = rng.normal(0.0, 0.3, 6)
    frame, pose = (gtsam.Pose3.Expmap(rng.normal(0.0, 1.0, 6)) for _ in range(2))
    later = pose * gtsam.Pose3.Expmap((np.concatenate([rate, velocity]) + beyond) * parameter[3])
    arm, scale = rng.normal(0.0, 1.0, 3), rng.normal(0.0, 0.1, 1)
    true_mount = T_I_L * gtsam.Pose3(gtsam.Rot3.Expmap(parameter[:3]), arm)
    moved = (frame * true_mount).between(later * true_mount)
    measured = gtsam.Pose3(moved.rotation(), np.exp(-scale[0]) * moved.translation())
    as_configured = T_I_L * measured * T_I_L.inverse()
    values = gtsam.Values()
    values.insert(F, gtsam.NavState(frame, np.zeros(3)))
    values.insert(X, gtsam.NavState(pose, pose.rotation().rotate(velocity)))
    values.insert(P, parameter)
    values.insert(A, arm)
    values.insert(S, scale)
    factor = calibration().anchored_factor(KEYS, as_configured, rate, beyond, gtsam.noiseModel.Isotropic.Sigma(6, 1.0))
    np.testing.assert_allclose(factor.unwhitenedError(values), 0.0, atol=1e-9)
    moved = calibration().after(values.atNavState(X), rate, float(parameter[-1]), beyond)
    np.testing.assert_allclose(gtsam.Pose3.Logmap(moved.between(later)), 0.0, atol=1e-12)


def test_what_is_known_is_held_and_if_all_is_known_nothing_is_estimated():
    assert calibration(mounting_sigma_deg=0, time_offset_sigma_s=0).prior is None
    assert calibration(mounting_sigma_deg=0).arm_prior is None  # "0: known"
    sigmas = calibration(mounting_sigma_deg=0, time_offset_sigma_s=0.05).prior.sigmas
    assert sigmas[:3].max() < 1e-6 and sigmas[3] == 0.05
    assert calibration().prior.sigmas[:3] == pytest.approx(np.radians(1.0))


@pytest.mark.parametrize(
    ("by_deg", "sigma_deg", "is_turned"),
    [
        (4.9, 1.0, False),
        (5.1, 1.0, True),
        (4.9, 0.01, False),  # it was learnt so well yesterday; what the configuration allows is no other mount
        (14.0, 3.0, False),
        (16.0, 3.0, True),
    ],
)
def test_a_mount_is_turned_if_it_leaves_its_prior_by_five_sigmas(by_deg, sigma_deg, is_turned):
    """The prior stands at half a turn, where two rotation vectors are the same rotation."""
    half_turn, configured = np.array([0.0, 0.0, np.pi]), calibration()
    prior = configured.prior._replace(
        mean=np.array([*half_turn, 0.0]), sigmas=np.array([*np.full(3, np.radians(sigma_deg)), 0.02])
    )
    for side in (-1.0, 1.0):
        estimate = np.array([0.0, 0.0, np.pi + side * np.radians(by_deg), 0.0])
        assert configured.is_turned(prior, estimate) is is_turned
        estimate[2] -= 2.0 * np.pi
        assert configured.is_turned(prior, estimate) is is_turned
