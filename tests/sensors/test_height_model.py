"""Height of a point of the machine, through its lever arm, beside a constant."""

from math import inf, nan

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numeric import PLACED, assert_derivatives, random_state, solved

from holdfast.config.sensors import HeightConfig
from holdfast.events import Outcome
from holdfast.messages import Height
from holdfast.sensors.height import HeightModel, PointHeight
from holdfast.sensors.sensor import State

ARM = np.array([0.5, -2.0, 1.0])
CONFIG = HeightConfig(kind="height", topic="/laser")


def model(**settings):
    return HeightModel("laser", CONFIG.model_copy(update=settings), ARM)


def true(state):
    constant = state.parameter[0] if state.parameter.size else 0.0
    return PointHeight(0, "laser", float(state.nav.pose().transformFrom(ARM)[2]) + constant, 0.05)


def test_a_rolled_machine_lifts_what_is_mounted_on_its_side():
    """By 90 deg about x what was 2 m to the right is 2 m below; what was above is beside."""
    nav = gtsam.NavState(gtsam.Rot3.Roll(np.pi / 2), np.array([1.0, 2.0, 10.0]), np.zeros(3))
    innovation = model().innovation(PointHeight(0, "laser", 8.3, 0.05), State(nav, np.zeros((9, 9))))
    assert innovation.y == pytest.approx(0.3)
    assert innovation.nis(State(nav, np.zeros((9, 9)))) == pytest.approx(36.0)


@given(st.integers(0, 10_000), st.sampled_from([(), (2.0,)]))
def test_the_innovation_is_zero_at_the_truth_and_has_the_derivatives_that_it_claims(seed, sigmas):
    state = random_state(seed, sigmas)
    np.testing.assert_allclose(model().innovation(true(state), state).y, 0.0, atol=1e-12)
    assert_derivatives(model(), true(state), state)


@pytest.mark.parametrize(("inflation", "moved_m"), [(1.0, 0.5), (3.0, 0.25)])
def test_the_factor_lifts_the_machine_by_its_weight(inflation, moved_m):
    """A state and a measurement of the same sigma meet in the middle, at an inflation of 3 a quarter of it."""
    level = State(gtsam.NavState(), np.diag([*np.full(3, 1e-10), *np.full(6, 0.05**2)]))
    found = solved(model(), PointHeight(0, "laser", ARM[2] + 1.0, 0.05), level, inflation)
    assert found.nav.position()[2] == pytest.approx(moved_m, abs=1e-3)


def test_where_the_height_is_known_the_factor_finds_the_constant():
    state = random_state(3, [0.0])._replace(covariance=np.eye(9) * 1e-10, parameter_covariance=np.eye(1) * 100.0)
    measured = true(state._replace(parameter=np.array([7.0])))
    assert solved(model(offset_sigma_m=10.0), measured, state).parameter == pytest.approx(7.0, abs=1e-3)


@pytest.mark.parametrize(
    ("height_m", "outcome"),
    [(nan, Outcome.NOT_FINITE), (inf, Outcome.NOT_FINITE), (1e300, Outcome.OUT_OF_RANGE), (-1e6, Outcome.OUT_OF_RANGE)],
)
def test_a_height_that_cannot_be_is_refused(height_m, outcome):
    assert model().convert(Height(0, 0, "laser", height_m, 0.01), PLACED) is outcome


@pytest.mark.parametrize(("claim_m", "sigma_m"), [(None, 0.05), (0.001, 0.05), (0.2, 0.2), (nan, 0.05), (-1.0, 0.05)])
def test_a_claim_counts_above_the_floor_only_and_the_floor_stands_for_none(claim_m, sigma_m):
    assert model().convert(Height(0, 0, "laser", 1.0, claim_m), PLACED).sigma_m == sigma_m


def test_the_time_offset_is_applied_and_a_height_in_w_has_no_parameter():
    assert model(time_offset_s=2.0).convert(Height(1, 1, "laser", 1.0, None), PLACED).stamp_ns == 2_000_000_001
    assert model().parameters == ()
    np.testing.assert_array_equal(model(offset_sigma_m=3.0).parameters[0].sigmas, [3.0])
