"""GNSS: what is refused and why, what a fix weighs, and the position factor with the lever arm inside."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import ARM, Drive, fix_at, machine, tilted_circle
from numeric import assert_jacobians, residual

from holdfast.config.model import GnssConfig
from holdfast.geometry.earth import Geodetic, geodetic_to_enu
from holdfast.messages import FixStatus
from holdfast.sensors.gnss import AntennaPosition, GnssModel
from holdfast.state import Outcome

X = gtsam.symbol("x", 0)
MODEL = GnssModel(GnssConfig(topic="/gnss"), ARM)
GOOD = fix_at(Drive(), 0.0)


def position_of(p_W_G, covariance=None):
    return AntennaPosition(
        0, "gnss", np.asarray(p_W_G), np.diag([1e-4, 4e-4, 9e-4]) if covariance is None else covariance
    )


def values_at(nav):
    values = gtsam.Values()
    values.insert(X, nav)
    return values


def test_the_factor_is_zero_where_the_antenna_is():
    nav = tilted_circle().nav(2.0)
    factor = MODEL.factor(X, position_of(nav.pose().transformFrom(ARM)))
    np.testing.assert_allclose(residual(factor, values_at(nav)), np.zeros(3), atol=1e-9)


def test_the_residual_is_the_antennas_miss_in_sigmas():
    nav = gtsam.NavState(gtsam.Rot3.Yaw(np.pi / 2), np.array([10.0, 20.0, 30.0]), np.zeros(3))
    # turned left by 90 deg the arm (0.4, -0.5, 1.2) points to (0.5, 0.4, 1.2)
    factor = MODEL.factor(X, position_of([10.5 - 0.01, 20.4 - 0.04, 31.2 + 0.06]))
    np.testing.assert_allclose(abs(residual(factor, values_at(nav))), [1.0, 2.0, 2.0], atol=1e-9)
    assert factor.error(values_at(nav)) == pytest.approx(0.5 * 9.0)


@given(st.integers(0, 10_000))
def test_the_factor_has_the_jacobian_that_it_claims(seed):
    rng = np.random.default_rng(seed)
    nav = gtsam.NavState(gtsam.Rot3.Expmap(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 50.0, 3), rng.normal(0.0, 3.0, 3))
    root = rng.normal(0.0, 0.02, (3, 3)) + 0.05 * np.eye(3)
    factor = MODEL.factor(X, position_of(nav.position() + rng.normal(0.0, 1.0, 3), root @ root.T + 1e-4 * np.eye(3)))
    assert_jacobians(factor, values_at(nav))


def test_a_fix_leads_to_the_pose_from_which_it_was_taken():
    nav = tilted_circle().nav(1.0)
    arms = [ARM, np.array([-0.7, -1.9, 1.1]), np.array([1.0, 2.0, 0.3])]
    graph = gtsam.NonlinearFactorGraph()
    for arm in arms:  # three antennas fix the attitude as well
        graph.add(GnssModel(GnssConfig(topic="/g"), arm).factor(X, position_of(nav.pose().transformFrom(arm))))
    graph.add(gtsam.PriorFactorNavState(X, nav, gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1e3, 1e3, 1.0], 3))))
    start = values_at(nav.retract(np.array([0.2, -0.1, 0.3, 1.0, -2.0, 0.5, 0.1, 0.1, 0.1])))
    found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize().atNavState(X)
    assert np.linalg.norm(found.position() - nav.position()) < 1e-5
    assert np.linalg.norm(found.attitude().logmap(nav.attitude())) < 1e-5


def test_the_receivers_coordinates_come_back_as_metres_from_the_datum():
    from motion import DATUM

    point = Geodetic(GOOD.latitude_deg, GOOD.longitude_deg, GOOD.altitude_m)
    expected = Drive().pose(0.0).transformFrom(ARM)
    np.testing.assert_allclose(geodetic_to_enu(point, DATUM), expected, atol=1e-8)


# --- checks -----------------------------------------------------------------------------------------------------------


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
        ({"covariance": None}, Outcome.NO_COVARIANCE),
        ({"covariance": np.zeros((3, 3))}, Outcome.NO_COVARIANCE),
        ({"covariance": np.diag([1e-4, -1e-4, 1e-4])}, Outcome.NO_COVARIANCE),
        ({"covariance": np.diag([1e-4, np.nan, 1e-4])}, Outcome.NO_COVARIANCE),
        ({"covariance": np.diag([1.0, 1.01, 1.0])}, Outcome.LARGE_COVARIANCE),
        ({"covariance": np.diag([1e300, 1e300, 1e300])}, Outcome.LARGE_COVARIANCE),
    ],
)
def test_a_fix_is_refused_for_the_reason_that_it_gives(change, outcome):
    assert MODEL.check(replace(GOOD, **change)) is outcome


@pytest.mark.parametrize("altitude_m", [1e300, -1e9, 1e6])
def test_an_altitude_beyond_any_machine_is_out_of_range(altitude_m):
    assert MODEL.check(replace(GOOD, altitude_m=altitude_m)) is Outcome.OUT_OF_RANGE


@pytest.mark.parametrize(
    ("needed", "status", "outcome"),
    [
        ("sbas", FixStatus.FIX, Outcome.LOW_STATUS),
        ("gbas", FixStatus.SBAS, Outcome.LOW_STATUS),
        ("gbas", FixStatus.GBAS, Outcome.USED),
    ],
)
def test_the_status_that_the_configuration_asks_for_is_the_worst_that_is_used(needed, status, outcome):
    model = GnssModel(GnssConfig(topic="/g", min_status=needed), ARM)
    assert model.check(replace(GOOD, status=status)) is outcome


def test_a_default_stands_in_for_a_missing_covariance_only_if_it_is_given():
    model = GnssModel(GnssConfig(topic="/g", default_sigma_m=(0.1, 0.2, 0.3)), ARM)
    for claim in (None, np.zeros((3, 3)), np.full((3, 3), np.nan)):
        fix = replace(GOOD, covariance=claim)
        assert model.check(fix) is Outcome.USED
        np.testing.assert_allclose(model.covariance(fix), np.diag([0.01, 0.04, 0.09]))


@given(st.integers(0, 10_000))
def test_no_claim_of_a_receiver_is_believed_below_the_floor(seed):
    root = np.random.default_rng(seed).normal(0.0, 0.01, (3, 3))
    floored = MODEL.covariance(replace(GOOD, covariance=root @ root.T))
    assert np.linalg.eigvalsh(floored).min() >= 0.005**2 * (1.0 - 1e-9)
    assert (np.diag(floored) >= np.diag(root @ root.T)).all()
    np.testing.assert_array_equal(floored, floored.T)


def test_a_claim_above_the_floor_is_left_as_it_is():
    claim = np.array([[4e-4, 1e-4, 0.0], [1e-4, 4e-4, 0.0], [0.0, 0.0, 9e-4]])
    np.testing.assert_allclose(MODEL.covariance(replace(GOOD, covariance=claim)), claim, rtol=1e-12)


def test_a_robust_loss_takes_weight_from_a_far_fix_and_none_by_default():
    nav = gtsam.NavState()
    far = position_of(ARM + np.array([0.1, 0.0, 0.0]))  # ten sigma
    assert MODEL.factor(X, far).error(values_at(nav)) == pytest.approx(50.0)
    config = machine(gnss_={"robust_loss": {"kind": "huber", "threshold": 2.0}}).sensors.gnss
    huber = GnssModel(config, ARM).factor(X, far)
    assert huber.error(values_at(nav)) == pytest.approx(2.0 * (10.0 - 1.0))
