"""Tracks of odometries beside the graphs: in which shape positions have moved."""

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, at, ns
from rig import position

from holdfast.config.sensors import OdometryConfig
from holdfast.estimator.initialisation import TIMES_NEARER
from holdfast.estimator.odometry_tracks import OdometryTracks
from holdfast.sensors.odometry import OdometryModel, TrackPose

DRIVE = Drive(start_s=-5.0, radius_m=30.0, speed=0.1)  # 3 m/s
ELSEWHERE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 2.0), np.array([700.0, -80.0, 20.0]))


def tracks(scale=1.0, until_s=20.0):
    found = OdometryTracks(
        {"lidar": OdometryModel("lidar", OdometryConfig(kind="odometry", topic="/l"), at([0, 0, 0]))}
    )
    for t in np.arange(0.0, until_s, 0.1):
        pose = DRIVE.pose(t)
        found.add(TrackPose(ns(t), "lidar", ELSEWHERE * gtsam.Pose3(pose.rotation(), scale * pose.translation())))
    return found


def fixes(off_m=lambda _: np.zeros(3), from_s=2.03, until_s=18.0):
    return [position(DRIVE, t, ARM, off_m(t)) for t in np.arange(from_s, until_s)]


def test_an_odometry_that_sees_the_machine_elsewhere_has_moved_in_the_shape_of_the_positions():
    assert tracks().move_as(fixes(), ARM, 0.05)


@pytest.mark.parametrize(
    "off_m",
    [
        lambda t: np.array([0.0, 8.0 * (t > 10.0), 0.0]),  # a jump
        lambda t: np.array([0.0, max(0.0, t - 10.0), 0.0]),  # a walk
    ],
)
def test_one_that_has_not_is_no_witness(off_m):
    """An estimate that is right is left by these 8 m."""
    assert not tracks().move_as(fixes(off_m), ARM, 8.0 / TIMES_NEARER)


def test_one_whose_distances_are_wrong_is_no_witness():
    assert not tracks(scale=1.1).move_as(fixes(), ARM, 0.5)


def test_few_positions_have_no_shape_nor_those_beside_which_it_did_not_measure():
    assert not tracks().move_as(fixes(from_s=2.0, until_s=5.0), ARM, 0.5)
    assert not tracks(until_s=5.0).move_as(fixes(), ARM, 0.5)


def test_what_is_forgotten_says_nothing():
    one = tracks()
    assert one.names == ["lidar"] and len(one.factors([ns(3.0), ns(4.0), ns(5.0)])) == 2
    one.forget("lidar")
    assert one.names == [] and one.factors([ns(3.0), ns(4.0)]) == []
    assert not one.move_as(fixes(), ARM, 0.5)
