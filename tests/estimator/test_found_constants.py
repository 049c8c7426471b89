"""What a start has found of antennas and the clock of GNSS, and that it can be forgotten."""

import numpy as np
import pytest
from motion import ARM, Drive, G, machine, ns
from rig import buffered, position

from holdfast.estimator.batch_clock import Offset
from holdfast.estimator.initialisation import Initialising
from holdfast.sensors.clock import GNSS_CLOCK
from holdfast.sensors.lever_arm import GNSS_ARM, doubtful_arm
from holdfast.sensors.registry import sensors_of

ROAD, END_S = Drive(), 5.0
SHIFT = doubtful_arm(np.full(3, 0.1), GNSS_ARM)._replace(mean=np.array([0.0, 1.0, 0.0]))
LATE = Offset(-0.2, 0.01)


def begun(before=None):
    config = machine(lidar=False, right=True)
    start = Initialising(config, buffered(ROAD, END_S, config), sensors_of(config), G, before or {})
    start.add(position(ROAD, 1.0, ARM))
    return start


def stamps(start):
    return [one.stamp_ns for one in start._collected.positions]


def test_what_is_found_adds_up_and_holds_for_what_comes():
    start = begun()
    start.found.move_antennas(SHIFT)
    start.found.move_antennas(SHIFT)
    start.found.know_clock_off(LATE)
    start.found.know_clock_off(LATE)
    start.add(position(ROAD, 2.0, ARM))
    assert stamps(start) == [ns(0.6), ns(1.6)]
    np.testing.assert_allclose(start._points["gnss"].p_I_P, ARM + 2.0 * SHIFT.mean)
    np.testing.assert_allclose(start.found.priors[GNSS_ARM].mean, 2.0 * SHIFT.mean)
    np.testing.assert_allclose(start.found.priors[GNSS_CLOCK].mean, -0.4)


@pytest.mark.parametrize("before", [{}, {GNSS_ARM: SHIFT}])
def test_what_is_forgotten_is_what_was_found_since(before):
    start = begun(before)
    start.settle_arms()
    start.found.move_antennas(SHIFT)
    start.found.know_clock_off(LATE)
    assert not start.found.newly_forgotten()
    start.found.forget()
    assert start.found.newly_forgotten() and not start.found.newly_forgotten()
    assert start.found.priors.keys() == before.keys() and stamps(start) == [ns(1.0)] and start.clock_ns == 0
    expected = ARM + (SHIFT.mean if before else 0.0)
    np.testing.assert_allclose(start._points["gnss"].p_I_P, expected)
    assert start._batches.may_be_moved
