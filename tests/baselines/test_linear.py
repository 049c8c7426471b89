"""Where the problem is linear, both filters are the Kalman filter, and their covariances explain their errors."""

import numpy as np
import pytest
from straight import CERTAIN, P0, WHITE, F, at_rest, filtered, first_covariance, history, kalman, model, step

from holdfast.baselines.msf import MsfBelief, MsfFilter
from holdfast.baselines.tsif import TsifBelief, TsifFilter, marginalised
from holdfast.evaluation.consistency import chi_square_quantile


def msf():
    P = np.zeros((21, 21))
    P[:15, :15] = first_covariance()
    return MsfFilter(None, WHITE), MsfBelief(0, *at_rest(), P)


def tsif():
    return TsifFilter(WHITE), TsifBelief(0, *at_rest(), np.linalg.inv(first_covariance()))


@pytest.mark.parametrize("make", [msf, tsif])
@pytest.mark.parametrize("seed", range(3))
def test_a_filter_is_the_kalman_filter(make, seed):
    _, readings, fixes = history(seed)
    mean, covariance = kalman(readings, fixes)
    x, P = filtered(*make(), readings, fixes)
    sigma = np.sqrt(np.diag(covariance))
    # what is certain is not certain without end: its variance, seen through gravity, is all that may differ
    assert (abs(x - mean) < 1e-4 * sigma).all()
    np.testing.assert_allclose(P / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=1e-4)


@pytest.mark.parametrize("make", [msf, tsif])
def test_the_covariance_explains_the_errors(make):
    runs, total = 40, 0.0
    for seed in range(100, 100 + runs):
        truth, readings, fixes = history(seed)
        x, P = filtered(*make(), readings, fixes)
        total += (x - truth) @ np.linalg.solve(P, x - truth)
    low, high = (chi_square_quantile(p, 6 * runs) for p in (0.0005, 0.9995))
    assert low < total < high


def test_without_measurements_position_is_twice_integrated_acceleration():
    filter_, belief = msf()
    carried, a = model(), np.array([0.3, -0.2, 0.1])
    for _ in range(100):
        belief.nav = carried.advance(belief.nav, belief.bias, belief.bias_accel, belief.bias_gyro, step(a))
        filter_.predict(belief, carried)
    np.testing.assert_allclose(belief.nav.position(), a / 2.0, atol=1e-12)
    np.testing.assert_allclose(belief.nav.velocity(), a, atol=1e-12)
    # the prior alone: position after 1 s has its own variance and that of the velocity
    np.testing.assert_allclose(np.diag(belief.P)[3:6], P0[0, 0] + P0[3, 3], rtol=0.01)


def test_marginalising_the_state_before_is_the_kalman_prediction():
    rng = np.random.default_rng(0)
    A, B, C = rng.standard_normal((3, 6, 6))
    P, Q, turned = A @ A.T + np.eye(6), B @ B.T + np.eye(6), F + 0.3 * C
    W = np.linalg.inv(Q)
    information = marginalised(np.linalg.inv(P), turned.T @ W @ turned, W @ turned, W)
    np.testing.assert_allclose(np.linalg.inv(information), turned @ P @ turned.T + Q, rtol=1e-9)


def test_what_is_certain_stays_so_where_nothing_disturbs_it():
    filter_, belief = msf()
    _, readings, fixes = history(5)
    filtered(filter_, belief, readings, fixes)
    assert np.diag(belief.P)[:3].max() < 2 * CERTAIN
    assert np.diag(belief.P)[9:15].max() < 2 * CERTAIN
