"""Factors of measurements with a slow error: linear about the prediction where that is good."""

import gtsam
import numpy as np
import pytest

from holdfast.config.sensors import RobustLoss
from holdfast.sensors.coloured import SlowError, coloured, coloured_factor
from holdfast.sensors.noise import Colour
from holdfast.sensors.position import position_innovation
from holdfast.sensors.sensor import Innovation, Parameter, Position, State

ARM, NODE, SLOW = np.array([-1.0, 0.8, 2.0]), gtsam.symbol("x", 0), gtsam.symbol("s", 0)
COLOUR = Colour(0.3, 0.7, 60.0)
CLAIM = np.array([[4.0, 1.0, 0.0], [1.0, 5.0, 0.5], [0.0, 0.5, 9.0]]) * 1e-4
NAV = gtsam.NavState(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.7), np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, 0.1]))


class Antenna:
    """A sensor of positions."""

    parameters = ()

    @staticmethod
    def innovation(measured, state):
        return position_innovation(measured, state, ARM)


def compared(attitude_sigma_rad=1e-3, value=(0.0, 0.0, 0.0, 0.0)):
    """A fix 1 cm beside the prediction; its slow error has the elements 1 to 3 of its variable."""
    covariance = np.diag(np.repeat([attitude_sigma_rad, 0.01, 0.1, 1.0], 3) ** 2)
    measured = Position(0, "gnss", NAV.pose().transformFrom(ARM) + np.array([0.01, 0.0, 0.0]), CLAIM, 0.25, COLOUR)
    state, slow = State(NAV, covariance[:9, :9]), SlowError(SLOW, 1, np.asarray(value), covariance)
    return measured, coloured([NODE], state, Antenna.innovation(measured, state), COLOUR, slow), slow


def factor(attitude_sigma_rad=1e-3, **more):
    measured, found, slow = compared(attitude_sigma_rad)
    return coloured_factor(Antenna, measured, found, slow, 1.0, **more)


def values(nav=NAV, slow=(0.0, 0.0, 0.0, 0.0)):
    at = gtsam.Values()
    at.insert(NODE, nav)
    at.insert(SLOW, np.asarray(slow))
    return at


def test_white_and_slow_part_make_up_the_claim_and_the_slow_part_is_subtracted():
    _, found, _ = compared()
    root = found.innovation.H[:, 9:]
    np.testing.assert_allclose(found.innovation.R + root @ root.T, CLAIM, rtol=1e-12, atol=1e-12)
    _, other, _ = compared(value=(9.0, 1.0, -1.0, 0.5))
    np.testing.assert_allclose(other.innovation.y, found.innovation.y - root @ [1.0, -1.0, 0.5])


@pytest.mark.parametrize("moved", [0.0, 1e-3])
def test_the_linear_factor_is_the_evaluated_one_to_first_order(moved):
    nav = NAV.retract(np.full(9, moved))
    at = values(nav, (0.3, -1.0, 0.5, 0.2))
    linear, evaluated = factor(), factor(attitude_sigma_rad=0.5)
    assert isinstance(linear, gtsam.LinearContainerFactor)
    assert isinstance(evaluated, gtsam.CustomFactor)
    assert linear.error(at) == pytest.approx(evaluated.error(at), rel=5e-3)
    ours, theirs = (one.linearize(at).information() for one in (linear, evaluated))
    np.testing.assert_allclose(ours, theirs, rtol=1e-2, atol=1e-2 * abs(theirs).max())


class TwoConstants:
    """A sensor of positions with two parameters of its own, by which the innovation changes as by a state."""

    parameters = Parameter(np.zeros(3), np.ones(3)), Parameter(np.zeros(1), np.ones(1))

    @staticmethod
    def innovation(measured, state):
        found = position_innovation(measured, state._replace(parameter=state.parameter[:3]), ARM)
        along = np.array([[1.0], [2.0], [-1.0]])
        y = found.y - along @ state.parameter[3:]
        return Innovation(y, found.H, found.R, np.hstack([found.J, along]))


def test_of_more_variables_than_gtsam_takes_the_linear_factor_is_the_evaluated_one_too():
    keys, parameter = [NODE, gtsam.symbol("D", 0), gtsam.symbol("B", 0)], np.array([0.2, -0.1, 0.3, 0.05])
    measured, _, slow = compared()
    found = []
    for sigma in (1e-3, 0.5):
        state = State(NAV, compared(sigma)[1].state.covariance[:9, :9], parameter=parameter)
        innovation = TwoConstants.innovation(measured, state)
        joint = coloured(keys, state, innovation, COLOUR, compared(sigma)[2])
        found.append(coloured_factor(TwoConstants, measured, joint, slow, 1.0))
    linear, evaluated = found
    assert isinstance(linear, gtsam.LinearContainerFactor) and isinstance(evaluated, gtsam.CustomFactor)
    at = values(NAV.retract(np.full(9, 1e-4)), (0.3, -1.0, 0.5, 0.2))
    at.insert(keys[1], parameter[:3] + 0.01)
    at.insert(keys[2], parameter[3:] - 0.02)
    assert linear.error(at) == pytest.approx(evaluated.error(at), rel=5e-3)
    order = gtsam.Ordering()
    for key in (*keys, SLOW):
        order.push_back(key)
    ours, theirs = (gtsam.GaussianFactorGraph(), gtsam.GaussianFactorGraph())
    ours.add(linear.linearize(at))
    theirs.add(evaluated.linearize(at))
    ours, theirs = (graph.hessian(order)[0] for graph in (ours, theirs))
    np.testing.assert_allclose(ours, theirs, rtol=1e-2, atol=1e-2 * abs(theirs).max())


def test_a_robust_loss_is_kept():
    far = values(slow=(0.0, 50.0, 0.0, 0.0))
    plain = factor().error(far)
    assert factor(loss=RobustLoss(kind="huber", threshold=2.5)).error(far) < 0.2 * plain


def test_what_the_graph_has_not_taken_in_yet_is_used_as_it_is_and_not_written():
    new = gtsam.Values()
    new.insert(NODE, NAV)
    new.insert(gtsam.symbol("x", 7), gtsam.NavState())
    at = values(NAV.retract(np.full(9, 1e-3)))
    assert factor(new=new).error(at) == factor().error(at) > 0.0
    assert new.size() == 2
    elsewhere = gtsam.Values()
    elsewhere.insert(NODE, NAV.retract(np.full(9, 0.1)))
    assert factor(new=elsewhere).error(at) > 2.0 * factor().error(at)
