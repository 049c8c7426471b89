"""Slow errors in a smoother: unit variance, decay with time and distance, and what ends them."""

from math import exp

import gtsam
import numpy as np
import pytest
from motion import Drive, machine, ns
from rig import smoother_of

from holdfast.sensors.noise import Colour

DRIVE = Drive(start_s=-3.0)
COLOUR = Colour(0.5, 0.5, 60.0)
COLOURED = {"gnss_": {"correlation_s": 0.25}}


@pytest.fixture
def smoother():
    return smoother_of(DRIVE, 12.0, config=machine(lidar=False, **COLOURED))


def at(smoother, t, colour=COLOUR, at_W=None):
    """The slow error at a time, on a node that is made."""
    smoother.node(ns(t))
    return smoother.slow_error("gnss", colour, ns(t), at_W)


def known(smoother, t, sigma=0.1):
    """Make the slow error known at a time."""
    slow = at(smoother, t)
    smoother.add(gtsam.PriorFactorVector(slow.key, np.full(3, 2.0), gtsam.noiseModel.Isotropic.Sigma(3, sigma)))
    smoother.optimise()


def of_slow(slow):
    return slow.covariance[9:, 9:]


def test_a_slow_error_begins_with_unit_variance_independent_of_the_state(smoother):
    slow = at(smoother, 0.1)
    np.testing.assert_allclose(of_slow(slow), np.eye(3))
    np.testing.assert_allclose(slow.covariance[:9, 9:], 0.0)
    np.testing.assert_allclose(slow.value, 0.0)


def test_what_is_known_of_it_decays_with_its_time_constant(smoother):
    known(smoother, 0.1)
    slow = at(smoother, 2.1)
    decay = exp(-2.0 / 60.0)
    np.testing.assert_allclose(slow.value, 2.0 / 1.01 * decay, rtol=1e-6)
    variance = decay**2 * (1.0 / 101.0) + 1.0 - decay**2
    np.testing.assert_allclose(of_slow(slow), np.eye(3) * variance, rtol=1e-6, atol=1e-9)
    smoother.optimise()
    np.testing.assert_allclose(of_slow(at(smoother, 2.2)), np.eye(3) * variance, rtol=1e-3, atol=1e-6)


def test_it_decays_with_the_distance_that_the_antenna_moved(smoother):
    colour = COLOUR._replace(distance_constant_m=2.0)
    at(smoother, 0.1, colour, np.zeros(3))
    known(smoother, 0.2)
    at(smoother, 0.3, colour, np.array([2.0, 0.0, 0.0]))
    slow = at(smoother, 1.3, colour, np.array([2.0, 0.0, 0.0]))
    np.testing.assert_allclose(slow.value, 2.0 / 1.01 * exp(-1.0 - 1.2 / 60.0), rtol=1e-6)


def test_it_is_not_forgotten_in_a_silence_longer_than_the_window(smoother):
    known(smoother, 0.1)
    for t in np.arange(0.5, 8.0, 0.5):
        smoother.node(ns(t))
        smoother.optimise()
    np.testing.assert_allclose(at(smoother, 8.1).value, 2.0 / 1.01 * exp(-8.0 / 60.0), rtol=1e-3)


@pytest.mark.parametrize("how", ["renewed", "another kind"])
def test_errors_of_another_kind_and_those_after_a_recovery_have_nothing_to_do_with_those_before(smoother, how):
    known(smoother, 0.1)
    if how == "renewed":
        smoother.renew_slow_errors()
    slow = at(smoother, 0.5, COLOUR if how == "renewed" else COLOUR._replace(time_constant_s=100.0))
    np.testing.assert_allclose(slow.value, 0.0)
    np.testing.assert_allclose(of_slow(slow), np.eye(3), atol=1e-9)


def test_a_clone_goes_its_own_way(smoother):
    known(smoother, 0.1)
    clone = smoother.clone()
    clone.renew_slow_errors()
    np.testing.assert_allclose(at(clone, 0.2).value, 0.0)
    np.testing.assert_allclose(at(smoother, 0.2).value, 2.0 / 1.01, rtol=1e-3)
