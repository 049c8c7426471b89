"""GNSS: what is refused and why, what a fix weighs, and the position factor with the lever arm inside."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import ARM, Drive, fix_at, tilted_circle
from numeric import PLACED, assert_derivatives, assert_jacobians, random_state, residual

from holdfast.config.sensors import GnssConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import FixStatus
from holdfast.sensors.gnss import GnssModel
from holdfast.sensors.lever_arm import doubtful_arm
from holdfast.sensors.sensor import Position

X = gtsam.symbol("x", 0)
GOOD = fix_at(Drive(), 0.0)


def model(arm=ARM, **settings):
    return GnssModel("gnss", GnssConfig(kind="gnss", topic="/gnss", **settings), arm)


MODEL = model()


def position_of(p_W_G, covariance=None):
    covariance = np.diag([1e-4, 4e-4, 9e-4]) if covariance is None else covariance
    return Position(0, "gnss", np.asarray(p_W_G), covariance, 0.0)


def values_at(nav):
    values = gtsam.Values()
    values.insert(X, nav)
    return values


def test_the_factor_is_zero_where_the_antenna_is():
    nav = tilted_circle().nav(2.0)
    factor = MODEL.factor([X], position_of(nav.pose().transformFrom(ARM)), 1.0)
    np.testing.assert_allclose(residual(factor, values_at(nav)), np.zeros(3), atol=1e-9)


def test_the_residual_is_the_antennas_error_in_sigmas():
    nav = gtsam.NavState(gtsam.Rot3.Yaw(np.pi / 2), np.array([10.0, 20.0, 30.0]), np.zeros(3))
    # turned left by 90 deg the arm (0.4, -0.5, 1.2) points to (0.5, 0.4, 1.2)
    factor = MODEL.factor([X], position_of([10.5 - 0.01, 20.4 - 0.04, 31.2 + 0.06]), 1.0)
    np.testing.assert_allclose(abs(residual(factor, values_at(nav))), [1.0, 2.0, 2.0], atol=1e-9)
    assert factor.error(values_at(nav)) == pytest.approx(0.5 * 9.0)


@given(st.integers(0, 10_000))
def test_the_factor_has_the_jacobian_that_it_claims(seed):
    rng = np.random.default_rng(seed)
    nav = gtsam.NavState(gtsam.Rot3.Expmap(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 50.0, 3), rng.normal(0.0, 3.0, 3))
    root = rng.normal(0.0, 0.02, (3, 3)) + 0.05 * np.eye(3)
    factor = MODEL.factor(
        [X], position_of(nav.position() + rng.normal(0.0, 1.0, 3), root @ root.T + 1e-4 * np.eye(3)), 1.0
    )
    assert_jacobians(factor, values_at(nav))


@given(st.integers(0, 10_000))
def test_the_innovation_has_the_derivatives_that_it_claims_also_by_an_arm_that_is_estimated(seed):
    for sigmas in ((), (0.5, 0.5, 0.5)):
        assert_derivatives(MODEL, position_of([3.0, -2.0, 1.0]), random_state(seed, sigmas))


def test_an_arm_that_is_estimated_is_found_by_fixes_at_attitudes_that_are_known():
    estimated, truth = model().with_arm(doubtful_arm(np.full(3, 0.5))), ARM + np.array([0.3, -0.2, 0.1])
    graph, values, key = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.symbol("a", 0)
    values.insert(key, estimated.parameters[0].mean)
    for k, yaw in enumerate((0.0, 1.0, 2.0)):
        nav = gtsam.NavState(gtsam.Rot3.Yaw(yaw), np.array([float(k), 0.0, 0.0]), np.zeros(3))
        values.insert(gtsam.symbol("x", k), nav)
        graph.add(gtsam.PriorFactorNavState(gtsam.symbol("x", k), nav, gtsam.noiseModel.Isotropic.Sigma(9, 1e-4)))
        graph.add(estimated.factor([gtsam.symbol("x", k), key], position_of(nav.pose().transformFrom(truth)), 1.0))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atVector(key)
    np.testing.assert_allclose(MODEL.p_I_P + found, truth, atol=1e-5)


def test_a_fix_leads_to_the_pose_from_which_it_was_taken():
    nav = tilted_circle().nav(1.0)
    arms = [ARM, np.array([-0.7, -1.9, 1.1]), np.array([1.0, 2.0, 0.3])]
    graph = gtsam.NonlinearFactorGraph()
    for arm in arms:  # three antennas fix the attitude as well
        graph.add(model(arm).factor([X], position_of(nav.pose().transformFrom(arm)), 1.0))
    graph.add(gtsam.PriorFactorNavState(X, nav, gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1e3, 1e3, 1.0], 3))))
    start = values_at(nav.retract(np.array([0.2, -0.1, 0.3, 1.0, -2.0, 0.5, 0.1, 0.1, 0.1])))
    found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize().atNavState(X)
    assert np.linalg.norm(found.position() - nav.position()) < 1e-5
    assert np.linalg.norm(found.attitude().logmap(nav.attitude())) < 1e-5


@given(st.integers(0, 10_000))
def test_the_innovation_has_the_derivatives_that_it_claims(seed):
    state = random_state(seed)
    assert_derivatives(MODEL, position_of(state.nav.position() + 1.0), state)


def test_an_inflation_of_four_halves_the_weight_of_a_residual():
    nav, off = gtsam.NavState(), position_of(ARM + np.array([0.03, 0.0, 0.0]))
    once, four = (MODEL.factor([X], off, inflation).error(values_at(nav)) for inflation in (1.0, 4.0))
    assert once == pytest.approx(0.5 * 3.0**2) and four == pytest.approx(0.5 * 1.5**2)


# --- conversion -------------------------------------------------------------------------------------------------------


def test_a_fix_is_converted_to_metres_from_the_datum_at_its_own_time():
    position = model(time_offset_s=-0.25).convert(GOOD, PLACED)
    np.testing.assert_allclose(position.p_W_P, Drive().pose(0.0).transformFrom(ARM), atol=1e-8)
    np.testing.assert_allclose(position.covariance, GOOD.covariance)
    assert (position.stamp_ns, position.sensor) == (GOOD.stamp_ns - 250_000_000, "gnss")


def test_the_first_usable_fix_is_the_datum_and_one_that_is_refused_is_not():
    world = World()
    assert MODEL.convert(replace(GOOD, altitude_m=1e300), world) is Outcome.OUT_OF_RANGE
    assert world.datum is None
    np.testing.assert_allclose(MODEL.convert(GOOD, world).p_W_P, np.zeros(3), atol=1e-9)
    assert world.datum == (GOOD.latitude_deg, GOOD.longitude_deg, GOOD.altitude_m)


@pytest.mark.parametrize(("sigma_m", "correlation_s"), [(0.01, 0.25), (0.3, 10.0)])
def test_the_errors_of_a_float_solution_have_a_longer_correlation_time(sigma_m, correlation_s):
    fix = replace(GOOD, covariance=np.eye(3) * sigma_m**2)
    assert MODEL.convert(fix, PLACED).correlation_s == correlation_s


@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ({}, Outcome.USED),
        ({"latitude_deg": np.nan}, Outcome.NOT_FINITE),
        ({"longitude_deg": np.inf}, Outcome.NOT_FINITE),
        ({"altitude_m": -np.inf}, Outcome.NOT_FINITE),
        ({"latitude_deg": np.nan, "status": FixStatus.NO_FIX}, Outcome.LOW_STATUS),
        ({"status": FixStatus.NO_FIX}, Outcome.LOW_STATUS),
        ({"status": FixStatus.UNKNOWN}, Outcome.LOW_STATUS),
        ({"latitude_deg": 90.1}, Outcome.OUT_OF_RANGE),
        ({"latitude_deg": 1e300}, Outcome.OUT_OF_RANGE),
        ({"longitude_deg": -1e300}, Outcome.OUT_OF_RANGE),
        ({"covariance": np.diag([1e-4, -1e-4, 1e-4])}, Outcome.NO_COVARIANCE),
        ({"covariance": np.diag([1e-4, np.nan, 1e-4])}, Outcome.NO_COVARIANCE),
        ({"covariance": np.diag([1.0, 1.01, 1.0])}, Outcome.LARGE_COVARIANCE),
        ({"covariance": np.diag([1e300, 1e300, 1e300])}, Outcome.LARGE_COVARIANCE),
    ],
)
def test_a_fix_is_refused_for_the_reason_that_it_gives(change, outcome):
    assert outcome_of(MODEL, replace(GOOD, **change)) is outcome


@pytest.mark.parametrize("altitude_m", [1e300, -1e9, 1e6])
def test_an_altitude_beyond_any_machine_is_out_of_range(altitude_m):
    assert outcome_of(MODEL, replace(GOOD, altitude_m=altitude_m)) is Outcome.OUT_OF_RANGE


@pytest.mark.parametrize(
    ("needed", "status", "outcome"),
    [
        ("sbas", FixStatus.FIX, Outcome.LOW_STATUS),
        ("gbas", FixStatus.SBAS, Outcome.LOW_STATUS),
        ("gbas", FixStatus.GBAS, Outcome.USED),
    ],
)
def test_the_status_that_the_configuration_asks_for_is_the_worst_that_is_used(needed, status, outcome):
    assert outcome_of(model(min_status=needed), replace(GOOD, status=status)) is outcome


@pytest.mark.parametrize(
    ("status", "sigmas_m"),
    [
        (FixStatus.FIX, (2.5, 2.5, 4.0)),
        (FixStatus.SBAS, (0.8, 0.8, 1.5)),
        (FixStatus.GBAS, (0.02, 0.02, 0.04)),
    ],
)
@pytest.mark.parametrize("claim", [None, np.zeros((3, 3))])
def test_the_status_stands_in_for_a_missing_covariance(status, sigmas_m, claim):
    fix = replace(GOOD, covariance=claim, status=status)
    np.testing.assert_allclose(MODEL.convert(fix, PLACED).covariance, np.diag(np.square(sigmas_m)))
    assert f"status {status.name.lower()} come without a covariance" in MODEL.assumption(fix)
    assert f"sensors.{MODEL.name}.default_sigma_m" in MODEL.assumption(fix)


def test_nothing_is_assumed_of_a_fix_that_claims_or_that_the_configuration_weighs():
    assert not MODEL.assumption(GOOD)
    assert not model(default_sigma_m=(0.1, 0.2, 0.3)).assumption(replace(GOOD, covariance=None))


def test_a_default_of_the_configuration_stands_in_for_a_missing_and_for_a_broken_covariance():
    patient = model(default_sigma_m=(0.1, 0.2, 0.3))
    for claim in (None, np.zeros((3, 3)), np.full((3, 3), np.nan)):
        covariance = patient.convert(replace(GOOD, covariance=claim), PLACED).covariance
        np.testing.assert_allclose(covariance, np.diag([0.01, 0.04, 0.09]))


@given(st.integers(0, 10_000))
def test_no_claim_of_a_receiver_counts_below_the_floor(seed):
    root = np.random.default_rng(seed).normal(0.0, 0.01, (3, 3))
    floored = MODEL.convert(replace(GOOD, covariance=root @ root.T), PLACED).covariance
    assert np.linalg.eigvalsh(floored).min() >= 0.005**2 * (1.0 - 1e-9)
    assert (np.diag(floored) >= np.diag(root @ root.T)).all()
    np.testing.assert_array_equal(floored, floored.T)


def test_a_claim_above_the_floor_is_left_as_it_is():
    claim = np.array([[4e-4, 1e-4, 0.0], [1e-4, 4e-4, 0.0], [0.0, 0.0, 9e-4]])
    np.testing.assert_allclose(MODEL.convert(replace(GOOD, covariance=claim), PLACED).covariance, claim, rtol=1e-12)


def outcome_of(sensor, fix):
    converted = sensor.convert(fix, PLACED)
    return Outcome.USED if isinstance(converted, Position) else converted


def test_a_robust_loss_takes_weight_from_a_far_fix_and_none_by_default():
    nav = gtsam.NavState()
    far = position_of(ARM + np.array([0.1, 0.0, 0.0]))  # ten sigma
    assert MODEL.factor([X], far, 1.0).error(values_at(nav)) == pytest.approx(50.0)
    huber = model(robust_loss={"kind": "huber", "threshold": 2.0}).factor([X], far, 1.0)
    assert huber.error(values_at(nav)) == pytest.approx(2.0 * (10.0 - 1.0))
