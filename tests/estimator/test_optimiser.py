"""The half that optimises: a phase before the start, another after it, and nothing that survives a restart."""

from dataclasses import replace

import numpy as np
import pytest
from motion import DATUM, Drive, G, fixes, imu, in_order, machine, ns, optimised, scans

from holdfast.estimator.imu_path import receive
from holdfast.estimator.optimiser import Optimiser
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Health, Outcome
from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2, Geodetic, gravity
from holdfast.messages import Heading, JointAngle
from holdfast.sensors.imu import ImuBuffer

DRIVE = Drive()
ELSEWHERE = Geodetic(10.0, 20.0, 3000.0)


def messages(end_s=6.0):
    rng = np.random.default_rng(1)
    return in_order(
        imu(DRIVE, 0.0, end_s, 100.0, rng), fixes(DRIVE, 0.0, end_s, 10.0, rng), scans(DRIVE, 0.0, end_s, 5.0, rng)
    )


def fresh(config):
    buffer, log = ImuBuffer(config.imu), EventLog("imu")
    return Optimiser(config, buffer, log), buffer, log


def test_before_the_start_there_is_no_tracking_and_it_says_what_it_waits_for():
    optimiser, _, log = fresh(machine())
    assert optimiser.tracking is None and not optimiser.is_due
    assert optimiser.waiting_for == "no usable IMU sample has come, and no usable position has come"
    assert (optimiser.lost(), optimiser.waiting.total(), optimiser.health) == ([], 0, Health.INITIALISING)
    optimiser.add(fixes(DRIVE, 0.0, 0.0)[0])
    assert log.counts["gnss", Outcome.BEFORE_START] == 1


def test_the_first_state_is_reported_and_tracking_begins():
    optimiser, log, _ = optimised(machine(), messages())
    assert optimiser.tracking is not None and optimiser.waiting_for == ""
    (event,) = [event for event in log.events if event.kind is EventKind.INITIALISED]
    assert event.reason == "standstill"
    assert optimiser.health is Health.NOMINAL


def test_a_restart_keeps_w_and_nothing_else():
    """What an odometry had proved to be, what waited, which stamps had come: all that belongs to a life."""
    optimiser, log, buffer = optimised(machine(), messages())
    before, waiting, fix = optimiser.tracking, optimiser.waiting["gnss"], fixes(DRIVE, 6.0, 6.0)[0]
    optimiser.add(replace(fix, stamp_ns=fix.stamp_ns + 500_000_000))
    assert optimiser.waiting["gnss"] == waiting + 1
    optimiser.restart()
    assert optimiser.tracking is None and optimiser.waiting.total() == 0
    assert optimiser.world.datum == DATUM
    assert optimiser.health is Health.INITIALISING
    assert [event.kind for event in log.take_events()][-1] is EventKind.RESET
    for sample in imu(Drive(start_s=100.0), 6.01, 8.0, 100.0, np.random.default_rng(2)):
        optimiser.receive(receive(buffer, sample))
    for k in range(5):
        again = fixes(Drive(start_s=100.0), 7.0 + 0.2 * k, 7.0 + 0.2 * k)[0]
        optimiser.add(again)
    assert optimiser.tracking is not None and optimiser.tracking is not before
    assert optimiser.tracking.graph is not before.graph


def test_after_a_restart_a_stamp_of_before_is_no_duplicate():
    optimiser, _, log = fresh(machine())
    fix = fixes(DRIVE, 0.0, 0.0)[0]
    optimiser.add(fix)
    optimiser.restart()
    optimiser.add(fix)
    assert log.counts["gnss", Outcome.DUPLICATE] == 0
    assert log.counts["gnss", Outcome.BEFORE_START] == 2


def test_a_new_datum_moves_w_takes_gravity_from_there_and_begins_anew():
    optimiser, _, _ = optimised(machine(), messages(3.0))
    assert optimiser.gravity == G
    optimiser.restart(ELSEWHERE)
    assert optimiser.world.datum == ELSEWHERE and optimiser.tracking is None
    assert optimiser.gravity == gravity(ELSEWHERE.latitude_deg, ELSEWHERE.altitude_m)


def test_without_a_datum_gravity_is_known_with_the_first_fix():
    config = machine(frames={"datum": None})
    optimiser, _, _ = fresh(config)
    assert optimiser.gravity == STANDARD_GRAVITY_M_S2 and optimiser.world.datum is None
    optimiser.add(fixes(DRIVE, 0.0, 0.0)[0])
    datum = optimiser.world.datum
    assert optimiser.gravity == gravity(datum.latitude_deg, datum.altitude_m) != STANDARD_GRAVITY_M_S2


def test_only_messages_of_its_sensors_are_wanted():
    optimiser, _, _ = fresh(machine())
    assert optimiser.wants(fixes(DRIVE, 0.0, 0.0)[0])
    assert not optimiser.wants(Heading(0, 0, "compass", 0.0, None))
    assert not optimiser.wants(JointAngle(0, 0, "joint", 0.0))


def test_what_cannot_be_converted_is_counted_and_reported_under_its_reason():
    optimiser, _, log = fresh(machine())
    fix = fixes(DRIVE, 0.0, 0.0)[0]
    optimiser.add(replace(fix, altitude_m=np.nan))
    optimiser.add(fix)
    optimiser.add(fix)
    assert log.counts["gnss", Outcome.NOT_FINITE] == log.counts["gnss", Outcome.DUPLICATE] == 1
    assert [event.reason for event in log.take_events() if event.kind is EventKind.REJECTED] == [
        "not_finite",
        "duplicate",
    ]


def test_a_clock_that_goes_back_for_good_begins_anew():
    optimiser, log, buffer = optimised(machine(), messages(4.0))
    for sample in imu(DRIVE, 4.01, 4.5):
        shifted = replace(sample, stamp_ns=sample.stamp_ns - 3_600_000_000_000)
        if buffer.check(shifted) is Outcome.USED:
            optimiser.receive(receive(buffer, shifted))
    assert optimiser.tracking is None
    assert [event.kind for event in log.take_events()].count(EventKind.CLOCK_STEP) == 1


@pytest.mark.parametrize("lost", [[], ["gnss"]])
def test_a_successor_goes_on_at_the_last_state_of_its_predecessor(lost):
    config = machine()
    predecessor, _, buffer = optimised(config, messages())
    state = predecessor.tracking.graph.published.newest
    successor = Optimiser(config, buffer, EventLog("imu"))
    successor.resume(state, lost)
    assert successor.tracking is not None and successor.lost() == lost
    assert successor.health is Health.OPTIMISER_RESET
    successor.receive(receive(buffer, imu(DRIVE, 6.6, 6.6)[0]))
    assert successor.is_due
    newest = successor.update().state
    assert np.linalg.norm(newest.nav.position() - DRIVE.nav((newest.stamp_ns - ns(0.0)) * 1e-9).position()) < 0.3
