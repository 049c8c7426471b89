"""What all sensors share: innovations, claims, factors and stamps."""

import gtsam
import numpy as np
import pytest
from numeric import C, X, random_state

from holdfast.config.sensors import JudgedConfig
from holdfast.sensors.sensor import (
    FUTURE_NS,
    RECENT,
    Innovation,
    StampFilter,
    State,
    claimed_covariance,
    innovation_factor,
)
from holdfast.state import Outcome

SECOND_NS = 1_000_000_000


def test_a_stamp_a_second_ahead_of_those_before_of_its_sensor_is_a_clock_jump():
    """It would wait for the IMU and enter where the machine is a second later."""
    stamps, reached_ns = StampFilter(), 100 * SECOND_NS
    for k in range(5):
        now_ns = reached_ns + k * SECOND_NS
        assert stamps.check("gnss", now_ns - 50_000_000, now_ns, now_ns, now_ns) is Outcome.USED
        assert stamps.check("slow", now_ns + 700_000_000, now_ns, now_ns, now_ns) is Outcome.USED  # it was ever ahead
    now_ns = reached_ns + 5 * SECOND_NS
    assert stamps.check("gnss", now_ns + 950_000_000, now_ns, now_ns, now_ns) is Outcome.CLOCK_JUMP
    assert stamps.check("gnss", now_ns, now_ns, now_ns, now_ns) is Outcome.USED
    assert stamps.check("slow", now_ns + 950_000_000, now_ns, now_ns, now_ns) is Outcome.USED


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


# --- stamps -----------------------------------------------------------------------------------------------------------


def test_a_stamp_is_used_once_by_each_sensor():
    stamps = StampFilter()
    outcomes = [stamps.check(sensor, 5, 5, 5, 5) for sensor in ("gnss", "gnss", "lidar")]
    assert outcomes == [Outcome.USED, Outcome.DUPLICATE, Outcome.USED]


def test_a_duplicate_is_found_among_the_recent_stamps_in_any_order():
    stamps = StampFilter()
    for k in range(RECENT):
        stamps.check("gnss", 1000 - k, 0, 1000, 0)
    assert stamps.check("gnss", 1000, 0, 1000, 0) is Outcome.DUPLICATE
    stamps.check("gnss", 2000, 0, 2000, 0)
    assert stamps.check("gnss", 1000, 0, 2000, 0) is Outcome.USED  # forgotten: the work per message is bounded


@pytest.mark.parametrize(("ahead_ns", "outcome"), [(FUTURE_NS, Outcome.USED), (FUTURE_NS + 1, Outcome.CLOCK_JUMP)])
def test_a_stamp_that_is_far_ahead_of_the_imu_is_an_error_of_a_clock(ahead_ns, outcome):
    reached_ns = 100 * SECOND_NS
    assert StampFilter().check("gnss", reached_ns + ahead_ns, 7, reached_ns, 7) is outcome


def test_a_silence_of_the_imu_explains_a_stamp_that_is_ahead_of_it():
    reached_ns = 100 * SECOND_NS
    stamp_ns = reached_ns + 30 * SECOND_NS
    assert StampFilter().check("gnss", stamp_ns, 30 * SECOND_NS, reached_ns, 0) is Outcome.USED
    assert StampFilter().check("gnss", stamp_ns, 20 * SECOND_NS, reached_ns, 0) is Outcome.CLOCK_JUMP


def test_before_the_first_sample_of_the_imu_no_stamp_is_ahead():
    assert StampFilter().check("gnss", 10**18, 0, 0, 0) is Outcome.USED


def test_a_stamp_that_was_refused_may_come_again():
    stamps = StampFilter()
    stamp_ns = 10 * SECOND_NS
    assert stamps.check("gnss", stamp_ns, 0, SECOND_NS, 0) is Outcome.CLOCK_JUMP
    assert stamps.check("gnss", stamp_ns, 0, stamp_ns, 0) is Outcome.USED
