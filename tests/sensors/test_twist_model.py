"""Wheel or track speed: the body velocity on the axes in use, and its scale factor."""

from dataclasses import replace
from math import inf, nan

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import at, machine
from numeric import PLACED, assert_derivatives, random_state, solved
from slewing import machine as slewing_machine

from holdfast.config.sensors import TwistConfig
from holdfast.events import Outcome
from holdfast.messages import Twist
from holdfast.sensors.mount import Mount
from holdfast.sensors.sensor import State
from holdfast.sensors.twist import BodyVelocity, TwistModel

AXLE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.7), np.array([-1.0, 0.4, -0.8]))
CONFIG = TwistConfig(kind="twist", topic="/wheels", slip_ratio=0.0)
KNOWN = {"scale_sigma": 0.0}


def model(mount=AXLE, **settings):
    config = machine(more={"wheels": {"kind": "twist", "mount": mount}})
    return TwistModel("wheels", CONFIG.model_copy(update=settings), Mount(config, "wheels"))


def message(linear=(1.5, 0.1, -0.2), covariance=None):
    return Twist(1_000, 2_000, "wheels", np.array(linear), np.zeros(3), covariance)


def true(sensor, state):
    """What the sensor would measure at a state."""
    scale = 1.0 + (state.parameter[0] if state.parameter.size else 0.0)
    return BodyVelocity(0, "wheels", scale * sensor.mount.velocity(state)[0], np.eye(3) * 0.05**2)


def moving(velocity, rate=(0.0, 0.0, 0.0), **more):
    nav = gtsam.NavState(gtsam.Rot3(), np.zeros(3), np.array(velocity))
    return State(nav, np.eye(9) * 0.01**2, np.array(rate), **more)


def test_an_axle_behind_a_rotating_imu_moves_sideways():
    """1 m behind the IMU, which drives 2 m/s ahead and rotates by 0.5 rad/s to the left: 0.5 m/s to the right."""
    behind = model(at([-1.0, 0.0, 0.0]), axes=("x", "y"), **KNOWN)
    measured = behind.convert(message((2.0, 0.0, 0.0)), PLACED)
    innovation = behind.innovation(measured, moving([2.0, 0.0, 0.0], [0.0, 0.0, 0.5]))
    np.testing.assert_allclose(innovation.y, [0.0, 0.5], atol=1e-12)


@given(st.integers(0, 10_000), st.sampled_from([("x",), ("x", "y"), ("z", "x", "y")]))
def test_the_innovation_is_zero_at_the_truth_and_has_the_derivatives_that_it_claims(seed, axes):
    sensor, state = model(axes=axes), random_state(seed, [0.05])
    measured = true(sensor, state)
    np.testing.assert_allclose(sensor.innovation(measured, state).y, 0.0, atol=1e-12)
    assert_derivatives(sensor, measured, state)


@given(st.integers(0, 10_000))
def test_on_the_chassis_the_derivatives_are_right_as_well(seed):
    sensor = TwistModel("wheels", CONFIG, Mount(slewing_machine(), "base_link"))
    state = random_state(seed, [0.05])
    assert_derivatives(sensor, true(sensor, state), state)


def test_beyond_the_turn_joint_nothing_can_be_compared_without_its_angle():
    sensor = TwistModel("wheels", CONFIG, Mount(slewing_machine(), "base_link"))
    state = random_state(1, [0.05])
    assert sensor.innovation(true(sensor, state), state._replace(joint=None)) is Outcome.NO_JOINT_ANGLE


def test_the_factor_pulls_the_velocity_and_the_scale_towards_the_measurement_by_their_variances():
    """2.2 m/s measured at 2 m/s; sigmas of 0.1 m/s in velocity and, by a scale of 5 %, 0.1 m/s: half each."""
    sensor = model(gtsam.Pose3())
    state = moving([2.0, 0.0, 0.0], parameter=np.zeros(1), parameter_covariance=np.eye(1) * 0.05**2)
    state = state._replace(covariance=np.diag([*np.full(6, 1e-10), 0.1**2, 1e-10, 1e-10]))
    found = solved(sensor, BodyVelocity(0, "wheels", np.array([2.2, 0.0, 0.0]), np.eye(3) * 1e-6), state)
    assert found.nav.velocity()[0] == pytest.approx(2.1, abs=0.01)
    assert found.parameter[0] == pytest.approx(0.05, abs=0.005)


def test_the_nis_counts_slip_in_proportion_to_the_speed():
    sensor = model(gtsam.Pose3(), slip_ratio=0.02, **KNOWN)
    state = moving([3.0, 0.0, 0.0])._replace(covariance=np.zeros((9, 9)))
    far = BodyVelocity(0, "wheels", np.array([3.1, 0.0, 0.0]), np.eye(3) * 0.08**2)
    assert sensor.innovation(far, state).nis(state) == pytest.approx(0.1**2 / (0.08**2 + 0.06**2))


@pytest.mark.parametrize(
    ("linear", "outcome"),
    [
        ((nan, 0.0, 0.0), Outcome.NOT_FINITE),
        ((-inf, 0.0, 0.0), Outcome.NOT_FINITE),
        ((101.0, 0, 0), Outcome.OUT_OF_RANGE),
    ],
)
def test_a_velocity_that_cannot_be_is_refused(linear, outcome):
    assert model().convert(message(linear), PLACED) is outcome


def test_an_axis_that_is_not_used_may_hold_anything():
    measured = model().convert(message((1.0, nan, 1e300)), PLACED)
    assert np.isfinite(model().innovation(measured, random_state(1, [0.05])).y).all()


def test_a_claim_counts_above_the_floor_only_and_the_floor_stands_for_none():
    claim = np.diag([9.0, 9.0, 9.0, 0.3**2, 0.01**2, 0.3**2])  # angular velocity first
    floored = model().convert(message(covariance=claim), PLACED).covariance
    np.testing.assert_allclose(np.sqrt(np.diag(floored)), [0.3, 0.05, 0.3])
    for nothing in (None, np.zeros((6, 6)), np.full((6, 6), nan)):
        assert (model().convert(message(covariance=nothing), PLACED).covariance == np.eye(3) * 0.05**2).all()


def test_the_time_offset_is_applied_and_a_known_scale_is_no_parameter():
    assert model(time_offset_s=0.1).convert(replace(message(), stamp_ns=7), PLACED).stamp_ns == 100_000_007
    assert model(**KNOWN).parameters == ()
    np.testing.assert_array_equal(model(scale_sigma=0.1).parameters[0].sigmas, [0.1])
