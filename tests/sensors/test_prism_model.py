"""A prism: positions of a site grid in W, older than their stamps by the station's latency."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numeric import PLACED, X, assert_derivatives, assert_jacobians, random_state, residual

from holdfast.config.sensors import PrismConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import PointPosition
from holdfast.sensors.prism import PrismModel
from holdfast.sensors.sensor import Position

ARM = np.array([0.2, -0.3, 2.4])
CONFIG = PrismConfig(kind="prism", topic="/prism")
GRID = {"grid_position_m": (100.0, -50.0, 3.0), "grid_yaw_deg": 90.0}


def model(**settings):
    return PrismModel("prism", CONFIG.model_copy(update=settings), ARM)


def message(position=(10.0, 2.0, 1.0), covariance=None):
    return PointPosition(1_000_000_000, 1_100_000_000, "prism", np.array(position), covariance)


def values_at(nav):
    values = gtsam.Values()
    values.insert(X, nav)
    return values


def test_a_position_of_the_grid_is_turned_and_moved_to_w_and_its_covariance_with_it():
    """x of the grid points north: 10 m ahead and 2 m to the left are 10 m north and 2 m west."""
    position = model(**GRID).convert(message(covariance=np.diag([0.1, 0.2, 0.3]) ** 2), PLACED)
    np.testing.assert_allclose(position.p_W_P, [98.0, -40.0, 4.0], atol=1e-12)
    np.testing.assert_allclose(position.covariance, np.diag([0.2, 0.1, 0.3]) ** 2, atol=1e-12)


def test_a_prism_needs_no_datum_and_sets_none():
    world = World()
    np.testing.assert_array_equal(model().convert(message(), world).p_W_P, message().position)
    assert world.datum is None


def test_latency_makes_a_measurement_older_and_the_time_offset_is_added():
    assert model(latency_s=0.3, time_offset_s=0.1).convert(message(), PLACED).stamp_ns == 800_000_000


@given(st.integers(0, 10_000))
def test_innovation_and_factor_are_zero_at_the_truth_and_have_the_derivatives_that_they_claim(seed):
    state = random_state(seed)
    position = Position(0, "prism", state.nav.pose().transformFrom(ARM), np.diag([1e-4, 2e-4, 3e-4]), 0.0)
    np.testing.assert_allclose(model().innovation(position, state).y, 0.0, atol=1e-12)
    assert_derivatives(model(), position, state)
    factor = model().factor([X], position, 1.0)
    np.testing.assert_allclose(residual(factor, values_at(state.nav)), 0.0, atol=1e-9)
    assert_jacobians(factor, values_at(state.nav))


@pytest.mark.parametrize(("inflation", "sigmas"), [(1.0, 3.0), (9.0, 1.0)])
def test_the_residual_counts_inflated_sigmas(inflation, sigmas):
    position = Position(0, "prism", ARM + np.array([0.03, 0.0, 0.0]), np.eye(3) * 0.01**2, 0.0)
    factor = model().factor([X], position, inflation)
    assert factor.error(values_at(gtsam.NavState())) == pytest.approx(0.5 * sigmas**2)


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({"position": np.array([np.nan, 0.0, 0.0])}, Outcome.NOT_FINITE),
        ({"position": np.array([0.0, np.inf, 0.0])}, Outcome.NOT_FINITE),
        ({"position": np.array([0.0, 0.0, 1e300])}, Outcome.OUT_OF_RANGE),
        ({"covariance": np.diag([1.0, 1.01, 1.0])}, Outcome.LARGE_COVARIANCE),
    ],
)
def test_a_position_that_cannot_be_used_is_refused(change, outcome):
    assert model().convert(replace(message(), **change), PLACED) is outcome


@pytest.mark.parametrize("claim", [None, np.zeros((3, 3)), np.full((3, 3), np.nan), np.eye(3) * 1e-8])
def test_no_claim_counts_below_the_floor(claim):
    covariance = model().convert(message(covariance=claim), PLACED).covariance
    np.testing.assert_allclose(covariance, np.eye(3) * 0.005**2, atol=1e-15)
