"""Zero-velocity updates: at fixed times, in quiet windows, in all graphs, and only where the speed agrees."""

import gtsam
import numpy as np
from motion import Drive, imu, machine, ns
from rig import NO_BIAS, SIGMAS, smoother_of

from holdfast.estimator.standstill import StandstillUpdates
from holdfast.state import OptimisedState

STILL = Drive(start_s=100.0)


def begun(motion=STILL, end_s=4.0, velocity=(0.0, 0.0, 0.0), velocity_sigma=0.2, **standstill):
    config = machine(standstill=standstill)
    nav = motion.nav(0.0)
    nav = gtsam.NavState(nav.attitude(), nav.position(), nav.velocity() + np.array(velocity))
    sigmas = SIGMAS.copy()
    sigmas[6:9] = velocity_sigma
    state = OptimisedState(ns(0.0), nav, NO_BIAS, np.diag(sigmas**2), motion.readings(0.0)[1])
    smoother = smoother_of(motion, end_s, config=config, state=state)
    smoother.node(ns(end_s))
    return smoother, StandstillUpdates(config.standstill, smoother.imu)


def test_a_standing_machine_is_held_every_half_second():
    smoother, updates = begun(velocity=(0.1, -0.1, 0.05))
    # windows of a second lie around 0.5, 1.0, ... 3.5 s
    assert updates.add_to([smoother]) == 7
    assert np.linalg.norm(smoother.optimise().nav.velocity()) < 0.005
    assert updates.add_to([smoother]) == 0  # once each


def test_the_updates_do_not_depend_on_when_they_are_asked_for():
    smoother, updates = begun(end_s=2.0)
    other = updates.add_to([smoother])
    for sample in imu(STILL, 2.01, 4.0):
        smoother.imu.add(sample)
    smoother.node(ns(4.0))
    assert other + updates.add_to([smoother]) == 7


def test_a_machine_that_moves_is_not_held_however_quiet_its_imu():
    """1 m/s, known to 0.1 m/s, on a machine whose IMU measures nothing but gravity."""
    smoother, updates = begun(velocity=(1.0, 0.0, 0.0), velocity_sigma=0.1)
    assert updates.add_to([smoother]) == 0


def test_a_machine_that_shakes_is_not_held():
    smoother, updates = begun(Drive(start_s=-3.0))
    assert updates.add_to([smoother]) == 0


def test_all_graphs_are_held_or_none():
    smoother, updates = begun()
    moving, _ = begun(velocity=(1.0, 0.0, 0.0), velocity_sigma=0.1)
    assert updates.add_to([smoother, moving]) == 0
    smoother, updates = begun(end_s=2.5, velocity=(0.1, 0.0, 0.0))
    smoother.optimise()
    clone = smoother.clone()
    assert updates.add_to([smoother, clone]) == 4
    assert max(np.linalg.norm(one.optimise().nav.velocity()) for one in (smoother, clone)) < 0.005


def test_it_may_be_disabled():
    smoother, updates = begun(enabled=False)
    assert updates.add_to([smoother]) == 0
