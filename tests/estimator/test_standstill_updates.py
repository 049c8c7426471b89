"""Zero-velocity updates: at fixed times, in quiet windows, in all graphs, and only where the speed agrees."""

import gtsam
import numpy as np
import pytest
from motion import Drive, imu, machine, ns
from rig import NO_BIAS, SIGMAS, G, smoother_of

from holdfast.estimator.standstill import StandstillUpdates
from holdfast.state import OptimisedState

STILL = Drive(start_s=100.0)


def begun(motion=STILL, end_s=4.0, velocity=(0.0, 0.0, 0.0), velocity_sigma=0.2, stands=True, **standstill):
    config = machine(standstill=standstill)
    nav = motion.nav(0.0)
    nav = gtsam.NavState(nav.attitude(), nav.position(), nav.velocity() + np.array(velocity))
    sigmas = SIGMAS.copy()
    sigmas[6:9] = velocity_sigma
    state = OptimisedState(ns(0.0), nav, NO_BIAS, np.diag(sigmas**2), motion.readings(0.0)[1])
    smoother = smoother_of(motion, end_s, config=config, state=state)
    smoother.node(ns(end_s))
    return smoother, StandstillUpdates(config.standstill, smoother.imu, G, lambda *_: stands)


def test_a_standing_machine_is_held_every_half_second():
    smoother, updates = begun(velocity=(0.1, -0.1, 0.05))
    # windows of a second lie around 0.5, 1.0, ... 3.0 s; that around 3.5 s has no quiet one after it yet
    assert len(updates.add_to([smoother])) == 6
    assert np.linalg.norm(smoother.optimise().nav.velocity()) < 0.005
    assert len(updates.add_to([smoother])) == 0  # once each


def test_the_updates_do_not_depend_on_when_they_are_asked_for():
    smoother, updates = begun(end_s=2.0)
    other = len(updates.add_to([smoother]))
    for sample in imu(STILL, 2.01, 4.0):
        smoother.imu.add(sample)
    smoother.node(ns(4.0))
    assert other + len(updates.add_to([smoother])) == 6


def test_a_machine_that_moves_is_not_held_however_quiet_its_imu():
    """1 m/s, known to 0.1 m/s, on a machine whose IMU measures nothing but gravity."""
    smoother, updates = begun(velocity=(1.0, 0.0, 0.0), velocity_sigma=0.1)
    assert len(updates.add_to([smoother])) == 0


def test_a_machine_that_shakes_is_not_held():
    smoother, updates = begun(Drive(start_s=-3.0))
    assert len(updates.add_to([smoother])) == 0


def test_all_graphs_are_held_or_none():
    smoother, updates = begun()
    moving, _ = begun(velocity=(1.0, 0.0, 0.0), velocity_sigma=0.1)
    assert len(updates.add_to([smoother, moving])) == 0
    smoother, updates = begun(end_s=2.5, velocity=(0.1, 0.0, 0.0))
    smoother.optimise()
    clone = smoother.clone()
    assert len(updates.add_to([smoother, clone])) == 3
    assert max(np.linalg.norm(one.optimise().nav.velocity()) for one in (smoother, clone)) < 0.005


def test_it_may_be_disabled():
    smoother, updates = begun(enabled=False)
    assert len(updates.add_to([smoother])) == 0


@pytest.mark.parametrize(("stands", "expected"), [(True, 6), (False, 0), (None, 0)])
def test_where_the_velocity_is_not_known_the_fixes_must_say_that_it_stands(stands, expected):
    smoother, updates = begun(velocity_sigma=2.0, stands=stands)
    assert len(updates.add_to([smoother])) == expected


@pytest.mark.parametrize(("stands", "expected"), [(True, 6), (False, 0), (None, 6)])
def test_where_it_is_known_the_fixes_need_not_tell_but_may_deny_it(stands, expected):
    """The updates themselves make the velocity known: once held, a machine that set off gently was held for ever."""
    smoother, updates = begun(velocity_sigma=0.02, stands=stands)
    assert len(updates.add_to([smoother])) == expected


@pytest.mark.parametrize("acceleration", [0.5, 1.0, 3.0])
def test_even_braking_is_no_standstill_though_quiet_and_slow_enough(acceleration):
    """Whatever the fixes say; tilt and bias are known to a hundredth of what brakes."""
    smoother, _ = begun(velocity_sigma=2.0)
    braking = smoother_of(STILL, 0.0).imu
    for sample in imu(STILL, 0.01, 4.0):
        sample.specific_force[:] -= STILL.nav(0.0).attitude().unrotate(np.array([acceleration, 0.0, 0.0]))
        braking.add(sample)
    smoother.imu = braking
    updates = StandstillUpdates(machine().standstill, braking, G, lambda *_: True)
    assert len(updates.add_to([smoother])) == 0


def test_what_is_taken_back_leaves_the_state_as_it_was_without_it():
    smoother, updates = begun(end_s=2.9, velocity=(0.1, 0.0, 0.0))  # all within the window of 3 s
    other, _ = begun(end_s=2.9, velocity=(0.1, 0.0, 0.0))
    expected = other.optimise().nav.velocity()
    assert len(updates.add_to([smoother])) == 3
    assert np.linalg.norm(smoother.optimise().nav.velocity()) < 0.005
    assert updates.take_back([smoother]) == 3
    np.testing.assert_allclose(smoother.optimise().nav.velocity(), expected, atol=2e-3)
    assert updates.take_back([smoother]) == 0  # once each
    assert len(updates.add_to([smoother])) == 0  # and they are not added again


def test_only_those_in_the_window_are_taken_back():
    smoother, updates = begun(end_s=9.0)
    for t in np.arange(0.5, 9.0, 0.5):
        smoother.node(ns(t))
        updates.add_to([smoother])
        smoother.optimise()
    assert 0 < updates.take_back([smoother]) <= 7  # of 3 s, one each half second
