"""Continuous time: what a stamp means after the clock of the IMU, or of another sensor, has stepped."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import Drive, fixes, imu, machine, ns, scans

from holdfast.estimator.clock import CLOCKS, MAX_SILENCE_NS, Clock
from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.sensors.imu import SUSPECTS_ACCEPTED, ImuBuffer
from holdfast.state import Estimate, Output

NO_BIAS = gtsam.imuBias.ConstantBias()
DRIVE = Drive()
SECOND, HOUR = 1_000_000_000, 3_600_000_000_000
DELAY = 3_000_000


class Receiver:
    """A buffer behind a clock, fed as the IMU path feeds it."""

    def __init__(self):
        self.buffer, self.log = ImuBuffer(machine().imu), EventLog("imu")
        self.clock = Clock(self.buffer, self.log)

    def receive(self, samples, by_ns=0, arrival_by_ns=0):
        """Take in samples whose stamps, and arrivals, are off; return how many entered."""
        entered = 0
        for sample in samples:
            arrival_ns = sample.stamp_ns + DELAY + arrival_by_ns
            shown = replace(sample, stamp_ns=sample.stamp_ns + by_ns, arrival_ns=arrival_ns)
            read = self.clock.read_sample(shown)
            if self.buffer.check(read) == "used":
                read = self.clock.step(read) if self.buffer.has_new_clock else read
                if read is not None:
                    self.buffer.add(read)
                    entered += 1
        return entered

    def steps(self):
        return [event.reason for event in self.log.take_events() if event.kind is EventKind.CLOCK_STEP]


def stepped(by_ns):
    """A receiver whose clock stepped after 2 s, at 3 s."""
    receiver = Receiver()
    receiver.receive(imu(DRIVE, 0.0, 2.0))
    before = fixes(DRIVE, 1.9, 1.9)[0]
    receiver.clock.read(replace(before, arrival_ns=before.stamp_ns + 60_000_000))
    receiver.receive(imu(DRIVE, 2.01, 3.0), by_ns)
    return receiver


def test_before_a_step_stamps_are_the_time():
    receiver = Receiver()
    assert receiver.receive(imu(DRIVE, 0.0, 1.0)) == 101
    fix = fixes(DRIVE, 0.9, 0.9)[0]
    assert receiver.clock.read(fix) is fix
    assert not receiver.clock.has_stepped
    assert receiver.clock.stamp(ns(0.5)) == ns(0.5)


@pytest.mark.parametrize("by_ns", [SECOND, -SECOND, HOUR, -HOUR, 50 * 8766 * HOUR])
def test_time_goes_on_by_the_arrivals_over_a_step(by_ns):
    receiver = stepped(by_ns)
    assert receiver.buffer.latest_ns == ns(3.0)
    assert receiver.clock.offset_ns == by_ns
    assert receiver.clock.stamp(ns(3.0)) == ns(3.0) + by_ns
    assert receiver.clock.stamp(ns(1.0)) == ns(1.0)  # what comes late out of the window is of the old clock
    (reason,) = receiver.steps()
    assert f"{'ahead' if by_ns > 0 else 'back'} by {abs(by_ns) * 1e-9:.2f} s" in reason


@pytest.mark.parametrize("by_ns", [SECOND, -SECOND, HOUR])
@pytest.mark.parametrize("steps_too", [True, False])
def test_a_sensor_may_step_with_the_imu_or_not(by_ns, steps_too):
    receiver, fix = stepped(by_ns), fixes(DRIVE, 2.95, 2.95)[0]
    shown = replace(fix, stamp_ns=fix.stamp_ns + by_ns * steps_too, arrival_ns=fix.stamp_ns + 60_000_000)
    assert receiver.clock.read(shown).stamp_ns == fix.stamp_ns


def test_a_fix_with_a_wild_stamp_does_not_change_how_the_next_is_read():
    receiver, fix = stepped(SECOND), fixes(DRIVE, 2.95, 2.95)[0]
    receiver.clock.read(replace(fix, stamp_ns=0))
    receiver.clock.read(replace(fix, stamp_ns=fix.stamp_ns + 5 * SECOND))
    shown = replace(fix, stamp_ns=fix.stamp_ns + SECOND, arrival_ns=fix.stamp_ns + 60_000_000)
    assert receiver.clock.read(shown).stamp_ns == fix.stamp_ns


def test_a_clock_that_steps_back_to_what_it_was_is_the_same_clock():
    """To the nanosecond, whatever the arrivals say, because others may have kept it."""
    receiver = stepped(HOUR)
    receiver.receive(imu(DRIVE, 3.01, 4.0), 0, arrival_by_ns=1_500_000)
    assert receiver.clock.offset_ns == 0
    assert receiver.clock.stamp(ns(2.5)) == ns(2.5) + HOUR
    assert receiver.clock.stamp(ns(3.9)) == ns(3.9)


def test_a_step_takes_several_samples_to_be_believed():
    receiver = Receiver()
    receiver.receive(imu(DRIVE, 0.0, 1.0))
    assert receiver.receive(imu(DRIVE, 1.01, 1.0 + 0.01 * (SUSPECTS_ACCEPTED - 1)), HOUR) == 0
    assert receiver.receive(imu(DRIVE, 1.0 + 0.01 * SUSPECTS_ACCEPTED, 1.5)) == 51 - SUSPECTS_ACCEPTED
    assert not receiver.clock.has_stepped and receiver.steps() == []


@pytest.mark.parametrize("arrival_by_ns", [-HOUR, HOUR, MAX_SILENCE_NS])
def test_where_arrivals_do_not_say_how_much_time_passed_there_is_no_carrying_over(arrival_by_ns):
    receiver = Receiver()
    receiver.receive(imu(DRIVE, 0.0, 1.0))
    assert receiver.receive(imu(DRIVE, 1.01, 1.5), -HOUR, arrival_by_ns) == 0
    assert receiver.steps() == []


def test_what_comes_out_bears_stamps_of_the_imu():
    receiver, nav = stepped(HOUR), DRIVE.nav(2.5)
    clock = receiver.clock
    estimate = Estimate.of(ns(2.5), nav, DRIVE.pose(0.0), NO_BIAS, np.eye(9), np.zeros(3), True)
    output = clock.output(Output(estimate, None, [(ns(0.5), nav), (ns(2.6), nav)]))
    assert output.estimate.stamp_ns == ns(2.5) + HOUR
    assert [stamp for stamp, _ in output.smoothed] == [ns(0.5), ns(2.6) + HOUR]
    receiver.log.report(EventKind.HEALTH, ns(2.7), "", "nominal")
    assert clock.events(receiver.log.take_events())[-1].stamp_ns == ns(2.7) + HOUR


def test_memory_stays_bounded_with_a_clock_that_steps_for_ever():
    receiver = Receiver()
    receiver.receive(imu(DRIVE, 0.0, 1.0))
    for k in range(3 * CLOCKS):
        receiver.receive(imu(DRIVE, 1.01 + 0.1 * k, 1.1 + 0.1 * k), (k + 1) * HOUR)
    assert receiver.clock.offset_ns == 3 * CLOCKS * HOUR
    assert len(receiver.clock._since) <= CLOCKS and len(receiver.clock._known) <= CLOCKS


def test_stamps_that_stand_still_are_replaced_by_arrivals():
    receiver = Receiver()
    samples = imu(DRIVE, 0.0, 1.0)
    receiver.receive(samples)
    entered = []
    for sample in imu(DRIVE, 1.01, 1.2):
        shown = replace(sample, stamp_ns=samples[-1].stamp_ns, arrival_ns=sample.stamp_ns + DELAY)
        receiver.buffer.check(shown)
        if receiver.buffer.is_stuck and (read := receiver.clock.by_arrival(shown)) is not None:
            receiver.buffer.add(read)
            entered.append(read.stamp_ns)
    assert entered == [sample.stamp_ns for sample in imu(DRIVE, 1.03, 1.2)]
    assert len(receiver.steps()) == 1
    assert receiver.receive(imu(DRIVE, 1.21, 1.5)) == 30  # and on with their own stamps


def test_a_sample_that_comes_four_times_is_no_clock_that_stands_still():
    receiver = Receiver()
    samples = imu(DRIVE, 0.0, 1.0)
    receiver.receive(samples)
    for _ in range(4):
        assert receiver.buffer.check(replace(samples[-1], arrival_ns=samples[-1].stamp_ns + 2 * DELAY)) == "duplicate"
        assert not receiver.buffer.is_stuck


def test_a_track_of_the_lidar_keeps_its_pace_over_a_step():
    receiver = stepped(HOUR)
    read = []
    for scan in scans(DRIVE, 2.1, 2.9, 10.0):
        by_ns = HOUR if scan.stamp_ns > ns(2.5) else 0  # it steps half a second later
        read.append(receiver.clock.read(replace(scan, stamp_ns=scan.stamp_ns + by_ns)).stamp_ns)
    assert np.diff(read).tolist() == [100_000_000] * 8
