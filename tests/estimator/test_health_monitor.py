"""Health in one word, in the order in which one hides another, and what is being fused."""

import pytest
from motion import at, machine

from holdfast.estimator.health import HealthMonitor
from holdfast.events import Health

SECOND_NS = 1_000_000_000
CONFIG = machine(right=True, more={"wheels": {"kind": "twist", "mount": at([0.0, 0.0, 0.0])}})


def s(seconds):
    return round(seconds * SECOND_NS)


def started(now_s=100.0):
    """A monitor to which everything came just now."""
    monitor = HealthMonitor(CONFIG)
    monitor.start(s(0.0))
    for name in monitor.names:
        monitor.entered(name, s(now_s))
    return monitor


def assess(monitor, now_s=100.0, has_imu=True, is_lost=False, lost=()):
    return monitor.assess(s(now_s), has_imu=has_imu, is_lost=is_lost, lost=lost)


def test_before_the_start_it_initialises_and_again_after_a_stop():
    monitor = HealthMonitor(CONFIG)
    assert assess(monitor) is Health.INITIALISING
    monitor.start(s(99.9))
    assert assess(monitor) is Health.NOMINAL
    monitor.stop()
    assert assess(monitor) is Health.INITIALISING


@pytest.mark.parametrize(
    ("truth", "health"),
    [
        ({}, Health.NOMINAL),
        ({"has_imu": False}, Health.IMU_GAP),
        ({"is_lost": True, "lost": ["gnss", "gnss_right"]}, Health.FALLBACK),
        ({"lost": ["gnss_right"]}, Health.GNSS_DEGRADED),
        ({"lost": ["wheels"]}, Health.SENSOR_LOST),
        ({"lost": ["wheels", "gnss"]}, Health.GNSS_DEGRADED),
        ({"has_imu": False, "is_lost": True}, Health.IMU_GAP),
    ],
)
def test_each_loss_has_its_word_and_the_worse_one_hides_the_other(truth, health):
    assert assess(started(), **truth) is health


def test_a_reset_is_reported_for_a_second_and_a_recovery_for_two():
    monitor = started()
    monitor.recovered(s(99.5))
    assert assess(monitor) is Health.RECOVERING
    monitor.reset(s(99.5))
    assert assess(monitor) is Health.OPTIMISER_RESET
    assert assess(monitor, 100.6) is Health.RECOVERING
    assert assess(monitor, 101.6) is Health.NOMINAL


def test_an_odometry_is_lost_after_two_of_its_longest_intervals_also_if_it_never_came():
    monitor = started()
    assert assess(monitor, 102.0) is Health.NOMINAL
    assert assess(monitor, 102.1, lost=["lidar"]) is Health.ODOMETRY_LOST
    assert assess(monitor, 102.1) is Health.NOMINAL  # a slow one is not lost yet
    fresh = HealthMonitor(CONFIG)
    fresh.start(s(0.0))
    assert assess(fresh, 2.1) is Health.ODOMETRY_LOST


def test_the_report_has_what_entered_in_the_last_second_and_how_old_it_is():
    monitor = started()
    monitor.entered("gnss", s(101.5))
    monitor.entered("gnss", s(101.0))  # late: it is not older for that
    report = monitor.report(s(102.0), Health.NOMINAL)
    assert report.fused == ("imu", "gnss")
    assert report.ages_s["gnss"] == pytest.approx(0.5) and report.ages_s["wheels"] == pytest.approx(2.0)
    assert HealthMonitor(CONFIG).report(s(1.0), Health.INITIALISING).fused == ("imu",)


def test_another_monitor_knows_what_a_snapshot_tells():
    monitor, other = started(), HealthMonitor(CONFIG)
    monitor.recovered(s(99.5))
    other.restore(monitor.snapshot())
    assert other.report(s(101.0), Health.NOMINAL) == monitor.report(s(101.0), Health.NOMINAL)
    assert assess(other) is Health.RECOVERING
    other.restore(HealthMonitor(CONFIG).snapshot())
    assert assess(other) is Health.INITIALISING and other.report(s(101.0), Health.NOMINAL).ages_s == {}


def test_lever_arms_in_doubt_are_said_until_it_starts_without_the_doubt_and_another_monitor_knows():
    monitor, other = started(), HealthMonitor(CONFIG)
    monitor.start(s(99.9), doubts_arms=True)
    other.restore(monitor.snapshot())
    for one in (monitor, other):
        assert assess(one, lost=["wheels"]) is Health.LEVER_ARM
        assert assess(one, lost=["gnss_right"]) is Health.GNSS_DEGRADED
    monitor.start(s(99.9))
    assert assess(monitor) is Health.NOMINAL
