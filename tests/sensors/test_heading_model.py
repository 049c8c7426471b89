"""Heading: the yaw of an axis of the machine, whatever its tilt, and nothing else."""

from math import atan2, inf, nan, radians

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import DATUM, machine
from numeric import PLACED, X, assert_derivatives, random_state, solved

from holdfast.config.sensors import HeadingConfig
from holdfast.events import Outcome
from holdfast.geometry.earth import LocalFrame
from holdfast.geometry.world import World
from holdfast.messages import Heading
from holdfast.sensors.heading import AxisYaw, HeadingModel
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import State

BASELINE = np.array([0.1, -1.9, 0.15])
ARMS = {"gnss": np.array([1.0, 2.0, 3.0]), "gnss_right": np.array([1.0, 2.0, 3.0]) + BASELINE}
CONFIG = HeadingConfig(kind="heading", topic="/heading")
MODEL = HeadingModel("heading", CONFIG.model_copy(update={"mounting_sigma_deg": 0.0}), ARMS)
ESTIMATED = HeadingModel("heading", CONFIG, ARMS)
TILT_RAD = 0.4


def configured(**settings):
    return HeadingModel("heading", CONFIG.model_copy(update=settings), ARMS)


def true_yaw(nav, axis=BASELINE):
    x, y, _ = nav.attitude().rotate(axis)
    return atan2(y, x)


def measured(yaw_rad, sigma_rad=0.01):
    return AxisYaw(0, "heading", yaw_rad, sigma_rad)


def message(yaw_rad=0.3, sigma_rad=0.01):
    return Heading(0, 0, "heading", yaw_rad, sigma_rad)


def test_north_far_to_the_east_of_the_datum_points_to_the_west_in_w():
    world = World()
    world.place(DATUM)
    there = LocalFrame(DATUM).to_geodetic(np.array([100e3, 0.0, 0.0]))
    world.to_enu(there)
    turn = MODEL.convert(message(np.pi / 2), world).yaw_rad - np.pi / 2
    convergence = radians(there.longitude_deg - DATUM.longitude_deg) * np.sin(radians(there.latitude_deg))
    assert turn == pytest.approx(convergence, rel=0.01) and turn > radians(0.5)


@given(st.integers(0, 10_000))
def test_the_innovation_is_zero_at_the_truth_at_every_tilt_whatever_the_number_of_rotations(seed):
    state = random_state(seed, tilt_rad=TILT_RAD)
    for rotations in (-1, 0, 2):
        innovation = MODEL.innovation(measured(true_yaw(state.nav) + rotations * 2.0 * np.pi), state)
        assert innovation.y == pytest.approx(0.0, abs=1e-12)


@given(st.integers(0, 10_000))
def test_at_level_the_innovation_has_the_derivative_that_it_claims(seed):
    """Tilted, roll and pitch would count for the yaw of the axis as well; they are left to the IMU on purpose."""
    state = random_state(seed, tilt_rad=0.0)
    flat = {name: arm * [1.0, 1.0, 0.0] for name, arm in ARMS.items()}
    assert_derivatives(HeadingModel("heading", MODEL.settings, flat), measured(true_yaw(state.nav) + 0.1), state)
    turned = random_state(seed, parameter_sigmas=(0.2,), tilt_rad=0.0)
    assert_derivatives(HeadingModel("heading", CONFIG, flat), measured(true_yaw(turned.nav) + 0.1), turned)


@given(st.integers(0, 10_000))
def test_the_factor_rotates_the_machine_by_the_innovation_about_the_vertical(seed):
    """Against a loose prior it ends at the measured yaw; roll, pitch, position and velocity are as before."""
    off = 0.02
    state = random_state(seed, tilt_rad=TILT_RAD)._replace(covariance=np.eye(9))
    found = solved(MODEL, measured(true_yaw(state.nav) + off, 0.001), state).nav
    assert found.attitude().equals(gtsam.Rot3.Yaw(off).compose(state.nav.attitude()), 1e-4)
    np.testing.assert_allclose(found.position(), state.nav.position(), atol=1e-6)
    np.testing.assert_allclose(found.velocity(), state.nav.velocity(), atol=1e-6)


@pytest.mark.parametrize(("inflation", "sigmas"), [(1.0, 3.0), (4.0, 1.5)])
def test_the_weight_is_that_of_the_inflated_sigma(inflation, sigmas):
    state, values = random_state(3, tilt_rad=TILT_RAD), gtsam.Values()
    values.insert(X, state.nav)
    heading = measured(true_yaw(state.nav) + 0.03)
    factor = MODEL.factor([X], heading, state, MODEL.innovation(heading, state), inflation)
    assert factor.error(values) == pytest.approx(0.5 * sigmas**2, rel=1e-6)


def test_the_nis_counts_sigmas_of_state_and_heading_together():
    covariance = np.zeros((9, 9))
    covariance[2, 2] = 0.03**2
    level = State(gtsam.NavState(gtsam.Rot3.Yaw(1.0), np.zeros(3), np.zeros(3)), covariance)
    innovation = MODEL.innovation(measured(true_yaw(level.nav) + 0.1, 0.04), level)
    assert innovation.nis(level) == pytest.approx((0.1 / 0.05) ** 2)


def test_an_axis_that_stands_upright_has_no_yaw():
    upright = gtsam.Rot3.Roll(np.pi / 2)
    state = State(gtsam.NavState(upright, np.zeros(3), np.zeros(3)), np.eye(9))
    assert MODEL.innovation(measured(0.3), state) is Outcome.OUT_OF_RANGE
    assert MODEL.of_imu(measured(0.3), upright) is None


def test_before_the_start_the_heading_of_the_imu_follows_from_its_tilt():
    attitude = gtsam.Rot3.RzRyRx(0.2, -0.3, 1.1)
    level = gtsam.Rot3.RzRyRx(0.2, -0.3, 0.0)
    x, y, _ = attitude.rotate(BASELINE)
    assert MODEL.of_imu(measured(atan2(y, x), 0.02), level) == pytest.approx((1.1, 0.02))


# --- mounting ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("sigma_rad", "to_mount"), [(0.5, 0.99), (1e-4, 0.0)])
def test_a_heading_turns_the_machine_or_its_mounting_whichever_is_known_less(sigma_rad, to_mount):
    state = random_state(5, parameter_sigmas=(sigma_rad,), tilt_rad=0.0)
    off_rad, yaw_rad = 0.3, true_yaw(state.nav)
    state = state._replace(covariance=np.eye(9) * 0.03**2, parameter=np.zeros(1))
    found = solved(ESTIMATED, measured(yaw_rad + off_rad, 0.001), state)
    assert found.parameter[0] / off_rad == pytest.approx(to_mount, abs=0.01)
    assert true_yaw(found.nav) - yaw_rad + found.parameter[0] == pytest.approx(off_rad, abs=1e-3)


@pytest.mark.parametrize("by_rad", [0.2, -3.0])
def test_a_mounting_that_is_known_is_no_parameter_and_tells_the_heading_all_the_same(by_rad):
    state, turned = random_state(5, tilt_rad=0.0), ESTIMATED.turned(by_rad)
    heading = measured(true_yaw(state.nav) + by_rad, 0.02)
    assert turned.parameters == () and ESTIMATED.parameters
    assert turned.innovation(heading, state).y == pytest.approx(0.0, abs=1e-9)
    found, sigma_rad = turned.of_imu(heading, gtsam.Rot3())
    expected = MODEL.of_imu(measured(true_yaw(state.nav)), gtsam.Rot3())[0]
    assert (np.cos(found - expected), sigma_rad) == pytest.approx((1.0, 0.02))


# --- configuration ----------------------------------------------------------------------------------------------------


def test_the_configured_mounting_wins_over_the_baseline_and_without_both_it_is_the_x_axis():
    np.testing.assert_allclose(configured(mounting_yaw_deg=90.0).axis, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(HeadingModel("heading", CONFIG, {}).axis, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(MODEL.axis, BASELINE / np.linalg.norm(BASELINE))


@pytest.mark.parametrize(("baseline", "sign"), [(None, 1.0), (("gnss_right", "gnss"), -1.0)])
def test_the_baseline_goes_from_the_first_antenna_to_the_second_or_as_it_is_named(baseline, sign):
    plain = sensors_of(machine(right=True, heading=True))["heading"].axis
    named = sensors_of(machine(right=True, heading=True, heading_={"baseline": baseline}))["heading"].axis
    np.testing.assert_allclose(named, sign * plain)


# --- conversion -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("heading", "outcome"),
    [
        (message(nan), Outcome.NOT_FINITE),
        (message(inf), Outcome.NOT_FINITE),
        (message(sigma_rad=nan), Outcome.NOT_FINITE),
        (message(sigma_rad=inf), Outcome.NOT_FINITE),
        (message(sigma_rad=-0.1), Outcome.NOT_FINITE),
        (message(sigma_rad=2.0), Outcome.LARGE_COVARIANCE),
    ],
)
def test_a_heading_that_cannot_be_used_is_refused(heading, outcome):
    assert MODEL.convert(heading, PLACED) is outcome


@pytest.mark.parametrize(
    ("claim", "sigma_rad"),
    [(1e-6, radians(CONFIG.min_sigma_deg)), (None, radians(CONFIG.default_sigma_deg)), (0.02, 0.02)],
)
def test_the_claim_has_a_floor_and_the_default_stands_in_for_none(claim, sigma_rad):
    assert MODEL.convert(message(sigma_rad=claim), PLACED).sigma_rad == sigma_rad


@pytest.mark.parametrize("compass_deg", [0.0, 90.0, -60.0, 200.0])
def test_clockwise_from_north_is_an_angle_of_a_compass(compass_deg):
    found = configured(clockwise=True).convert(message(radians(compass_deg)), PLACED).yaw_rad
    expected = MODEL.convert(message(radians(90.0 - compass_deg)), PLACED).yaw_rad
    assert np.exp(1j * found) == pytest.approx(np.exp(1j * expected))


def test_the_time_offset_is_applied():
    assert configured(time_offset_s=0.5).convert(message(), PLACED).stamp_ns == 500_000_000
