"""What exists only after the start: each measurement goes to its channel, and its outcome is counted."""

from dataclasses import dataclass

import numpy as np
import pytest
from motion import ARM, Drive, at, fix_at, imu, machine, ns
from rig import G, position, truth

from holdfast.estimator.health import HealthMonitor
from holdfast.estimator.imu_path import receive
from holdfast.estimator.initialisation import Initialising
from holdfast.estimator.successor import Successor
from holdfast.estimator.tracking import Tracking
from holdfast.estimator.window_length import WindowLength
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Health, Outcome
from holdfast.integrity.lever_arms import LeverArms
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.registry import sensors_of

DRIVE = Drive(start_s=-3.0)
NO_SLIP = {"rear": {"kind": "nonholonomic", "topic": None, "mount": at([0.0, 0.0, 0.0]), "sigma_m_s": 10.0}}


@dataclass
class Run:
    """A `Tracking` that has begun at the truth, fed sample by sample."""

    tracking: Tracking
    buffer: ImuBuffer
    log: EventLog
    monitor: HealthMonitor
    t: float = 0.0

    def enqueue(self, measurement, arrival_ns):
        self.tracking.enqueue(measurement, arrival_ns, claimed=measurement)

    def go(self, until_s, measurements=(), skip=lambda _: False):
        """Return the updates until a time; measurements come when their time has been reached."""
        found, waiting = [], list(measurements)
        for sample in imu(DRIVE, self.t, until_s, 100.0)[1:]:
            if skip((sample.stamp_ns - ns(0.0)) * 1e-9):
                continue
            self.tracking.receive(receive(self.buffer, sample))
            while waiting and waiting[0].stamp_ns <= sample.stamp_ns:
                self.enqueue(waiting.pop(0), sample.arrival_ns)
            if self.tracking.is_due:
                found.append(self.tracking.update())
        self.t = until_s
        return found


def begun(**config):
    config = machine(lidar=False, **config)
    buffer, log, monitor = ImuBuffer(config.imu), EventLog("imu"), HealthMonitor(config)
    buffer.add(imu(DRIVE, 0.0, 0.0)[0])
    monitor.start(ns(0.0))
    sensors = sensors_of(config)
    tracking = Tracking(
        config,
        buffer,
        sensors,
        G,
        truth(DRIVE, 0.0),
        scales={name: NoiseScale() for name in sensors},
        lever_arms=LeverArms(sensors),
        successor=Successor(Initialising(config, buffer, sensors, G)),
        window=WindowLength(config.graph, log),
        joint_at=lambda _: None,
        monitor=monitor,
        log=log,
    )
    return Run(tracking, buffer, log, monitor)


def fixes(start_s, end_s):
    return [position(DRIVE, t, ARM) for t in np.arange(start_s, end_s, 0.1)]


def test_without_measurements_a_node_is_made_each_half_second():
    run = begun()
    stamps = [update.state.stamp_ns for update in run.go(2.6)]
    assert stamps == [ns(t) for t in (0.5, 1.0, 1.5, 2.0, 2.5)]


def test_a_measurement_is_taken_by_the_next_sample_counted_and_known_to_the_health_monitor():
    run = begun()
    updates = run.go(1.0, fixes(0.205, 0.9))
    assert run.log.counts["gnss", Outcome.USED] == 7 == len(updates)
    assert run.monitor.report(ns(1.0), Health.NOMINAL).ages_s["gnss"] == pytest.approx(1.0 - 0.805)
    assert np.linalg.norm(updates[-1].state.nav.position() - DRIVE.nav(0.805).position()) < 0.01


def test_a_measurement_that_is_older_than_the_window_is_late_at_once():
    run = begun()
    run.go(5.0, fixes(0.1, 5.0))
    run.enqueue(position(DRIVE, 0.55, ARM), ns(5.0))
    assert run.log.counts["gnss", Outcome.LATE] == 1
    (event,) = [event for event in run.log.take_events() if event.kind is EventKind.LATE]
    assert "behind the newest state" in event.reason
    assert not run.tracking.is_due


def test_while_the_imu_is_silent_a_measurement_does_not_wait_for_it():
    run = begun()
    run.go(1.0)
    run.enqueue(position(DRIVE, 1.2, ARM), ns(1.2))
    assert run.tracking.is_due
    assert run.tracking.update().state.stamp_ns == ns(1.2)
    # a sample behind the state cannot carry it on
    assert not run.tracking.receive(receive(run.buffer, imu(DRIVE, 1.1, 1.1)[0]))


def test_what_would_begin_anew_does_not_take_a_prism_that_is_elsewhere():
    """Where GNSS was silent it began there, metres off, and refused GNSS when that came back."""
    run = begun(more={"prism": {"kind": "prism", "mount": at(ARM)}})
    elsewhere = [position(DRIVE, t, ARM, (2.0, 0.0, 0.0), sensor="prism") for t in np.arange(0.15, 3.0, 0.1)]
    run.go(3.0, sorted([*fixes(0.1, 3.0), *elsewhere], key=lambda one: one.stamp_ns))
    assert run.tracking.distrusted == {"prism"}
    taken = []
    run.tracking.successor.add = taken.append
    run.go(5.0, [position(DRIVE, 4.0, ARM), position(DRIVE, 4.05, ARM, (2.0, 0.0, 0.0), sensor="prism")])
    assert [one.sensor for one in taken] == ["gnss"]


def test_a_gap_of_the_imu_is_reported_once():
    run = begun()
    run.go(2.0, skip=lambda t: 0.5 < t < 1.0)
    (event,) = [event for event in run.log.take_events() if event.kind is EventKind.IMU_GAP]
    assert (event.stamp_ns, event.sensor) == (ns(0.5), "imu")


def test_constraints_are_made_at_their_rate_but_not_over_a_gap():
    run = begun(more=NO_SLIP)
    run.go(1.05, fixes(0.1, 1.05))
    assert run.log.counts["rear", Outcome.USED] == 10
    run.go(3.05, fixes(1.1, 3.05), skip=lambda t: 1.5 < t < 2.5)
    # of 1.1 ... 3.0 s those from 1.6 to 2.5 s are left out
    assert run.log.counts["rear", Outcome.USED] == 20
    assert [event for event in run.log.take_events() if event.sensor == "rear"] == []


def test_samples_that_neither_a_window_nor_a_new_beginning_needs_are_dropped():
    """The window is of 3 s; a beginning in motion looks at the last 4 s before the newest measurement."""
    run = begun(initialisation={"window_s": 4.0})
    run.go(16.0, fixes(0.1, 16.0))
    run.tracking.drop_samples()
    assert ns(15.9 - 4.0 - 0.1) < run.buffer.oldest_ns <= ns(15.9 - 4.0)


def test_samples_are_dropped_also_while_no_measurement_comes():
    run = begun(initialisation={"window_s": 4.0})
    run.go(2.0, fixes(0.1, 2.0))
    run.go(30.0)
    run.tracking.drop_samples()
    assert run.buffer.oldest_ns > ns(30.0 - 15.0)


def test_it_begins_with_the_receivers_that_its_predecessor_did_not_trust():
    run = begun(more=NO_SLIP)
    run.tracking.distrust(["gnss", "rear", "unknown"])
    assert run.tracking.lost() == ["gnss"]
    run.go(0.6)
    assert run.tracking.is_lost


def test_a_message_that_could_not_be_converted_counts_against_its_receiver():
    run = begun()
    for _ in range(5):
        run.tracking.refuse(fix_at(Drive(), 0.0), Outcome.LARGE_COVARIANCE)
    run.go(0.6)
    assert run.tracking.is_lost
    assert (EventKind.RECEIVER_LOST, "gnss") in {(event.kind, event.sensor) for event in run.log.take_events()}
