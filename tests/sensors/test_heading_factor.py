"""Heading: the yaw of an axis of the machine, whatever its tilt, and nothing else."""

from math import atan2, inf, nan, radians

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.config.model import HeadingConfig
from holdfast.messages import Heading
from holdfast.sensors.heading import HeadingModel
from holdfast.state import Outcome

X = gtsam.symbol("x", 0)
BASELINE = np.array([0.1, -1.9, 0.15])
CONFIG = HeadingConfig(topic="/heading")
MODEL = HeadingModel(CONFIG, BASELINE)


def tilted(seed):
    rng = np.random.default_rng(seed)
    R = gtsam.Rot3.RzRyRx(*rng.uniform(-0.4, 0.4, 2), rng.uniform(-3.1, 3.1))
    return gtsam.NavState(R, rng.normal(0.0, 5.0, 3), rng.normal(0.0, 1.0, 3))


def true_yaw(nav, axis=BASELINE):
    x, y, _ = nav.attitude().rotate(axis)
    return atan2(y, x)


def message(yaw_rad=0.3, sigma_rad=0.01):
    return Heading(0, 0, "heading", yaw_rad, sigma_rad)


@given(st.integers(0, 10_000))
def test_the_innovation_is_zero_at_the_truth_at_every_tilt(seed):
    nav = tilted(seed)
    assert MODEL.innovation(nav, true_yaw(nav)) == pytest.approx(0.0, abs=1e-12)


@given(st.integers(0, 10_000))
def test_the_factor_turns_the_machine_by_the_innovation_about_the_vertical(seed):
    """An optimiser that sees the factor and a loose prior ends at the measured yaw, roll, pitch and place unchanged."""
    nav, off = tilted(seed), 0.02
    innovation = MODEL.innovation(nav, true_yaw(nav) + off)
    assert innovation == pytest.approx(off)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(MODEL.factor(X, nav, innovation, 0.001))
    graph.add(gtsam.PriorFactorNavState(X, nav, gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1.0, 1.0, 1.0], 3))))
    values = gtsam.Values()
    values.insert(X, nav)
    turned = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atNavState(X)
    expected = gtsam.Rot3.Yaw(off).compose(nav.attitude())
    assert turned.attitude().equals(expected, 1e-4)
    np.testing.assert_allclose(turned.position(), nav.position(), atol=1e-6)
    np.testing.assert_allclose(turned.velocity(), nav.velocity(), atol=1e-6)


def test_the_weight_is_that_of_the_sigma():
    nav = tilted(3)
    factor = MODEL.factor(X, nav, 0.03, 0.01)
    values = gtsam.Values()
    values.insert(X, nav)
    assert factor.error(values) == pytest.approx(0.5 * 3.0**2, rel=1e-6)


def test_the_nis_counts_sigmas_of_state_and_heading_together():
    level = gtsam.NavState(gtsam.Rot3.Yaw(1.0), np.zeros(3), np.zeros(3))
    covariance = np.zeros((9, 9))
    covariance[2, 2] = 0.03**2
    assert MODEL.nis(level, covariance, 0.1, 0.04) == pytest.approx((0.1 / 0.05) ** 2)


def test_an_axis_that_stands_upright_has_no_yaw():
    nav = gtsam.NavState(gtsam.Rot3.Roll(np.pi / 2), np.zeros(3), np.zeros(3))
    assert MODEL.innovation(nav, 0.3) is None


def test_the_configured_mounting_wins_over_the_baseline_and_without_both_it_is_the_x_axis():
    configured = HeadingModel(CONFIG.model_copy(update={"mounting_yaw_deg": 90.0}), BASELINE)
    np.testing.assert_allclose(configured.axis, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(HeadingModel(CONFIG, None).axis, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(MODEL.axis, BASELINE / np.linalg.norm(BASELINE))


@pytest.mark.parametrize(
    ("heading", "outcome"),
    [
        (message(), Outcome.USED),
        (message(nan), Outcome.NOT_FINITE),
        (message(inf), Outcome.NOT_FINITE),
        (message(sigma_rad=nan), Outcome.NOT_FINITE),
        (message(sigma_rad=-0.1), Outcome.NOT_FINITE),
        (message(sigma_rad=2.0), Outcome.LARGE_COVARIANCE),
        (message(sigma_rad=None), Outcome.USED),
    ],
)
def test_a_heading_that_cannot_be_used_is_told(heading, outcome):
    assert MODEL.check(heading) is outcome


def test_the_claim_has_a_floor_and_the_default_stands_in_for_none():
    assert MODEL.measured(message(sigma_rad=1e-6)).sigma_rad == radians(CONFIG.min_sigma_deg)
    assert MODEL.measured(message(sigma_rad=None)).sigma_rad == radians(CONFIG.default_sigma_deg)
    assert MODEL.measured(message(sigma_rad=0.02)).sigma_rad == 0.02
