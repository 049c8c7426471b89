"""Doppler velocity of an antenna: lever arm, axes that were not measured, claims."""

from dataclasses import replace
from math import inf, nan

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import DATUM
from numeric import assert_derivatives, random_state, solved

from holdfast.config.sensors import GnssVelocityConfig
from holdfast.events import Outcome
from holdfast.geometry.earth import LocalFrame
from holdfast.geometry.world import World
from holdfast.messages import GnssVelocity
from holdfast.sensors.gnss_velocity import GnssVelocityModel
from holdfast.sensors.noise import FREE_VARIANCE
from holdfast.sensors.sensor import Innovation, Role, State, Velocity

ARM = np.array([-1.0, 0.4, 2.0])
PLACED = World(LocalFrame(DATUM))  # by nobody's points
FLOORS = np.array([0.05, 0.05, 0.1])


def model(arm=ARM, **settings):
    config = GnssVelocityConfig(kind="gnss_velocity", topic="/vel", **settings)
    return GnssVelocityModel("doppler", config, arm)


def message(velocity=(1.5, 0.1, -0.2), covariance=None):
    matrix = None if covariance is None else np.array(covariance, dtype=float)
    return GnssVelocity(
        1_000, 2_000, "doppler", np.array(velocity), np.diag(matrix) if np.ndim(matrix) == 1 else matrix
    )


def sigmas(measured):
    return np.sqrt(measured.covariance.diagonal())


def test_a_mast_behind_an_imu_that_turns_moves_sideways():
    """The IMU drives 2 m/s north and rotates by 0.5 rad/s to the left; 1 m behind, that is 0.5 m/s east."""
    nav = gtsam.NavState(gtsam.Rot3.Yaw(np.pi / 2), np.zeros(3), np.array([0.0, 2.0, 0.0]))
    state = State(nav, np.eye(9), np.array([0.0, 0.0, 0.5]))
    behind = model(np.array([-1.0, 0.0, 0.0]))
    measured = behind.convert(message((0.5, 2.0, 0.0)), PLACED)
    np.testing.assert_allclose(behind.innovation(measured, state).y, 0.0, atol=1e-12)


def test_far_from_the_datum_it_is_measured_in_other_axes():
    """200 km to the west of the datum, whoever drives east climbs in W."""
    world = World()
    world.place(DATUM)
    world.to_enu(LocalFrame(DATUM).to_geodetic(np.array([-200e3, 0.0, 0.0])))
    measured = model().convert(message((30.0, 0.0, 0.0)), world)
    np.testing.assert_allclose(measured.v_W_P, world.axes @ [30.0, 0.0, 0.0])
    assert 0.8 < measured.v_W_P[2] < 1.0


@given(st.integers(0, 10_000))
def test_the_innovation_has_the_derivatives_that_it_claims(seed):
    state = random_state(seed)
    assert_derivatives(model(), Velocity(0, "doppler", np.array([1.0, -2.0, 0.3]), np.eye(3) * 0.05**2), state)


def test_the_velocity_of_the_arm_is_its_numeric_derivative():
    state, dt = random_state(3), 1e-6
    turned = state.nav.attitude().compose(gtsam.Rot3.Expmap(state.angular_velocity * dt))
    arm_velocity = (turned.rotate(ARM) - state.nav.attitude().rotate(ARM)) / dt
    measured = Velocity(0, "doppler", state.nav.velocity() + arm_velocity, np.eye(3))
    np.testing.assert_allclose(model().innovation(measured, state).y, 0.0, atol=1e-5)


def test_the_factor_pulls_the_velocity_towards_the_measurement_by_the_variances():
    nav = gtsam.NavState(gtsam.Rot3.Yaw(0.3), np.zeros(3), np.array([2.0, 0.0, 0.0]))
    state = State(nav, np.diag([*np.full(6, 1e-10), *np.full(3, 0.1**2)]))
    measured = model().convert(message((2.2, nan, 0.0), [0.1**2] * 3), PLACED)
    np.testing.assert_allclose(solved(model(), measured, state).nav.velocity(), [2.1, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("velocity", "outcome"),
    [
        ((nan, nan, nan), Outcome.NOT_FINITE),
        ((inf, nan, -inf), Outcome.NOT_FINITE),
        ((1.0, 516.0, 0.0), Outcome.OUT_OF_RANGE),
    ],
)
def test_a_velocity_that_cannot_be_is_refused(velocity, outcome):
    assert model().convert(message(velocity), PLACED) is outcome
    assert model(axes=("z",)).convert(message((1.0, 1.0, nan)), PLACED) is Outcome.NOT_FINITE


@pytest.mark.parametrize(
    ("velocity", "variances"),
    [
        ((1.0, 2.0, nan), None),
        ((1.0, 2.0, 1e9), [0.01, 0.01, nan]),
        ((1.0, 2.0, 3.0), [0.01, 0.01, 0.0]),
        ((1.0, 2.0, 3.0), [0.01, 0.01, -1.0]),
        ((1.0, 2.0, 3.0), [0.01, 0.01, inf]),
        ((1.0, 2.0, nan), [[0.01, 0.0, nan], [0.0, 0.01, nan], [nan, nan, nan]]),
    ],
)
def test_an_axis_without_a_value_or_a_variance_weighs_nothing_and_the_others_stay(velocity, variances):
    measured = model().convert(message(velocity, variances), PLACED)
    assert measured.v_W_P.tolist() == [1.0, 2.0, 0.0]
    assert measured.covariance[2].tolist() == measured.covariance[:, 2].tolist() == [0.0, 0.0, FREE_VARIANCE]
    np.testing.assert_allclose(sigmas(measured)[:2], 0.05 if variances is None else 0.1)
    state = random_state(1)
    innovation = model().innovation(measured, state)
    flat = Innovation(innovation.y[:2], innovation.H[:2], innovation.R[:2, :2], innovation.J[:2])
    assert innovation.nis(state) == pytest.approx(flat.nis(state), abs=1e-9)


def test_axes_that_are_not_in_use_weigh_nothing():
    measured = model(axes=("y", "x")).convert(message((1.0, 2.0, 0.0)), PLACED)
    np.testing.assert_allclose(sigmas(measured), [0.05, 0.05, np.sqrt(FREE_VARIANCE)])


def test_a_claim_counts_above_the_floor_with_its_correlations_and_the_floor_stands_for_none():
    claim = np.array([[0.09, 0.05, 0.0], [0.05, 0.09, 0.0], [0.0, 0.0, 1e-6]])
    expected = claim + np.diag([0.0, 0.0, 0.1**2 - 1e-6])
    np.testing.assert_allclose(model().convert(message(covariance=claim), PLACED).covariance, expected)
    for nothing in (None, [0.0] * 3, [nan] * 3, [-1.0] * 3):
        np.testing.assert_allclose(sigmas(model().convert(message(covariance=nothing), PLACED)), FLOORS)


def test_correlations_that_no_errors_have_are_left_out():
    claim = np.array([[0.04, 0.05, 0.0], [0.05, 0.04, nan], [0.0, nan, 0.04]])
    np.testing.assert_allclose(model().convert(message(covariance=claim), PLACED).covariance, np.eye(3) * 0.04)
    claim[1, 2] = claim[2, 1] = 0.0
    np.testing.assert_allclose(model().convert(message(covariance=claim), PLACED).covariance, np.eye(3) * 0.04)


def test_the_time_offset_is_applied_and_it_is_a_velocity_that_a_start_can_ask_for():
    assert model(time_offset_s=0.1).convert(replace(message(), stamp_ns=7), PLACED).stamp_ns == 100_000_007
    assert model().role is Role.VELOCITY
