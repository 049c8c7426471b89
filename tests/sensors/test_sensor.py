"""What all sensors share: innovations, claims and factors."""

import gtsam
import numpy as np
import pytest
from numeric import C, X, random_state

from holdfast.config.sensors import JudgedConfig
from holdfast.events import Outcome
from holdfast.sensors.sensor import Innovation, State, claimed_covariance, innovation_factor

SECOND_NS = 1_000_000_000


def test_the_nis_adds_what_is_unsure_of_state_parameter_and_measurement():
    """0.03, 0.04 and 0.12 m make 0.13 m; 0.39 m are three sigmas of that."""
    H = np.zeros((1, 9))
    H[0, 5] = 1.0
    state = State(
        gtsam.NavState(), np.eye(9) * 0.03**2, parameter=np.zeros(1), parameter_covariance=np.eye(1) * 0.02**2
    )
    innovation = Innovation(np.array([0.39]), H, np.array([[0.12**2]]), np.array([[2.0]]))
    assert innovation.nis(state) == pytest.approx(9.0)


class Speed:
    """Speed times a scale, which is the parameter; a state that stands cannot be compared."""

    settings = JudgedConfig(kind="speed")

    def innovation(self, measured, state):
        velocity = state.nav.velocity()
        if not velocity.any():
            return Outcome.OUT_OF_RANGE
        H = np.zeros((1, 9))
        speed = np.linalg.norm(velocity)
        H[0, 6:] = state.nav.attitude().unrotate(velocity / speed)
        scale = state.parameter[0]
        return Innovation(np.array([measured - scale * speed]), scale * H, np.eye(1), np.array([[speed]]))


def moving(velocity, scale):
    values = gtsam.Values()
    values.insert(X, gtsam.NavState(gtsam.Rot3.RzRyRx(0.1, 0.2, 0.3), np.zeros(3), np.array(velocity)))
    values.insert(C, np.array([scale]))
    return values


def test_the_factor_of_an_innovation_is_evaluated_anew_where_the_optimiser_stands():
    """A residual that is not linear, such as the length of a velocity, is right far from where it was made."""
    factor = innovation_factor(Speed(), [X, C], 6.0, random_state(1, [1.0]), np.eye(1) * 0.5**2)
    assert factor.error(moving([3.0, 4.0, 0.0], 1.0)) == pytest.approx(0.5 * 2.0**2)
    assert factor.error(moving([0.0, 0.0, 2.0], 3.0)) == pytest.approx(0.0)


def test_the_factor_of_an_innovation_has_the_jacobians_of_the_sensor():
    factor = innovation_factor(Speed(), [X, C], 6.0, random_state(1, [1.0]), np.eye(1))
    A, b = factor.linearize(moving([3.0, 4.0, 0.0], 1.0)).jacobian()
    R_I_W = gtsam.Rot3.RzRyRx(0.1, 0.2, 0.3).inverse()
    np.testing.assert_allclose(A[0, 6:9], R_I_W.rotate(np.array([0.6, 0.8, 0.0])))
    assert (A[0, 9], b[0]) == pytest.approx((5.0, 1.0))


def test_a_measurement_that_cannot_be_compared_any_more_weighs_nothing():
    factor = innovation_factor(Speed(), [X, C], 6.0, random_state(1, [1.0]), np.eye(1))
    A, b = factor.linearize(moving([0.0, 0.0, 0.0], 1.0)).jacobian()
    assert not A.any() and not b.any()


# --- claims -----------------------------------------------------------------------------------------------------------


def test_a_claim_is_lifted_to_the_floor_where_it_is_below_and_keeps_its_correlations():
    claim = np.array([[4.0, 1.0], [1.0, 0.25]])
    np.testing.assert_allclose(claimed_covariance(claim, np.array([1.0, 1.0])), [[4.0, 1.0], [1.0, 1.0]])


@pytest.mark.parametrize("claim", [None, np.zeros((2, 2)), np.diag([1.0, -1.0]), np.full((2, 2), np.inf)])
def test_the_floor_stands_for_a_claim_that_is_none(claim):
    np.testing.assert_allclose(claimed_covariance(claim, np.array([0.1, 0.2])), np.diag([0.01, 0.04]))
