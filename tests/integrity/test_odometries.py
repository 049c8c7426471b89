"""Odometries: which jump, slip or fall silent, each by its name, and what they find against GNSS."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, StopAndGo, machine, ns
from rig import Rig, position

from holdfast.events import EventKind, Outcome
from holdfast.graph.odometry_track import believed_calibration
from holdfast.sensors.odometry import TrackPose

DRIVE = Drive(start_s=-3.0)
CAMERA = {"camera": {"kind": "odometry", "frame": "lidar"}}
AHEAD = np.array([1.0, 0.5, 0.0])


def begun(end_s=12.0, more=None, **config):
    return Rig(DRIVE, machine(more=more, **config), end_s)


def pose(t, sensor="lidar", off=(0.0, 0.0, 0.0)):
    moved = gtsam.Pose3(gtsam.Rot3(), np.asarray(off))
    return TrackPose(ns(t), sensor, moved * DRIVE.pose(0.0).between(DRIVE.pose(t)))


def receive(rig, measured):
    outcome = rig.odometries.add(rig.graph, measured, measured.stamp_ns)
    rig.log.count(measured.sensor, outcome)
    rig.update()
    rig.odometries.review(measured.stamp_ns)
    return outcome


def test_a_jump_is_reported_and_survived():
    rig = begun()
    for t in np.arange(0.1, 2.0, 0.2):
        assert receive(rig, pose(t)) is Outcome.USED
    for t in np.arange(2.1, 4.0, 0.2):
        receive(rig, pose(t, off=AHEAD))
    assert rig.events() == [(EventKind.ODOMETRY_JUMP, "lidar")]
    assert rig.error_m() < 0.02


def test_a_pose_that_begins_a_new_map_begins_a_new_frame_and_is_no_fault_of_the_odometry():
    rig, reasons = begun(), []
    for t in np.arange(0.1, 2.0, 0.2):
        receive(rig, pose(t))
    for k in range(5):  # more often than an odometry may jump without being doubted
        for n, t in enumerate(np.arange(2.1 + k, 3.0 + k, 0.2)):
            measured = replace(pose(t, off=(k + 1) * 0.05 * AHEAD), begins_anew=n == 0)
            assert receive(rig, measured) is Outcome.USED
        reasons += [event.reason for event in rig.log.take_events()]
    assert len(reasons) == 5 and all("begins a new map" in reason and "trebled" not in reason for reason in reasons)
    assert rig.error_m() < 0.02


def test_an_odometry_that_jumps_four_times_in_twenty_seconds_is_trusted_less():
    rig, reasons = begun(), []
    for k, t in enumerate(np.arange(0.1, 2.0, 0.2)):
        receive(rig, pose(t, off=min(k, 6) % 2 * 3.0 * AHEAD))
        reasons += [event.reason for event in rig.log.take_events()]
    # the count begins anew then
    assert ["trebled" in reason for reason in reasons] == [False, False, False, True, False, False]


def test_an_odometry_that_falls_silent_is_lost_by_its_name_and_regained_with_its_next_pose():
    rig = begun(more=CAMERA)
    receive(rig, pose(0.1, "camera"))
    for t in np.arange(0.2, 2.6, 0.2):
        receive(rig, pose(t))
    assert rig.odometries.lost() == ["camera"]
    assert rig.events() == [(EventKind.SENSOR_LOST, "camera")]
    receive(rig, pose(2.7, "camera"))
    assert rig.odometries.lost() == []
    assert rig.events() == [(EventKind.SENSOR_REGAINED, "camera")]


def test_an_odometry_whose_poses_are_late_or_rare_is_not_silent():
    rig = begun(end_s=20.0, more=CAMERA)
    for t in np.arange(0.1, 9.0, 0.2):
        rig.odometries.add(rig.graph, pose(t), ns(t + 1.5))
        if round(t * 10) % 20 == 1:  # every two seconds
            rig.odometries.add(rig.graph, pose(t, "camera"), ns(t + 1.5))
        rig.update()
        rig.odometries.review(ns(t + 1.5))
    assert rig.odometries.lost() == [] and rig.events() == []


def test_an_odometry_that_never_measured_is_not_lost():
    rig = begun(more=CAMERA)
    rig.odometries.review(ns(1000.0))
    assert rig.odometries.lost() == [] and len(rig.odometries) == 2


# --- against GNSS -----------------------------------------------------------------------------------------------------

QUIET_S, END_S = 42.0, 60.0


def walk_of(rig, sees, slips=None, end_s=END_S):
    """Follow GNSS with an error that depends on time; return the walk that is found first, and when.

    Each odometry sees the true motion, but for an error in its `slips`.
    """
    slips = slips or {"lidar": nothing}
    for t in np.arange(0.2, end_s, 0.2):
        fix = position(DRIVE, t, ARM, sees(t))
        main = rig.graph.main
        main.enter(fix, rig.sensors["gnss"].factor([main.node(fix.stamp_ns)], fix, 1.0))
        for name, slip in slips.items():
            rig.odometries.add(rig.graph, pose(t, name, slip(t)), ns(t))
        rig.update()
        found = rig.odometries.find_walk(rig.graph, ns(t))
        if found is not None:
            return found, t
    return None, end_s


def walking(t):
    return np.array([0.0, 0.0, 0.2]) * max(0.0, t - QUIET_S)


def nothing(t):
    return np.zeros(3)


LOOSE = {"imu_": {"accelerometer_noise_density": 0.3}, "lidar_": {"jump_sigma": 1000.0}}


@pytest.fixture(scope="module")
def found():
    return walk_of(begun(END_S + 0.1, **LOOSE), walking)


def test_fixes_that_walk_away_are_found_by_the_odometry(found):
    walk, t = found
    assert walk is not None and walk.odometry == "lidar"
    assert QUIET_S < t < QUIET_S + 8.0
    assert not walk.found.is_slip and 0.1 < walk.found.distance_m < 1.6


def test_honest_fixes_are_not_accused():
    assert walk_of(begun(END_S + 0.1, **LOOSE), nothing) == (None, END_S)


def test_an_odometry_that_loses_its_hold_has_slipped_and_gnss_is_not_accused():
    rig = begun(END_S + 0.1, **LOOSE)
    at_once = {"lidar": lambda t: np.array([0.0, 0.0, 2.0]) * (t > QUIET_S)}
    assert walk_of(rig, nothing, at_once) == (None, END_S)
    assert (EventKind.ODOMETRY_SLIP, "lidar") in rig.events()


@pytest.mark.parametrize(("fixes_say", "has_slipped"), [(None, False), (False, True)])
def test_whether_it_has_turned_or_the_gyroscope_lies_only_fixes_tell(fixes_say, has_slipped):
    rig = begun(END_S + 0.1, **LOOSE)
    rig.odometries._fixes = lambda *_: fixes_say
    turned = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([0.0, 0.0, 2.0]))
    for t in np.arange(0.2, END_S, 0.2):
        fix, main, seen = position(DRIVE, t, ARM, np.zeros(3)), rig.graph.main, pose(t)
        if t > QUIET_S:
            seen = replace(seen, T_I0_I=turned * seen.T_I0_I)
        main.enter(fix, rig.sensors["gnss"].factor([main.node(fix.stamp_ns)], fix, 1.0))
        rig.odometries.add(rig.graph, seen, ns(t))
        rig.update()
        rig.odometries.find_walk(rig.graph, ns(t))
    assert ((EventKind.ODOMETRY_SLIP, "lidar") in rig.events()) == has_slipped


@pytest.mark.parametrize(("fixes_say", "is_lost"), [(None, False), (True, False), (False, True)])
def test_whether_it_stands_or_the_imu_runs_away_only_fixes_tell(fixes_say, is_lost):
    rig, asked_s = begun(), set()
    rig.odometries._fixes = lambda _, since_ns: (asked_s.add(since_ns), fixes_say)[1]
    for t in np.arange(0.1, 5.0, 0.2):
        receive(rig, replace(pose(min(t, 2.0 + 1e-6 * t)), stamp_ns=ns(t)))  # the same would be stuck
    assert (rig.odometries.distrusted == {"lidar"}) == is_lost
    assert len(asked_s) == 1  # since the first of the motions that the IMU contradicts


def test_where_another_odometry_agrees_with_gnss_it_is_the_odometry_that_slipped():
    """As slow as fixes walk: one odometry alone could not tell. The other must be known for almost a minute."""
    rig = begun(75.1, CAMERA, **LOOSE)
    slow = {"lidar": nothing, "camera": lambda t: np.array([0.0, 0.0, 0.2]) * max(0.0, t - 62.0)}
    assert walk_of(rig, nothing, slow, 75.0) == (None, 75.0)
    slipped = {sensor for kind, sensor in rig.events() if kind is EventKind.ODOMETRY_SLIP}
    assert slipped == {"camera"}


def test_without_the_monitor_no_walk_is_looked_for():
    rig = begun(END_S + 0.1, gate={"drift_monitor": False}, **LOOSE)
    assert walk_of(rig, walking) == (None, END_S)


@pytest.mark.parametrize("early_s", [0.2, -0.2])
def test_the_clock_of_one_that_is_not_trusted_is_found_and_then_it_is_trusted(early_s):
    """It turns 0.2 rad/s otherwise than the gyroscope while the machine sets off; only its clock is wrong."""
    rig = Rig(StopAndGo(start_s=-3.0), machine(), 20.0)
    rig.odometries.distrust(["lidar"])
    for t in np.arange(0.5, 19.0, 0.1):
        track = rig.motion.pose(0.0).between(rig.motion.pose(t))
        measured = rig.odometries.dated(TrackPose(ns(t - early_s), "lidar", track))
        if round(t * 10) % 10 == 0:
            rig.positions.add(rig.graph, position(rig.motion, t, ARM), ns(t))
        rig.odometries.add(rig.graph, measured, ns(t))
        rig.update()
    told = [event.kind for event in rig.log.take_events() if event.sensor == "lidar"]
    assert set(told[:-1]) == {EventKind.CLOCK_STEP} and told[-1] is EventKind.SENSOR_REGAINED  # nearer at each step
    calibration = rig.odometries._odometries["lidar"].model.calibration
    assert believed_calibration(rig.graph.main, "lidar", calibration)[-1] == pytest.approx(early_s, abs=0.02)


def test_one_whose_track_has_broken_has_not_held_the_estimate_across_that():
    rig = begun()
    for t in np.arange(0.1, 4.0, 0.2):
        receive(rig, pose(t, off=AHEAD if t > 2.0 else np.zeros(3)))
    assert rig.odometries.has_held(ns(2.5))
    assert not rig.odometries.has_held(ns(2.0))
    rig.odometries.distrust(["lidar"])
    assert not rig.odometries.has_held(ns(2.5))
