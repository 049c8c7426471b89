"""An odometry whose clock has stepped turns too far while the rate grows; a bias does so all the time."""

import numpy as np
import pytest

from holdfast.integrity.clock_trace import FARTHEST_S, ClockTrace

NOISE_RAD = np.radians(0.05)


def seen(turns_beyond, clock_s=0.0, believed_s=0.0, seed=0, steps=12):
    """A trace beside a machine that turns at rates between -0.8 and 0.8 rad/s, at other ones each second."""
    rng = np.random.default_rng(seed)
    rates = rng.uniform(-0.8, 0.8, steps + 1)[:, None] * [0.0, 0.05, 1.0]
    trace = ClockTrace()
    for change, beyond in zip(np.diff(rates, axis=0), turns_beyond(steps), strict=True):
        late = (clock_s - believed_s) * change
        trace.add(late + beyond + rng.normal(0.0, NOISE_RAD, 3), change, believed_s)
    return trace


def nothing(steps):
    return np.zeros((steps, 3))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("clock_s", [-0.3, -0.1, 0.14])
def test_a_clock_that_has_stepped_is_measured(clock_s, seed):
    trace = seen(nothing, clock_s, seed=seed)
    assert trace.may_be_late
    assert trace.stepped_s == pytest.approx(clock_s, abs=0.01)


@pytest.mark.parametrize("seed", range(10))
def test_a_clock_that_is_believed_explains_nothing_more(seed):
    trace = seen(nothing, 0.1, believed_s=0.1, seed=seed)
    assert not trace.may_be_late and trace.stepped_s is None


@pytest.mark.parametrize("seed", range(10))
def test_a_clock_that_is_believed_too_far_is_taken_back(seed):
    assert seen(nothing, 0.0, believed_s=0.15, seed=seed).stepped_s == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("seed", range(40))
def test_a_bias_that_has_jumped_is_no_clock(seed):
    def jumped(steps):
        return np.where(np.arange(steps)[:, None] > 6, np.radians([0.0, 0.0, 3.0]), 0.0)

    assert not seen(jumped, seed=seed).may_be_late


def test_a_clock_is_not_believed_to_be_off_by_more_than_any_transport_takes():
    assert seen(nothing, 2.0 * FARTHEST_S).stepped_s is None


def test_one_step_alone_tells_no_clock_and_what_was_before_a_jump_is_forgotten():
    trace = ClockTrace()
    change, beyond = np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 0.05])
    trace.add(beyond, change, 0.0)
    trace.add(0.01 * beyond, 0.01 * change, 0.0)
    assert trace.may_be_late and trace.stepped_s is None
    trace.add(beyond, change, 0.0)
    assert trace.stepped_s == pytest.approx(0.1)
    trace.clear()
    assert not trace.may_be_late and trace.stepped_s is None


def test_a_machine_that_turns_evenly_tells_nothing():
    trace = ClockTrace()
    for _ in range(3):
        trace.add(np.array([0.0, 0.0, 0.05]), np.zeros(3), 0.0)
    assert not trace.may_be_late
