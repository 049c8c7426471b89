"""Loss and recovery of GNSS: fallback, trial, adoption, refusal, and giving in to what has agreed for long."""

import gtsam
import numpy as np
import pytest
from motion import ARM, Drive, machine, ns
from rig import Rig, position

from holdfast.events import EventKind, Outcome
from holdfast.integrity.receiver import Trust
from holdfast.sensors.heading import AxisYaw
from holdfast.sensors.odometry import TrackPose

DRIVE = Drive(start_s=-3.0)
KINDS = {
    EventKind.RECEIVER_LOST,
    EventKind.RECEIVER_REGAINED,
    EventKind.GNSS_LOST,
    EventKind.GNSS_REGAINED,
    EventKind.RECOVERY_REFUSED,
    EventKind.ESTIMATE_SUSPECT,
}


class Machine:
    """Positions ten times a second, reviewed as `Tracking` does."""

    def __init__(self, end_s=20.0, **config):
        self.rig = Rig(DRIVE, machine(**config), end_s)
        self.recovered_s = []

    def drive(self, start_s, end_s, offset=(0.0, 0.0, 0.0), sees=True, odometry=False):
        rig = self.rig
        for t in np.arange(start_s, end_s, 0.1):
            rig.graph.published.node(ns(t))
            if odometry:
                rig.odometries.add(rig.graph, TrackPose(ns(t), "lidar", DRIVE.pose(0.0).between(DRIVE.pose(t))), ns(t))
            if sees:
                rig.log.count("gnss", rig.positions.add(rig.graph, position(DRIVE, t, ARM, offset), ns(t)))
            rig.update()
            if rig.recovery.review(rig.graph, ns(t)):
                self.recovered_s.append(t)
        return self

    def events(self):
        return [event.kind for event in self.rig.log.take_events() if event.kind in KINDS]


def test_silence_of_the_last_receiver_is_the_loss_of_gnss():
    run = Machine(lidar=False).drive(0.1, 3.0)
    assert run.events() == [] and not run.rig.graph.is_lost
    run.drive(3.0, 4.5, sees=False)
    assert run.events() == [EventKind.RECEIVER_LOST, EventKind.GNSS_LOST]
    assert run.rig.graph.is_lost and not run.rig.positions.is_trusted


def test_positions_that_agree_are_adopted_after_a_trial_and_counted():
    run = Machine(lidar=False).drive(0.1, 3.0).drive(3.0, 5.0, sees=False)
    run.events()
    before = run.rig.graph.main
    run.drive(5.0, 6.0)
    assert run.events() == [EventKind.GNSS_REGAINED, EventKind.RECEIVER_REGAINED]
    assert run.rig.graph.main is not before and run.rig.graph.main is run.rig.graph.published
    assert run.recovered_s == [pytest.approx(5.4)]  # five good ones
    assert run.rig.log.counts["gnss", Outcome.QUARANTINED] == 0
    assert run.rig.log.counts["gnss", Outcome.USED] == 29 + 10


def test_nothing_is_tried_in_a_graph_that_has_just_failed():
    """It waits at its last state with nothing in it yet, and cannot be cloned; with the next update it can."""
    run = Machine(lidar=False).drive(0.1, 3.0).drive(3.0, 5.0, sees=False)
    run.events()
    rig = run.rig
    for t in (5.0, 5.1, 5.2, 5.3, 5.4):
        rig.graph.published.node(ns(t))
        rig.positions.add(rig.graph, position(DRIVE, t, ARM), ns(t))
        rig.update()
    rig.graph.main.move(gtsam.Pose3(), 0.0)
    assert not rig.recovery.review(rig.graph, ns(5.4))
    rig.update()
    assert rig.recovery.review(rig.graph, ns(5.4))
    assert run.events() == [EventKind.GNSS_REGAINED, EventKind.RECEIVER_REGAINED]


def refused():
    """After an outage positions zigzag by five sigma: the loose velocity allows it, the IMU does not."""
    run = Machine(lidar=False, imu_={"accelerometer_noise_density": 0.1}).drive(0.1, 3.0).drive(3.0, 7.0, sees=False)
    run.events()
    for k in range(5):
        one = position(DRIVE, 7.0 + 0.1 * k, ARM, (0.05 * (-1) ** k, 0.0, 0.0))
        run.rig.graph.published.node(one.stamp_ns)
        assert run.rig.positions.add(run.rig.graph, one, one.stamp_ns) is Outcome.QUARANTINED
        run.rig.update()
    before = run.rig.graph.published
    assert not run.rig.recovery.review(run.rig.graph, one.stamp_ns)
    assert run.rig.graph.is_lost and run.rig.graph.published is before
    return run


def test_positions_that_a_trial_refuses_are_seen_by_nobody():
    run = refused()
    assert run.events() == [EventKind.RECOVERY_REFUSED]
    assert run.rig.log.counts["gnss", Outcome.USED] == 29


def test_a_refused_receiver_must_be_consistent_for_longer():
    run = refused().drive(7.5, 10.5)
    assert run.recovered_s == [pytest.approx(9.5, abs=0.11)]  # two seconds, instead of five positions


@pytest.mark.parametrize(
    ("after_s", "odometry", "given_in_s"), [(None, False, 1.0), (4.0, False, 4.0), (4.0, True, 4.0)]
)
def test_what_contradicts_the_estimate_and_agrees_with_itself_for_long_is_accepted(after_s, odometry, given_in_s):
    """With and without an odometry as long as configured: without one, the setting was ignored."""
    run = Machine(lidar=odometry, gate={"believe_after_s": after_s}).drive(0.1, 3.0, odometry=odometry)
    run.drive(3.0, 12.0, (0.0, 3.0, 0.0), odometry=odometry)
    assert run.events() == [EventKind.RECEIVER_LOST, EventKind.GNSS_LOST, EventKind.ESTIMATE_SUSPECT]
    # lost after five; they contradict from then on
    assert run.recovered_s == [pytest.approx(3.5 + given_in_s, abs=0.25)]
    newest = run.rig.graph.published.newest
    expected = DRIVE.nav(newest.stamp_ns * 1e-9 - ns(0.0) * 1e-9).position() + np.array([0.0, 3.0, 0.0])
    np.testing.assert_allclose(newest.nav.position(), expected, atol=0.05)


def test_beside_an_odometry_it_takes_half_a_minute_by_default():
    run = Machine(end_s=16.0).drive(0.1, 3.0, odometry=True).drive(3.0, 15.0, (0.0, 3.0, 0.0), odometry=True)
    assert run.events() == [EventKind.RECEIVER_LOST, EventKind.GNSS_LOST]
    assert run.rig.error_m() < 0.5


def test_a_lost_window_is_forgotten_by_all_that_remember_it():
    run = Machine().drive(0.1, 3.0, odometry=True)
    assert len(run.rig.positions.used) > 20
    run.rig.recovery.forget_window()
    assert len(run.rig.positions.used) == 0
    assert run.rig.positions.gates["gnss"].trust is Trust.TRUSTED


def test_headings_that_wait_go_with_the_window():
    run = Machine(lidar=False, heading=True)
    graph = run.rig.graph
    graph.lose()
    run.rig.headings.add(graph, AxisYaw(ns(0.5), "heading", 0.0, 0.01), ns(0.5))
    run.rig.update()
    run.rig.recovery.forget_window()
    assert not run.rig.headings.admit(graph.trial(), ns(0.0), ns(1.0))
    assert run.rig.log.counts["heading", Outcome.INNOVATION] == run.rig.log.counts["heading", Outcome.USED] == 0
