"""The offset of a sensor's clock as the last of its parameters."""

from types import SimpleNamespace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numeric import assert_derivatives, random_state

from holdfast.config.sensors import GnssConfig, GnssVelocityConfig, HeadingConfig, PrismConfig
from holdfast.sensors.clock import DELAY, has_estimated_clock, receiver_constants, with_estimated_clock
from holdfast.sensors.gnss import GnssModel
from holdfast.sensors.gnss_velocity import GnssVelocityModel
from holdfast.sensors.heading import AxisYaw, HeadingModel
from holdfast.sensors.prism import PrismModel
from holdfast.sensors.sensor import Position, Velocity

ARM = np.array([0.3, -0.2, 2.0])


def antenna(**settings):
    return GnssModel("gnss", GnssConfig(kind="gnss", topic="/fix", **settings), ARM)


def doppler(name="doppler"):
    return GnssVelocityModel(name, GnssVelocityConfig(kind="gnss_velocity", topic="/velocity"), ARM)


def mounted(**settings):
    """An antenna whose lever arm is known."""
    return antenna(**settings).with_known_arm()


def position_of(p_W_P):
    return Position(0, "gnss", np.array(p_W_P), np.eye(3) * 0.01**2, 0.0)


@given(st.integers(0, 10_000))
def test_a_late_stamp_of_a_fix_and_of_a_heading_is_explained_by_the_offset(seed):
    """The innovation at the offset is that of where the machine was so long after the stamp, to second order."""
    rng = np.random.default_rng(seed)
    state, offset_s = random_state(seed, (0.0,), tilt_rad=0.0), float(rng.uniform(-0.02, 0.02))
    state = state._replace(angular_velocity=state.angular_velocity * [0.0, 0.0, 1.0])
    twist = np.concatenate([state.angular_velocity, state.nav.bodyVelocity()])
    later = state.nav.pose().compose(gtsam.Pose3.Expmap(twist * offset_s))
    late = state._replace(parameter=np.array([offset_s]))
    of_both = state._replace(parameter=np.array([1.5 * offset_s, -0.5 * offset_s]))  # its own, and that of GNSS
    fix = with_estimated_clock(mounted()).innovation(position_of(later.transformFrom(ARM)), late)
    assert abs(fix.y).max() < 5.0 * offset_s**2 * (1.0 + np.linalg.norm(twist) ** 2)
    heading = HeadingModel("heading", HeadingConfig(kind="heading", topic="/heading", mounting_sigma_deg=0.0), {})
    x, y, _ = later.rotation().rotate(np.array([1.0, 0.0, 0.0]))
    found = with_estimated_clock(heading).innovation(AxisYaw(0, "heading", float(np.arctan2(y, x)), 0.01), of_both)
    assert abs(found.y).max() < 5.0 * offset_s**2 * (1.0 + np.linalg.norm(twist) ** 2)


@given(st.integers(0, 10_000))
def test_a_late_velocity_is_explained_by_the_mean_acceleration_over_the_offset(seed):
    rng = np.random.default_rng(seed)
    state, offset_s = random_state(seed, (0.0,)), float(rng.uniform(-0.2, 0.2))
    asked, acceleration = [], rng.normal(0.0, 2.0, 3)
    state = state._replace(
        angular_velocity=np.zeros(3),
        parameter=np.array([0.25 * offset_s, 0.75 * offset_s]),
        acceleration=lambda over_s: (asked.append(over_s), acceleration)[1],
    )
    later = state.nav.velocity() + state.nav.attitude().rotate(acceleration) * offset_s
    model = with_estimated_clock(doppler())
    found = model.innovation(Velocity(0, "doppler", later, 0.05**2 * np.eye(3)), state)
    np.testing.assert_allclose(found.y, 0.0, atol=1e-9)
    assert asked == pytest.approx([offset_s])


def test_what_is_no_position_has_a_delay_beside_the_clock_of_gnss():
    for model in (HeadingModel("one", HeadingConfig(kind="heading", topic="/heading"), {}), doppler("one")):
        *_, delay, clock = with_estimated_clock(model).parameters
        assert (delay.name("one"), clock.name("one")) == ("one delay", "clock of GNSS")
    assert not any(one.part == DELAY for one in with_estimated_clock(antenna()).parameters)


@given(st.integers(0, 10_000))
def test_the_innovation_has_the_derivatives_that_it_claims_also_behind_an_arm_that_is_estimated(seed):
    for model, sigmas in ((mounted(), (0.0,)), (antenna(), (0.5, 0.5, 0.5, 0.0))):
        state = random_state(seed, sigmas)
        state = state._replace(parameter=np.append(state.parameter[:-1], 1e-9))  # products of tau are of second order
        assert_derivatives(with_estimated_clock(model), position_of([3.0, -2.0, 1.0]), state)


@given(st.integers(0, 10_000), st.floats(-0.1, 0.1))
def test_a_velocity_that_is_corrected_by_metres_per_second_carries_the_position_over_the_offset(seed, offset_s):
    """A factor is linear about the prediction: after an outage without lidar the velocity is wrong by that much."""
    rng = np.random.default_rng(seed)
    state = random_state(seed, (0.0,))._replace(parameter=np.array([offset_s]))
    nav, off = state.nav, rng.uniform(-3.0, 3.0, 3)
    other = state._replace(nav=gtsam.NavState(nav.pose(), nav.velocity() + nav.attitude().matrix() @ off))
    model = with_estimated_clock(mounted())
    before, after = (model.innovation(position_of([3.0, -2.0, 1.0]), one) for one in (state, other))
    np.testing.assert_allclose(after.y, before.y - before.H[:, 6:9] @ off, atol=1e-9)


def test_a_clock_that_is_known_is_not_estimated():
    known = antenna(time_offset_sigma_s=0.0)
    assert with_estimated_clock(known) is known and not has_estimated_clock(known)
    assert with_estimated_clock(SimpleNamespace(role="state")).role == "state"  # a kind that knows nothing of it


def test_arm_and_offset_are_told_apart():
    arm = ARM + 0.1
    assert receiver_constants(mounted(), np.zeros(0))[1] == 0.0
    found = receiver_constants(with_estimated_clock(mounted()), np.array([0.02]))
    np.testing.assert_array_equal(found[0], ARM)
    assert found[1] == pytest.approx(0.02)
    both = with_estimated_clock(antenna())
    assert [one.name("gnss") for one in both.parameters] == ["arm of GNSS", "clock of GNSS"]
    np.testing.assert_array_equal(np.concatenate([one.mean for one in both.parameters]), np.zeros(4))
    found = receiver_constants(both, np.array([*(arm - ARM), -0.01]))
    np.testing.assert_allclose(found[0], arm)
    assert found[1] == pytest.approx(-0.01)


@given(st.integers(0, 10_000), st.floats(-1.0, 1.0))
def test_what_is_in_the_stamps_already_is_not_looked_for_again(seed, known_s):
    """The parameter stays the whole offset: what is told of it does not depend on how much is known."""
    state = random_state(seed, (0.0,))
    whole, rest = (state._replace(parameter=np.array([by_s])) for by_s in (known_s + 0.01, 0.01))
    position = position_of([3.0, -2.0, 1.0])
    known = with_estimated_clock(mounted(), known_s)
    of_known, of_unknown = known.innovation(position, whole), with_estimated_clock(mounted()).innovation(position, rest)
    np.testing.assert_allclose(of_known.y, of_unknown.y, atol=1e-9)
    np.testing.assert_allclose(of_known.J, of_unknown.J, atol=1e-9)
    assert receiver_constants(known, whole.parameter)[1] == pytest.approx(0.01)


def test_a_clock_of_gnss_is_not_that_of_another_sensor():
    prism = PrismModel("prism", PrismConfig(kind="prism", topic="/prism"), ARM)
    assert with_estimated_clock(prism, 0.3).known_s == 0.0
    assert with_estimated_clock(mounted(), 0.3).known_s == 0.3
