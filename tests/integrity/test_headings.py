"""Headings come from the receiver whose fixes are doubted: while GNSS is lost they wait, and enter with the fixes."""

from dataclasses import replace
from math import atan2

import numpy as np
import pytest
from motion import Drive, machine, ns
from rig import Rig

from holdfast.events import EventKind, Outcome
from holdfast.integrity.turned_headings import TurnedHeadings
from holdfast.sensors.heading import AxisYaw
from holdfast.sensors.noise import Colour

DRIVE = Drive(start_s=-3.0)


def begun(**settings):
    config = machine(lidar=False, heading=True, heading_={"correlation_s": 0.0, **settings})
    return Rig(DRIVE, config, 12.0)


def heading(t, off_rad=0.0, sigma_rad=0.01):
    x, y, _ = DRIVE.nav(t).attitude().rotate(np.array([1.0, 0.0, 0.0]))
    return AxisYaw(ns(t), "heading", atan2(y, x) + off_rad, sigma_rad)


def receive(rig, measured):
    outcome = rig.headings.add(rig.graph, measured, measured.stamp_ns)
    rig.log.count("heading", outcome)
    rig.update()
    rig.headings.review(rig.graph, measured.stamp_ns)
    return outcome


def yaw_sigma_rad(smoother):
    R = smoother.newest.nav.attitude().matrix()
    return np.sqrt((R @ smoother.newest.covariance[:3, :3] @ R.T)[2, 2])


def test_a_heading_enters_while_gnss_is_trusted_and_one_from_the_wrong_side_does_not():
    rig = begun(mounting_sigma_deg=0.0)
    for t in np.arange(0.1, 3.0, 0.1):
        assert receive(rig, heading(t, sigma_rad=0.001)) is Outcome.USED
    assert yaw_sigma_rad(rig.graph.main) < 0.001
    assert receive(rig, heading(3.0, np.pi)) is Outcome.INNOVATION
    assert rig.events() == [(EventKind.REJECTED, "heading")]


def test_a_slow_error_of_headings_is_not_taken_for_the_heading_of_a_machine_that_knew_it():
    """The state at the start is known to 5 mrad: headings that are 5 mrad off for long are believed by half."""
    off_rad, known = {}, {"mounting_sigma_deg": 0.0}
    rigs = {"a state": begun(correlation_s=1.0, **known), "white": begun(**known)}
    for name, rig in rigs.items():
        for t in np.arange(0.05, 4.0, 0.05):
            measured = heading(t, 0.005, sigma_rad=0.007)
            if name == "a state":
                measured = replace(measured, colour=Colour(0.5, 0.5, 60.0))
            assert receive(rig, measured) is Outcome.USED
        attitude, truth = (
            rig.graph.main.newest.nav.attitude(),
            DRIVE.nav((rig.graph.main.newest.stamp_ns - ns(0.0)) * 1e-9).attitude(),
        )
        off_rad[name] = abs(truth.unrotate(attitude.rotate(np.array([1.0, 0.0, 0.0])))[1])
    assert off_rad["white"] > 0.0045
    assert 0.0015 < off_rad["a state"] < 0.0035
    assert 0.003 < yaw_sigma_rad(rigs["a state"].graph.main) < 0.005


def test_so_many_contradictions_lose_a_heading_by_name():
    rig = begun()
    for t in np.arange(0.1, 0.6, 0.1):
        receive(rig, heading(t, 1.0))
    assert rig.headings.lost() == ["heading"]
    assert rig.events()[-1] == (EventKind.SENSOR_LOST, "heading")


def lost(rig, times=()):
    rig.graph.lose()
    for t in times:
        assert receive(rig, heading(t)) is Outcome.QUARANTINED
    return rig


def test_while_gnss_is_lost_headings_wait_and_nothing_is_reviewed():
    rig = lost(begun(), np.arange(0.1, 1.0, 0.1))
    before = yaw_sigma_rad(rig.graph.main)
    receive(rig, heading(1.0, 1.0))
    assert yaw_sigma_rad(rig.graph.main) == pytest.approx(before, rel=0.01)
    assert rig.headings.lost() == [] and rig.events() == []


def test_at_the_recovery_those_since_the_first_fix_enter_the_trial_and_are_recounted():
    rig = lost(begun(), np.arange(0.1, 2.0, 0.1))
    trial = rig.graph.trial()
    before = yaw_sigma_rad(trial)
    assert rig.headings.admit(trial, ns(1.05), ns(2.0))
    trial.optimise()
    assert yaw_sigma_rad(trial) < before
    assert rig.log.counts["heading", Outcome.USED] == 9
    assert rig.log.counts["heading", Outcome.QUARANTINED] == 10  # from before the fixes
    assert not rig.headings.admit(trial, ns(0.0), ns(2.0))  # nothing waits any more


def test_a_heading_that_the_fixes_contradict_stays_out_at_the_recovery():
    rig = lost(begun())
    receive(rig, heading(1.0, 1.0))
    assert not rig.headings.admit(rig.graph.trial(), ns(0.0), ns(1.0))
    assert rig.log.counts["heading", Outcome.INNOVATION] == 1
    assert rig.log.counts["heading", Outcome.QUARANTINED] == 0


def test_a_heading_that_was_held_back_for_long_was_not_silent():
    rig = begun()
    receive(rig, heading(0.1))
    lost(rig, np.arange(0.2, 3.0, 0.1))
    rig.graph.adopt(rig.graph.trial())
    rig.headings.review(rig.graph, ns(3.0))
    assert rig.headings.lost() == [] and rig.events() == []


def test_what_waits_is_forgotten_with_the_window():
    rig = lost(begun(), [0.5])
    rig.headings.forget_window()
    assert not rig.headings.admit(rig.graph.trial(), ns(0.0), ns(1.0))


def test_a_heading_that_left_the_window_is_late():
    rig = begun()
    for t in np.arange(0.1, 6.0, 0.5):
        rig.graph.main.node(ns(t))
        rig.update()
    assert receive(rig, heading(0.5)) is Outcome.LATE


def mount_deg(rig):
    value, _ = rig.graph.main.parameters.estimate("heading mount")
    return float(np.degrees(value[0]))


@pytest.mark.parametrize("off_deg", [40.0, -170.0, 180.0])
def test_headings_that_are_refused_alike_while_the_machine_turns_are_mounted_otherwise_and_come_back(off_deg):
    rig = begun()
    turned = DRIVE.nav(0.0).attitude().between(DRIVE.nav(8.0).attitude()).rpy()[2]
    assert abs(turned) > np.radians(70.0)
    outcomes = [receive(rig, heading(t, np.radians(off_deg))) for t in np.arange(0.1, 12.0, 0.1)]
    assert outcomes[0] is Outcome.INNOVATION and outcomes[-1] is Outcome.USED and rig.headings.lost() == []
    assert [kind for kind, _ in rig.events() if kind is not EventKind.REJECTED] == [
        EventKind.SENSOR_LOST,
        EventKind.SENSOR_REGAINED,
    ]
    assert abs(np.degrees(np.angle(np.exp(1j * np.radians(mount_deg(rig) - off_deg))))) < 1.0


def test_headings_that_are_beside_it_otherwise_at_each_attitude_stay_lost():
    rig = begun()
    for t in np.arange(0.1, 12.0, 0.1):
        true = heading(t)
        receive(rig, replace(true, yaw_rad=np.pi / 2 - true.yaw_rad))  # clockwise from north
    assert rig.headings.lost() == ["heading"]
    assert mount_deg(rig) == pytest.approx(0.0, abs=0.5)
    assert rig.events().count((EventKind.CALIBRATION, "heading")) == 1  # `clockwise` is to be set


def test_a_mounting_that_is_known_is_not_let_go():
    rig = begun(mounting_sigma_deg=0.0)
    outcomes = {receive(rig, heading(t, 1.0)) for t in np.arange(0.1, 12.0, 0.1)}
    assert outcomes == {Outcome.INNOVATION} and rig.graph.main.parameters.estimate("heading mount") is None


def test_one_that_is_as_expected_ends_the_run_as_does_one_that_is_elsewhere():
    run = TurnedHeadings()
    assert [run.note(0.5, 0.01, yaw) for yaw in (0.0, 0.5, 1.0)] == [None, None, None]
    assert run.note(0.5, 0.01, 1.1) == pytest.approx(0.5)
    run.clear()
    assert run.note(0.5, 0.01, 2.2) is None
    assert run.note(0.8, 0.01, 3.0) is None and run.note(0.5, 0.01, 3.5) is None  # begins anew with each
    assert run.note(0.5, 0.01, -2.0) is None  # 45 deg further, across the south
    assert run.note(0.5, 0.01, -1.7) == pytest.approx(0.5)
