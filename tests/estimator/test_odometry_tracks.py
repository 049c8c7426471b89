"""Tracks of odometries beside the graphs: in which shape positions have moved."""

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, at, ns
from rig import position

from holdfast.config.sensors import OdometryConfig
from holdfast.estimator.initialisation import TIMES_NEARER
from holdfast.estimator.odometry_tracks import OdometryTracks
from holdfast.sensors.odometry import LearntNoise, OdometryModel, OdometryNoise, TrackPose

SINCE_NS = ns(12.0)
DRIVE = Drive(start_s=-5.0, radius_m=30.0, speed=0.1)  # 3 m/s
ELSEWHERE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 2.0), np.array([700.0, -80.0, 20.0]))


MODEL = OdometryModel("lidar", OdometryConfig(kind="odometry", topic="/l"), at([0, 0, 0]))


def tracks(scale=1.0, until_s=20.0):
    found = OdometryTracks({"lidar": MODEL})
    for t in np.arange(0.0, until_s, 0.1):
        pose = DRIVE.pose(t)
        found.add(TrackPose(ns(t), "lidar", ELSEWHERE * gtsam.Pose3(pose.rotation(), scale * pose.translation())))
    return found


def fixes(off_m=lambda _: np.zeros(3), from_s=2.03, until_s=18.0):
    return [position(DRIVE, t, ARM, off_m(t)) for t in np.arange(from_s, until_s)]


def test_an_odometry_that_sees_the_machine_elsewhere_has_moved_in_the_shape_of_the_positions():
    assert tracks().move_as(fixes(), ARM, 0.05, SINCE_NS)


@pytest.mark.parametrize(
    "off_m",
    [
        lambda t: np.array([0.0, 8.0 * (t > 10.0), 0.0]),  # a jump
        lambda t: np.array([0.0, max(0.0, t - 10.0), 0.0]),  # a walk
    ],
)
def test_one_that_has_not_is_no_witness(off_m):
    """An estimate that is right is left by these 8 m."""
    assert not tracks().move_as(fixes(off_m), ARM, 8.0 / TIMES_NEARER, SINCE_NS)


def test_one_that_has_not_come_to_where_they_depart_says_nothing():
    """They may have jumped since."""
    assert not tracks(until_s=12.0).move_as(fixes(), ARM, 0.5, SINCE_NS)
    assert tracks(until_s=12.2).move_as(fixes(), ARM, 0.5, SINCE_NS)


def test_one_whose_distances_are_wrong_is_no_witness():
    assert not tracks(scale=1.1).move_as(fixes(), ARM, 0.5, SINCE_NS)


def test_few_positions_have_no_shape_nor_those_beside_which_it_did_not_measure():
    assert not tracks().move_as(fixes(from_s=2.0, until_s=5.0), ARM, 0.5, SINCE_NS)
    assert not tracks(until_s=5.0).move_as(fixes(), ARM, 0.5, SINCE_NS)


def test_motions_weigh_by_what_was_learnt_of_their_noise():
    def errors():
        moved = gtsam.Values()
        for k, t in enumerate((3.0, 6.0)):
            pose = DRIVE.pose(t).compose(gtsam.Pose3(gtsam.Rot3(), [0.1 * k, 0.0, 0.0]))
            moved.insert(gtsam.symbol("x", k), gtsam.NavState(pose, np.zeros(3)))
        return one.factors([ns(3.0), ns(6.0)])[0].error(moved)

    one, noise = tracks(), OdometryNoise(MODEL)
    as_configured = errors()
    noise.learnt = LearntNoise(10.0, 10.0, 10.0, 10.0, 10.0)
    one.weigh_by({"lidar": noise})
    assert errors() == pytest.approx(as_configured / 100.0, rel=1e-3)


def test_fixes_that_are_too_few_say_nothing_of_an_odometry():
    def walking(t):
        return np.array([0.0, max(0.0, 2.0 * (t - 5.0)), 0.0])

    one = tracks()
    assert one.vouched("lidar", fixes(until_s=10.0), ARM, ns(5.0)) is True
    assert one.vouched("lidar", fixes(walking, until_s=10.0), ARM, ns(5.0)) is False
    assert one.vouched("lidar", fixes(until_s=10.0), ARM, ns(8.5)) is None


def test_what_is_forgotten_says_nothing():
    one = tracks()
    assert one.names == ["lidar"] and len(one.factors([ns(3.0), ns(4.0), ns(5.0)])) == 2
    one.forget("lidar")
    assert one.names == [] and one.factors([ns(3.0), ns(4.0)]) == []
    assert not one.move_as(fixes(), ARM, 0.5, SINCE_NS)


def test_what_is_known_of_the_clock_holds_for_the_poses_before_it_was_known():
    """0.4 s at 3 m/s, on a way that is no line: dated by two clocks it is no shape of the machine's."""
    found, early_ns = OdometryTracks({"lidar": MODEL}), 400_000_000
    for t in np.arange(0.0, 20.0, 0.1):
        stamped = TrackPose(ns(t) - early_ns, "lidar", ELSEWHERE * DRIVE.pose(t))
        found.add(stamped.dated(early_ns) if t > 11.0 else stamped)
    assert found.move_as(fixes(), ARM, 0.05, SINCE_NS)
