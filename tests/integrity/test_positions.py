"""Positions on their way into the main graph: judged, weighed, taken out again, counted."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM, ARM_RIGHT, Drive, at, machine, ns
from rig import Rig, position

from holdfast.events import EventKind, Outcome
from holdfast.integrity.receiver import Trust
from holdfast.sensors.noise import Colour

DRIVE = Drive(start_s=-3.0)


def begun(until_s=3.0, **config):
    """A drive with ten good positions a second."""
    rig = Rig(DRIVE, machine(lidar=False, **config), 12.0)
    for t in np.arange(0.1, until_s, 0.1):
        assert receive(rig, position(DRIVE, t, ARM)) is Outcome.USED
    return rig


def receive(rig, measured):
    """Take a position in as `Tracking` does."""
    outcome = rig.positions.add(rig.graph, measured, measured.stamp_ns)
    rig.log.count(measured.sensor, outcome)
    rig.update()
    rig.positions.review(rig.graph.main)
    return outcome


def test_a_good_position_enters_and_is_remembered_while_the_window_holds_it():
    rig = begun(5.0)
    assert rig.error_m() < 0.01
    assert 25 <= len(rig.positions.used) <= 32  # 3 s at 10 Hz
    assert rig.events() == []


def test_a_position_that_contradicts_the_estimate_is_refused_reported_and_changes_nothing():
    rig, other = begun(), begun()
    wrong = position(DRIVE, 3.0, ARM, (1.0, 0.0, 0.0))
    assert receive(rig, wrong) is Outcome.INNOVATION
    assert rig.events() == [(EventKind.REJECTED, "gnss")]
    other.graph.main.node(wrong.stamp_ns)
    other.update()
    np.testing.assert_allclose(rig.graph.main.newest.nav.position(), other.graph.main.newest.nav.position(), atol=1e-6)


def test_a_position_that_left_the_window_is_late():
    rig = begun(6.0)
    assert receive(rig, position(DRIVE, 0.5, ARM)) is Outcome.LATE


def test_correlated_positions_weigh_less_the_closer_they_are():
    sigmas = {}
    for correlation_s in (0.0, 10.0):
        rig = Rig(DRIVE, machine(lidar=False), 12.0)
        for t in np.arange(0.1, 3.0, 0.1):
            measured = position(DRIVE, t, ARM)
            receive(rig, type(measured)(measured.stamp_ns, "gnss", measured.p_W_P, measured.covariance, correlation_s))
        sigmas[correlation_s] = np.sqrt(np.trace(rig.graph.main.newest.covariance[3:6, 3:6]))
    assert sigmas[10.0] > 1.3 * sigmas[0.0]


def test_many_fixes_with_a_slow_error_never_say_more_than_the_slow_error_allows():
    rig = Rig(DRIVE, machine(lidar=False, gnss_={"correlation_s": 0.25}), 12.0)
    colour = Colour(0.5, 0.5, 60.0)
    for t in np.arange(0.05, 6.0, 0.05):
        measured = replace(position(DRIVE, t, ARM), colour=colour)
        assert receive(rig, measured) is Outcome.USED
    newest = rig.graph.main.newest
    R = newest.nav.attitude().matrix()
    sigmas = np.sqrt((R @ newest.covariance[3:6, 3:6] @ R.T).diagonal())
    slow_m, start_m = 0.01 * np.sqrt(0.5), 0.01
    assert sigmas.min() > 0.9 / np.hypot(1.0 / slow_m, 1.0 / start_m)  # of the start and of the slow error
    assert sigmas.max() < 1.2 * slow_m


def test_one_that_its_successors_contradict_is_taken_out_again_and_recounted():
    """Five sigma off is within twice the gate: it enters with less weight, and is found out later."""
    rig = begun()
    assert receive(rig, position(DRIVE, 3.0, ARM, (0.0, 0.0, 0.06))) is Outcome.USED
    for t in np.arange(3.1, 4.0, 0.1):
        receive(rig, position(DRIVE, t, ARM))
    assert rig.log.counts["gnss", Outcome.CONTRADICTED] == 1
    assert rig.log.counts["gnss", Outcome.USED] == len(np.arange(0.1, 3.0, 0.1)) + 9
    assert rig.events() == [(EventKind.REJECTED, "gnss")]
    assert ns(3.0) not in {one.stamp_ns for one in rig.positions.used.of()}


def test_one_that_is_taken_out_leaves_the_estimate_as_it_was_without_it():
    rig, other = begun(), begun()
    wrong = position(DRIVE, 3.0, ARM, (0.0, 0.0, 0.06))
    receive(rig, wrong)
    other.graph.main.node(wrong.stamp_ns)
    other.update()
    expected = other.graph.main.newest.nav.position()
    assert np.linalg.norm(rig.graph.main.newest.nav.position() - expected) > 2e-3
    (entered,) = rig.positions.used.of("gnss", wrong.stamp_ns)  # weighed, so no longer the same object
    rig.positions.take_out(rig.graph.main, entered, Outcome.CONTRADICTED)
    rig.update()
    assert np.linalg.norm(rig.graph.main.newest.nav.position() - expected) < 5e-4


def test_what_a_receiver_itself_reports_as_bad_counts_towards_its_loss_and_a_bad_stamp_does_not():
    for outcome, is_lost in ((Outcome.LARGE_COVARIANCE, True), (Outcome.DUPLICATE, False)):
        rig = begun()
        for _ in range(5):
            rig.positions.refuse("gnss", outcome)
        rig.positions.lose_due(rig.graph.main, ns(3.0))
        assert (rig.positions.lost() == ["gnss"]) == is_lost
        assert rig.positions.is_trusted != is_lost


def test_a_receiver_that_proves_faulty_loses_its_recent_positions_too():
    rig = begun()
    for t in np.arange(3.0, 3.5, 0.1):
        receive(rig, position(DRIVE, t, ARM, (1.0, 0.0, 0.0)))
    rig.positions.lose_due(rig.graph.main, ns(3.4))
    assert (EventKind.RECEIVER_LOST, "gnss") in rig.events()
    assert rig.log.counts["gnss", Outcome.QUARANTINED] == 11  # from 1.9 to 2.9 s: a second and a half before the loss
    assert {one.stamp_ns for one in rig.positions.used.of()} <= {ns(t) for t in np.arange(0.1, 1.85, 0.1)}


def test_a_receiver_that_falls_silent_keeps_them():
    rig = begun()
    before = len(rig.positions.used)
    rig.positions.lose_due(rig.graph.main, ns(4.5))
    (event,) = rig.log.take_events()
    assert (event.kind, event.reason.split(";")[0]) == (EventKind.RECEIVER_LOST, "silent")
    assert len(rig.positions.used) == before


def test_a_lost_receiver_waits_and_what_waited_enters_at_one_weight_each():
    rig = begun()
    rig.positions.distrust(["gnss"])
    for t in np.arange(3.0, 3.5, 0.1):
        assert receive(rig, position(DRIVE, t, ARM)) is Outcome.QUARANTINED
    held = rig.positions.gates["gnss"].become(Trust.TRUSTED)
    before = np.trace(rig.graph.main.newest.covariance[3:6, 3:6])
    assert len(rig.positions.enter_held(rig.graph.main, held, is_trial=False)) == 5
    rig.update()
    assert np.trace(rig.graph.main.newest.covariance[3:6, 3:6]) < 0.5 * before


def test_what_enters_a_trial_weighs_as_if_nothing_had_entered_before():
    """The window of a trial has lost what the main graph used just before."""
    sigmas = {}
    for is_trial in (False, True):
        rig = begun()
        rig.positions.distrust(["gnss"])
        one = position(DRIVE, 3.0, ARM)
        receive(rig, type(one)(one.stamp_ns, "gnss", one.p_W_P, one.covariance, 10.0))
        held = rig.positions.gates["gnss"].become(Trust.TRUSTED)
        rig.positions.enter_held(rig.graph.main, held, is_trial=is_trial)
        rig.update()
        sigmas[is_trial] = np.sqrt(np.trace(rig.graph.main.newest.covariance[3:6, 3:6]))
    assert sigmas[True] < 0.95 * sigmas[False]


def test_the_worse_of_two_antennas_is_refused_also_if_it_came_first():
    rig = begun(right=True, gate={"innovation": False})
    apart = DRIVE.nav(3.0).attitude().rotate(0.1 * (ARM_RIGHT - ARM))
    wrong = position(DRIVE, 3.0, ARM_RIGHT, apart, "gnss_right")
    assert receive(rig, wrong) is Outcome.USED  # nothing to compare it with yet
    assert receive(rig, position(DRIVE, 3.0, ARM)) is Outcome.USED
    assert rig.log.counts["gnss_right", Outcome.BASELINE] == 1
    assert rig.log.counts["gnss_right", Outcome.USED] == 0
    assert wrong not in rig.positions.used.of("gnss_right")


def test_after_a_lost_window_no_position_of_before_is_known():
    rig = begun()
    rig.positions.forget_window()
    assert len(rig.positions.used) == 0
    assert receive(rig, position(DRIVE, 3.0, ARM)) is Outcome.USED


@pytest.mark.parametrize("names", [[], ["gnss"], ["gnss", "gnss_right"]])
def test_gnss_is_trusted_as_long_as_one_receiver_is(names):
    rig = begun(right=True)
    rig.positions.distrust(names)
    assert rig.positions.lost() == names
    assert rig.positions.is_trusted == (len(names) < 2)


def test_a_prism_that_has_never_agreed_with_gnss_is_not_believed_without_it():
    """Antennas that come late had not measured when it was lost; when they fell silent, it led 100 m away."""
    prism = {"kind": "prism", "mount": at(ARM)}
    rig = Rig(DRIVE, machine(lidar=False, more={"prism": prism}), 15.0)
    for t in np.arange(0.1, 12.0, 0.1):
        assert receive(rig, position(DRIVE, t, ARM, (100.0, 0.0, 0.0), sensor="prism")) is Outcome.INNOVATION
        if 0.95 < t < 3.0:
            receive(rig, position(DRIVE, t, ARM))
        rig.recovery.review(rig.graph, ns(t))
        assert rig.positions.misplaced == (frozenset() if t < 0.95 else {"prism"})
    kinds = {kind for kind, _ in rig.events()}
    assert EventKind.GNSS_LOST in kinds
    assert EventKind.ESTIMATE_SUSPECT not in kinds


def test_an_estimate_that_has_drifted_does_not_vouch_for_a_prism_that_was_never_used():
    """Positions that waited counted as agreement: where the estimate had drifted to, the prism would have led."""
    rig = Rig(DRIVE, machine(lidar=False, more={"prism": {"kind": "prism", "mount": at(ARM)}}), 15.0)
    for t in np.arange(0.1, 6.0, 0.1):
        receive(rig, position(DRIVE, t, ARM, (100.0, 0.0, 0.0), sensor="prism"))
        if 0.95 < t < 3.0:
            receive(rig, position(DRIVE, t, ARM))
        rig.recovery.review(rig.graph, ns(t))
    assert receive(rig, position(DRIVE, 6.0, ARM, sensor="prism")) is Outcome.QUARANTINED
    assert rig.positions.misplaced == {"prism"}


def test_a_prism_that_is_as_expected_once_has_not_agreed_with_gnss():
    """Beside fixes of a metre one that is elsewhere is so now and then: it was believed when they fell silent."""
    rig = Rig(DRIVE, machine(lidar=False, more={"prism": {"kind": "prism", "mount": at(ARM)}}), 15.0)
    for t in np.arange(0.1, 3.0, 0.1):
        receive(rig, position(DRIVE, t, ARM))
        off_m = 0.0 if 2.05 < t < 2.15 else 1.0
        outcome = receive(rig, position(DRIVE, t, ARM, (off_m, 0.0, 0.0), sensor="prism"))
        assert outcome is (Outcome.INNOVATION if off_m else Outcome.QUARANTINED)
        rig.recovery.review(rig.graph, ns(t))
    assert rig.positions.misplaced == {"prism"}
