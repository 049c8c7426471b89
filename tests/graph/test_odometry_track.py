"""The poses of one odometry in a smoother: anchored, relative or frozen; jumps, gaps and late poses."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import NOT_TURNED, Drive, apart, machine, ns
from rig import SIGMAS, smoother_of, truth

from holdfast.events import Outcome
from holdfast.graph.odometry_track import OdometryTrack
from holdfast.sensors.odometry import OdometryNoise, TrackPose
from holdfast.sensors.registry import sensors_of

DRIVE = Drive(start_s=-3.0)
MODES = ("anchored", "relative", "frozen")
MODEL = sensors_of(machine())["lidar"]
JUMP = gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.5, 0.0]))


def track(mode="anchored"):
    return OdometryTrack(OdometryNoise(MODEL), MODEL.max_interval_ns, mode)


def seen(t, jump=NOT_TURNED):
    """The pose at a time of a perfect odometry that started at 0.1 s, and has jumped perhaps."""
    return TrackPose(ns(t), "lidar", jump * DRIVE.pose(0.1).between(DRIVE.pose(t)))


def add(one, smoother, pose):
    joined = one.add(smoother, smoother.node(pose.stamp_ns), pose)
    smoother.optimise()
    return joined


def drifting(end_s=6.0):
    """A smoother whose velocity is unsure, so that the IMU alone drifts."""
    sigmas = SIGMAS.copy()
    sigmas[6:9] = 0.2
    begun = truth(DRIVE, 0.0, sigmas)
    nav = gtsam.NavState(begun.nav.attitude(), begun.nav.position(), begun.nav.velocity() + np.array([0.2, -0.2, 0.1]))
    return smoother_of(
        DRIVE, end_s, state=type(begun)(begun.stamp_ns, nav, *(begun.bias, begun.covariance, begun.angular_velocity))
    )


@pytest.mark.parametrize("mode", MODES)
def test_poses_hold_the_estimate_on_the_track(mode):
    """0.3 m/s of wrong velocity are 1.2 m after four seconds."""
    smoother, one = drifting(), track(mode)
    outcomes = [add(one, smoother, seen(t)).outcome for t in np.arange(0.1, 4.1, 0.2)]
    assert set(outcomes[1:]) == {Outcome.USED}
    assert apart(smoother.newest.nav, DRIVE.nav(3.9))[0] < 0.15
    assert apart(smoother.newest.nav, DRIVE.nav(3.9))[2] < 0.05


def test_the_first_pose_tells_nothing_and_in_some_modes_cannot_be_used():
    outcomes = {mode: add(track(mode), drifting(), seen(0.1)).outcome for mode in MODES}
    assert outcomes == {"anchored": Outcome.USED, "relative": Outcome.NO_PREDECESSOR, "frozen": Outcome.NO_PREDECESSOR}


@pytest.mark.parametrize("mode", MODES)
def test_a_jump_is_found_by_the_imu_and_begins_a_new_frame(mode):
    smoother, one = smoother_of(DRIVE, 6.0), track(mode)
    for t in np.arange(0.1, 2.0, 0.2):
        add(one, smoother, seen(t))
    joined = add(one, smoother, seen(2.1, JUMP))
    assert joined.jump is not None
    assert all(add(one, smoother, seen(t, JUMP)).jump is None for t in np.arange(2.3, 4.0, 0.2))
    assert apart(smoother.newest.nav, DRIVE.nav(3.9))[0] < 0.02


FAR = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 500.0, 0.0]))
TURNED = gtsam.Pose3(gtsam.Rot3.Yaw(-3.0), np.zeros(3))


@pytest.mark.parametrize("jump", [FAR, TURNED])
@pytest.mark.parametrize("is_silent", [False, True])
@pytest.mark.parametrize("mode", MODES)
def test_a_pose_that_no_machine_can_have_reached_is_refused_whether_the_imu_measures_or_not(mode, is_silent, jump):
    smoother, one = smoother_of(DRIVE, 1.95 if is_silent else 6.0), track(mode)
    for t in np.arange(0.1, 2.0, 0.2):
        add(one, smoother, seen(t))
    joined = add(one, smoother, seen(2.1, jump))
    assert joined.outcome is Outcome.OUT_OF_RANGE
    assert (joined.jump is None) == is_silent
    assert add(one, smoother, seen(2.3, jump)).outcome in (Outcome.USED, Outcome.NO_PREDECESSOR)
    assert apart(smoother.newest.nav, DRIVE.nav(2.3))[0] < 0.02


def test_poses_too_far_apart_are_not_joined_where_each_is_joined_to_the_one_before():
    smoother, one = smoother_of(DRIVE, 6.0), track("relative")
    add(one, smoother, seen(0.1))
    assert add(one, smoother, seen(1.3)).outcome is Outcome.NO_PREDECESSOR
    assert add(one, smoother, seen(1.5)).outcome is Outcome.USED


def test_a_late_pose_is_joined_to_the_frame_that_was_there_then_but_not_across_a_jump():
    smoother, one = smoother_of(DRIVE, 6.0), track()
    for t in (0.1, 0.3, 0.7):
        add(one, smoother, seen(t))
    assert add(one, smoother, seen(0.5)).outcome is Outcome.USED
    add(one, smoother, seen(0.9, JUMP))
    assert add(one, smoother, seen(0.6)).outcome is Outcome.NO_PREDECESSOR
    assert one.newest.stamp_ns == ns(0.9)


def test_a_frozen_track_says_where_the_machine_is_in_w_and_a_new_one_does_not():
    """Its frame is held where it was at the loss; the position sigma no longer grows."""
    sigmas = {}
    for mode in ("frozen", "relative"):
        smoother, one = smoother_of(DRIVE, 12.0), track(mode)
        for t in np.arange(0.1, 11.0, 0.2):
            add(one, smoother, seen(t))
            if mode == "frozen" and t < 0.4:
                one.freeze(smoother)
        sigmas[mode] = np.sqrt(np.trace(smoother.newest.covariance[3:6, 3:6]))
    assert sigmas["frozen"] < 0.05 and sigmas["relative"] > 0.1


def test_a_copy_goes_on_in_its_own_mode_with_a_clone_of_the_smoother():
    smoother, one = smoother_of(DRIVE, 6.0), track("relative")
    for t in np.arange(0.1, 2.0, 0.2):
        add(one, smoother, seen(t))
    clone, other = smoother.clone(), one.copy("frozen")
    other.freeze(clone)
    add(other, clone, seen(2.1))
    assert one.newest.stamp_ns == ns(1.9) and other.newest.stamp_ns == ns(2.1)
    assert add(one, smoother, seen(2.1)).outcome is Outcome.USED


def test_begun_anew_it_knows_no_pose_and_compares_with_none():
    smoother, one = smoother_of(DRIVE, 6.0), track()
    add(one, smoother, seen(0.1))
    fresh = one.begin_anew()
    assert fresh.newest is None and one.newest is not None
    assert add(fresh, smoother, seen(0.3, JUMP)).jump is None


@pytest.mark.parametrize("early_s", [0.3, -0.3])
@pytest.mark.parametrize("mode", MODES)
def test_a_clock_that_becomes_known_is_no_jump(mode, early_s):
    """What was stamped before it was known is at odds with what comes by 0.5 m; a jump after that is found."""
    smoother, one = smoother_of(DRIVE, 6.0), track(mode)

    def stamped(t, jump=NOT_TURNED):
        return TrackPose(ns(t - early_s), "lidar", seen(t, jump).T_I0_I)

    for t in np.arange(0.4, 0.8, 0.2):
        add(one, smoother, stamped(t))
    early_ns = round(early_s * 1e9)
    assert all(add(one, smoother, stamped(t).dated(early_ns)).jump is None for t in np.arange(0.8, 3.0, 0.2))
    assert add(one, smoother, stamped(3.0, JUMP).dated(early_ns)).jump is not None


def test_the_frame_of_an_odometry_drifts_as_configured():
    """10 s of driving, 15 m: without GNSS the position is unsure by 0.04 m per root metre."""
    smoother, one = smoother_of(DRIVE, 12.0), track()
    for t in np.arange(0.1, 10.2, 0.2):
        add(one, smoother, seen(t))
    sigma = np.sqrt(np.trace(smoother.newest.covariance[3:6, 3:6]) / 3.0)
    assert 0.3 < sigma / (0.04 * np.sqrt(15.0)) < 1.5


@pytest.mark.parametrize("mode", MODES)
def test_a_direction_that_the_odometry_claims_not_to_know_is_left_to_the_imu(mode):
    """The poses slide along x of the IMU by 1 m/s, and say so: neither is it a jump, nor does the estimate follow."""
    smoother, one, free = smoother_of(DRIVE, 6.0), track(mode), np.zeros((6, 6))
    free[3, 3] = 0.3**2
    for t in np.arange(0.1, 2.1, 0.2):
        add(one, smoother, seen(t))
    slid, slip = seen(1.9).T_I0_I, gtsam.Pose3(gtsam.Rot3(), np.array([0.2, 0.0, 0.0]))
    for t in np.arange(2.1, 4.1, 0.2):
        slid = slid * DRIVE.pose(t - 0.2).between(DRIVE.pose(t)) * slip
        pose = TrackPose(ns(t), "lidar", slid, free)
        assert add(one, smoother, pose).jump is None
    off = DRIVE.nav(3.9).pose().between(smoother.newest.nav.pose()).translation()
    assert np.linalg.norm(off) < 0.3


@pytest.mark.parametrize("mode", MODES)
def test_a_pose_that_comes_again_while_the_machine_goes_on_says_nothing(mode):
    smoother, one = smoother_of(DRIVE, 8.0), track(mode)
    for t in np.arange(0.1, 2.0, 0.2):
        add(one, smoother, seen(t))
    outcomes = [add(one, smoother, replace(seen(1.9), stamp_ns=ns(t))).outcome for t in np.arange(2.1, 7.0, 0.2)]
    assert set(outcomes) == {Outcome.FROZEN}  # also when the window has left the first of them
    assert apart(smoother.newest.nav, DRIVE.nav(6.9))[0] < 0.1
    goes_on = [add(one, smoother, seen(t)) for t in np.arange(7.1, 7.8, 0.2)]
    assert goes_on[-1].outcome is Outcome.USED and all(each.jump is None for each in goes_on)


def test_one_that_stands_says_so_however_wrong_the_estimate_is():
    """Of wheels that stand every pose is the one before: an IMU that runs away does not accuse them."""
    still = Drive(start_s=100.0)
    smoother, one = drifting(), track()  # it moves, as the IMU says
    outcomes = [add(one, smoother, TrackPose(ns(t), "lidar", still.pose(t))).outcome for t in np.arange(0.1, 4.0, 0.2)]
    assert Outcome.FROZEN not in outcomes


@pytest.mark.parametrize(("speed_m_s", "outcome"), [(1.5, Outcome.USED), (6.0, Outcome.FROZEN)])
def test_while_the_imu_is_silent_a_machine_may_stop_but_not_at_once(speed_m_s, outcome):
    road = Drive(start_s=-6.0, ramp_s=4.0, radius_m=20.0, speed=speed_m_s / 20.0)
    smoother, one = smoother_of(road, 1.95), track()
    poses = [TrackPose(ns(t), "lidar", road.pose(0.1).between(road.pose(t))) for t in np.arange(0.1, 2.0, 0.2)]
    for each in poses:
        add(one, smoother, each)
    assert add(one, smoother, replace(poses[-1], stamp_ns=ns(2.1))).outcome is outcome
