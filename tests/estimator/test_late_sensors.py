"""Sensors that are later than the sliding window is long: it becomes longer, or it is said that they are of no use."""

from dataclasses import replace

import numpy as np
import pytest
from faults import late
from motion import Drive, deviation, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.config.model import GraphConfig
from holdfast.estimator.estimator import Estimator
from holdfast.estimator.window_length import MOST_NS, RECENT, SEVERAL, WindowLength
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Health, Outcome

END_S = 30.0
S = 1_000_000_000


@pytest.fixture
def window():
    return WindowLength(GraphConfig(lag_s=3.0), EventLog("imu"))


def note(window, late_s, sensor="gnss", times=SEVERAL):
    for _ in range(times):
        window.note(sensor, round(late_s * 1e9), 0)
    return window.now_ns * 1e-9


def test_the_window_is_as_long_as_configured_while_nothing_is_late(window):
    assert note(window, 1.0) == 3.0
    assert note(window, 1.4, times=100) == 3.0


def test_it_holds_what_is_late_and_half_of_what_is_configured_before_it(window):
    assert note(window, 4.0) == 5.5
    assert note(window, 2.0, "lidar") == 5.5


def test_a_few_that_are_late_are_an_exception(window):
    note(window, 0.1, times=RECENT)
    assert note(window, 10.0, times=SEVERAL - 1) == 3.0
    assert note(window, 10.0, times=1) == 11.5


def test_it_becomes_shorter_when_none_has_been_late_for_long(window):
    note(window, 4.0)
    assert note(window, 0.1, times=RECENT - SEVERAL) == 5.5
    assert note(window, 0.1) == 3.0


def test_it_never_follows_what_no_window_can_hold(window):
    assert note(window, MOST_NS * 1e-9 + 1.0, times=RECENT) == 3.0
    assert note(window, 4.0) == 5.5


def test_a_window_that_is_configured_longer_holds_more():
    assert note(WindowLength(GraphConfig(lag_s=40.0), EventLog("imu")), 19.0) == 40.0


def test_it_tells_when_it_grows_and_not_each_time():
    log = EventLog("imu")
    window = WindowLength(GraphConfig(lag_s=3.0), log)
    note(window, 4.0, times=10)
    note(window, 4.2, times=10)
    hint = "(if its clock is off, `time_offset_s` sets it right)"
    assert [(one.kind, one.sensor, one.reason) for one in log.take_events()] == [
        (EventKind.LATE, "gnss", f"4.0 s late: the window is 5.5 s long from now on {hint}")
    ]
    note(window, 9.0, "lidar")
    assert [one.reason for one in log.take_events()] == [f"9.0 s late: the window is 10.5 s long from now on {hint}"]


def recorded(hz=5.0):
    rng, drive = np.random.default_rng(3), Drive()
    return drive, imu(drive, 0.0, END_S, 100.0, rng), fixes(drive, 0.0, END_S, hz, rng, phase_s=0.0137)


def errors(drive, outputs, after_s):
    return [deviation(drive, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(after_s)]


@pytest.mark.parametrize("since_s", [0.0, 12.0])
def test_fixes_that_are_later_than_the_window_are_used(since_s):
    """From the start on, and where they become late on the way."""
    drive, samples, antenna = recorded()
    begin, rest = ([one for one in antenna if (one.stamp_ns < ns(since_s)) is early] for early in (True, False))
    estimator, outputs = run(machine(lidar=False), in_order(samples, begin, late(rest, np.full(len(rest), 5.0))))
    used = estimator.counts["gnss", Outcome.USED]
    assert used > 0.6 * len([one for one in antenna if one.stamp_ns < ns(END_S - 5.0)])
    assert estimator.health is Health.NOMINAL
    assert max(errors(drive, outputs, 22.0)) < 1.5  # of which nothing is known but what the IMU makes of 5 s
    assert [one.reason for one in estimator.events if one.kind is EventKind.LATE and "window" in one.reason]


def test_a_late_odometry_is_used():
    drive, samples, antenna = recorded()
    lidar = scans(drive, 0.0, END_S, 5.0, np.random.default_rng(4), phase_s=0.0071)
    estimator, outputs = run(machine(), in_order(samples, antenna, late(lidar, np.full(len(lidar), 4.0))))
    assert estimator.counts["lidar", Outcome.USED] > 80
    assert max(errors(drive, outputs, 15.0)) < 0.3


def test_the_smoothed_trajectory_has_no_hole_where_the_window_becomes_shorter():
    _, samples, antenna = recorded(hz=10.0)
    delays = np.where([one.stamp_ns < ns(10.0) for one in antenna], 6.0, 0.05)
    _, outputs = run(machine(lidar=False), in_order(samples, late(antenna, delays)))
    stamps = np.array([stamp for one in outputs for stamp, _ in one.smoothed])
    assert stamps[0] < ns(14.0) and stamps[-1] > ns(27.0)
    assert np.diff(stamps).max() <= 0.6 * S


def test_fixes_that_no_window_can_hold_leave_no_estimate_that_calls_itself_nominal():
    _, samples, antenna = recorded()
    begin, rest = ([one for one in antenna if (one.stamp_ns < ns(5.0)) is early] for early in (True, False))
    rest = [replace(one, arrival_ns=one.arrival_ns + 24 * S) for one in rest if one.stamp_ns < ns(END_S - 24.0)]
    estimator, _ = run(machine(lidar=False), in_order(samples, begin, rest))
    assert estimator.counts["gnss", Outcome.LATE] > 0
    assert estimator.health is Health.FALLBACK


def test_a_receiver_that_never_says_a_word_after_the_start_is_lost():
    _, samples, antenna = recorded()
    begin = [one for one in antenna if one.stamp_ns < ns(1.1)]  # of which the last one starts it
    estimator, _ = run(machine(lidar=False), in_order(samples, begin))
    assert estimator.health is Health.FALLBACK
    assert [one.reason for one in estimator.events if one.kind is EventKind.RECEIVER_LOST] == ["silent"]


def test_what_was_on_its_way_when_the_estimate_began_does_not_count_against_its_receiver():
    _, samples, antenna = recorded(hz=20.0)
    rest = [one for one in antenna if one.stamp_ns > ns(0.5)]
    begin = [one for one in antenna if one.stamp_ns <= ns(0.5)]
    messages = in_order(samples, begin, late(rest, np.full(len(rest), 1.0)))
    estimator, _ = run(machine(lidar=False), [one for one in messages if one.arrival_ns < ns(8.0)])
    assert estimator.counts["gnss", Outcome.LATE] >= 8
    assert not [one for one in estimator.events if one.kind is EventKind.RECEIVER_LOST]


@pytest.mark.parametrize("has_lidar", [True, False])
def test_fixes_that_are_very_late_wait_for_each_other_where_an_odometry_carries(has_lidar):
    """Where none does, each correction counts: what the IMU alone makes of the time since then grows with its cube."""
    drive, samples, antenna = recorded(hz=10.0)
    lidar = scans(drive, 0.0, END_S, 5.0, np.random.default_rng(4), phase_s=0.0071) if has_lidar else []
    estimator, waiting = Estimator(machine(lidar=has_lidar)), []
    for message in in_order(samples, late(antenna, np.full(len(antenna), 2.0)), lidar):
        estimator.process(message)
        waiting.append(estimator.waiting["gnss"])
    assert estimator.counts["gnss", Outcome.USED] > 0.6 * len(antenna)
    assert max(waiting) == (2 if has_lidar else 1)  # of 10 Hz in a tenth of two seconds
