"""Two graphs: one as long as they are identical, a fallback while GNSS is lost, a trial at its recovery."""

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, apart, machine, ns
from rig import Rig, position

from holdfast.events import Outcome
from holdfast.sensors.odometry import TrackPose

DRIVE = Drive(start_s=-3.0)
PAPER = {"main_odometry": "relative", "fallback_odometry": "frozen"}


def begun(end_s=8.0, **graph):
    rig = Rig(DRIVE, machine(graph=graph), end_s)
    for t in np.arange(0.1, 4.0, 0.1):
        drive_on(rig, t)
    return rig


def drive_on(rig, t, sees=True):
    """One step with a fix that enters the main graph, and a pose."""
    main = rig.graph.main
    if sees:
        fix = position(DRIVE, t, ARM)
        main.enter(fix, rig.sensors["gnss"].factor([main.node(fix.stamp_ns)], fix, 1.0))
    outcome = rig.graph.add_pose(TrackPose(ns(t), "lidar", DRIVE.pose(0.1).between(DRIVE.pose(t))))
    rig.update()
    return outcome


def test_without_a_difference_there_is_one_graph_also_while_gnss_is_lost():
    rig = begun()
    rig.graph.lose()
    assert rig.graph.is_lost
    assert rig.graph.published is rig.graph.main
    assert list(rig.graph.smoothers()) == [rig.graph.main]


@pytest.mark.parametrize("graph", [PAPER, {"fallback_odometry": "frozen"}])
def test_at_a_loss_both_are_identical_and_go_their_own_ways_after_it(graph):
    rig = begun(**graph)
    assert rig.graph.published is rig.graph.main
    rig.graph.lose()
    main, fallback = rig.graph.smoothers()
    assert fallback is rig.graph.published and main is rig.graph.main and main is not fallback
    assert max(apart(main.newest.nav, fallback.newest.nav)) < 1e-9
    for t in np.arange(4.1, 8.0, 0.1):
        drive_on(rig, t, sees=False)
    assert 1e-6 < apart(main.newest.nav, fallback.newest.nav)[0] < 0.05


def test_one_graph_serves_both_if_the_configuration_asks_for_one():
    rig = begun(dual=False, **PAPER)
    rig.graph.lose()
    assert rig.graph.published is rig.graph.main


@pytest.mark.parametrize("graph", [{}, PAPER])
def test_a_trial_that_is_not_adopted_was_seen_by_nobody(graph):
    rig = begun(**graph)
    rig.graph.lose()
    before = rig.graph.published.newest
    trial = rig.graph.trial()
    wrong = position(DRIVE, 4.1, ARM, (1.0, 0.0, 0.0))
    trial.enter(wrong, rig.sensors["gnss"].factor([trial.node(wrong.stamp_ns)], wrong, 1.0))
    trial.optimise()
    assert rig.graph.published.newest is before
    drive_on(rig, 4.1, sees=False)
    assert rig.error_m() < 0.02 < apart(trial.newest.nav, DRIVE.nav(4.1))[0]


@pytest.mark.parametrize("graph", [{}, PAPER])
def test_a_trial_that_is_adopted_is_main_and_published_and_the_fallback_is_given_up(graph):
    rig = begun(**graph)
    rig.graph.lose()
    trial = rig.graph.trial()
    rig.graph.adopt(trial)
    assert rig.graph.main is rig.graph.published is trial
    assert not rig.graph.is_lost
    assert drive_on(rig, 4.1) == (Outcome.USED, None)
    assert rig.error_m() < 0.02


def test_a_pose_joins_both_graphs_and_is_late_where_it_left_the_window():
    rig = begun(**PAPER)
    rig.graph.lose()
    assert drive_on(rig, 4.1, sees=False).outcome is Outcome.USED
    assert rig.graph.newest_pose("lidar").stamp_ns == ns(4.1)
    assert all(smoother.newest_ns == ns(4.1) for smoother in rig.graph.smoothers())
    assert rig.graph.add_pose(TrackPose(ns(0.3), "lidar", gtsam.Pose3())).outcome is Outcome.LATE


@pytest.mark.parametrize("graph", [{}, PAPER])
def test_moved_it_begins_anew_as_one_graph_at_the_published_state(graph):
    rig = begun(**graph)
    rig.graph.lose()
    drive_on(rig, 4.1, sees=False)
    published = rig.graph.published.newest
    correction = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 5.0]))
    rig.graph.move(correction, 1.0)
    assert rig.graph.published is rig.graph.main and not rig.graph.is_lost
    assert rig.graph.published.newest.nav.pose().equals(correction * published.nav.pose(), 1e-9)
    assert rig.graph.newest_pose("lidar") is None


def test_the_track_of_one_odometry_may_begin_anew_alone():
    rig = Rig(DRIVE, machine(more={"camera": {"kind": "odometry", "frame": "lidar"}}), 3.0)
    for name in ("lidar", "camera"):
        rig.graph.add_pose(TrackPose(ns(0.5), name, gtsam.Pose3()))
    rig.graph.begin_tracks_anew("camera", within=rig.graph.main)
    assert rig.graph.newest_pose("camera") is None
    assert rig.graph.newest_pose("lidar").stamp_ns == ns(0.5)
