"""Wheels that slip neither sideways nor off the ground, and by how much their frame is mounted askew."""

from math import radians

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import NOT_TURNED, machine
from numeric import PLACED, assert_derivatives, random_state, solved
from slewing import machine as slewing_machine

from holdfast.config.sensors import NonholonomicConfig
from holdfast.events import Outcome
from holdfast.sensors.mount import Mount
from holdfast.sensors.nonholonomic import NonholonomicModel
from holdfast.sensors.sensor import State

CONFIG = NonholonomicConfig(kind="nonholonomic", slip_ratio=0.0)
ANGLES = np.radians([1.0, 1.0])


def model(mount=NOT_TURNED, **settings):
    config = machine(more={"wheels": {"kind": "nonholonomic", "topic": None, "mount": mount}})
    return NonholonomicModel("wheels", CONFIG.model_copy(update=settings), Mount(config, "wheels"))


HELD = model().at(5)


def driving(velocity, angles=(0.0, 0.0)):
    nav = gtsam.NavState(gtsam.Rot3(), np.zeros(3), np.array(velocity))
    return State(nav, np.eye(9) * 0.01**2, parameter=np.array(angles), parameter_covariance=np.diag(ANGLES**2))


def test_it_is_violated_by_motion_sideways_and_upwards_but_not_ahead():
    np.testing.assert_allclose(model().innovation(HELD, driving([9.0, 0.2, -0.1])).y, [-0.2, 0.1])
    np.testing.assert_allclose(model(axes=("z",)).innovation(HELD, driving([9.0, 0.2, -0.1])).y, [0.1])


def test_a_frame_that_is_mounted_askew_by_its_two_angles_moves_sideways_as_it_drives_ahead():
    """Turned by -psi about z it sees the machine go psi v_x to the left; by -theta about y, theta v_x downwards."""
    psi, theta = 0.01, 0.02
    askew = model(gtsam.Pose3(gtsam.Rot3.RzRyRx(0.0, -theta, -psi), np.zeros(3)))
    y = askew.innovation(HELD, driving([5.0, 0.0, 0.0], [psi, theta])).y
    np.testing.assert_allclose(y, 0.0, atol=5.0 * (psi**2 + theta**2))
    assert abs(askew.innovation(HELD, driving([5.0, 0.0, 0.0])).y).min() > 0.04


@given(st.integers(0, 10_000), st.sampled_from([("y", "z"), ("y",), ("z",)]))
def test_the_innovation_has_the_derivatives_that_it_claims(seed, axes):
    mount = gtsam.Pose3.Expmap(np.random.default_rng(seed).normal(0.0, 1.0, 6))
    assert_derivatives(model(mount, axes=axes), HELD, random_state(seed, ANGLES))


@given(st.integers(0, 10_000))
def test_on_the_chassis_the_derivatives_are_right_as_well(seed):
    sensor = NonholonomicModel("wheels", CONFIG, Mount(slewing_machine(), "base_link"))
    assert_derivatives(sensor, HELD, random_state(seed, ANGLES))


def test_beyond_the_turn_joint_nothing_can_be_compared_without_its_angle():
    sensor = NonholonomicModel("wheels", CONFIG, Mount(slewing_machine(), "base_link"))
    assert sensor.innovation(HELD, random_state(1, ANGLES)._replace(joint=None)) is Outcome.NO_JOINT_ANGLE


def test_the_factor_takes_the_sideways_velocity_away():
    found = solved(model(sigma_m_s=1e-3), HELD, driving([0.0, 0.3, -0.2])._replace(covariance=np.eye(9)))
    np.testing.assert_allclose(found.nav.velocity()[1:], 0.0, atol=1e-4)


def test_where_the_velocity_is_known_the_factor_finds_the_mounting():
    state = driving([5.0, 0.05, -0.1])._replace(covariance=np.eye(9) * 1e-10)
    found = solved(model(sigma_m_s=1e-4), HELD, state)
    np.testing.assert_allclose(found.parameter, [0.01, 0.02], rtol=0.01)


def test_slip_grows_with_the_speed():
    slow, fast = (model(slip_ratio=0.01).innovation(HELD, driving([v, 0.0, 0.0])).R[0, 0] for v in (0.0, 10.0))
    assert (slow, fast) == pytest.approx((0.05**2, 0.05**2 + 0.1**2))


def test_it_is_made_at_its_rate_and_takes_no_message():
    sensor = model(rate_hz=4.0)
    assert (sensor.period_ns, sensor.at(7).stamp_ns, sensor.at(7).sensor) == (250_000_000, 7, "wheels")
    assert sensor.message is None
    with pytest.raises(TypeError, match="wheels is a constraint"):
        sensor.convert(HELD, PLACED)


def test_a_mounting_that_is_known_is_no_parameter():
    assert model(mounting_sigma_deg=0.0).parameters == ()
    np.testing.assert_allclose(model(mounting_sigma_deg=2.0).parameters[0].sigmas, radians(2.0))
