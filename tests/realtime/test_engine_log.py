"""What both processes reported: counted over all optimisers that there were, events once each."""

import gtsam
import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import Event, EventKind, Outcome
from holdfast.realtime.event_log import EngineLog
from holdfast.realtime.records import pack_nav
from holdfast.realtime.reports import Report

GNSS = ("gnss", Outcome.USED)
LOST = Event(1, EventKind.GNSS_LOST, "", "no receiver is trusted")


def report(events=(), **fields):
    usual = {"counts": {}, "smoothed": (), "took_ns": (), "waiting_for": "", "cpu_s": 0.0}
    return Report(events, **(usual | fields))


def new_log():
    path = EventLog("imu")
    return EngineLog(path), path


def test_counts_are_those_of_the_imu_path_and_of_the_newest_report():
    log, path = new_log()
    path.samples += 5
    log.receive(report(counts={GNSS: 3}))
    log.receive(report(counts={GNSS: 4}))
    assert log.counts == {("imu", Outcome.USED): 5, GNSS: 4}


def test_counts_of_an_optimiser_that_ended_are_kept():
    log, _ = new_log()
    log.receive(report(counts={GNSS: 4}))
    log.receive(None)
    log.receive(report(counts={GNSS: 2}))
    assert log.counts[GNSS] == 6


def test_events_of_both_are_taken_once_and_stay_counted():
    log, path = new_log()
    path.report(EventKind.CLOCK_STEP, 7, "imu", "back")
    log.receive(report([LOST]))
    assert log.event_counts == {EventKind.CLOCK_STEP: 1, EventKind.GNSS_LOST: 1}
    assert [event.kind for event in log.events] == [EventKind.CLOCK_STEP, EventKind.GNSS_LOST]
    assert len(log.take_events()) == 2
    assert log.take_events() == [] and log.events == []
    assert log.event_counts[EventKind.GNSS_LOST] == 1


def test_update_times_and_smoothed_nodes_are_taken_once():
    nav = gtsam.NavState(gtsam.Rot3.Yaw(0.3), np.array([1.0, 2.0, 3.0]), np.zeros(3))
    log, _ = new_log()
    log.receive(report(smoothed=[(5, pack_nav(nav))], took_ns=[10, 20]))
    assert log.take_update_times() == [10, 20] and log.take_update_times() == []
    ((stamp_ns, smoothed),) = log.take_smoothed()
    assert stamp_ns == 5 and (smoothed.matrix() == nav.matrix()).all()
    assert log.take_smoothed() == []


def test_a_fault_is_an_event_that_says_why_and_how_much_went_with_it():
    log, _ = new_log()
    log.receive_fault(9, "died (signal 9)", 12)
    (event,) = log.take_events()
    assert (event.stamp_ns, event.kind) == (9, EventKind.OPTIMISER_FAULT)
    assert event.reason == "the optimiser process died (signal 9); up to 12 measurements are lost with it"
    assert log.last_fault == "the optimiser process died (signal 9)"


def test_the_last_report_of_one_that_fails_leaves_what_it_waited_for():
    log, _ = new_log()
    assert log.waiting_for == "the optimiser process is coming up"
    log.receive(report(waiting_for="no usable position has come", cpu_s=1.5))
    log.receive(report(fault="raised", cpu_s=0.0))
    assert (log.waiting_for, log.optimiser_cpu_s) == ("no usable position has come", 1.5)
