"""Stamps that are so far ahead of the IMU's clock, or behind it, that no transport explains it."""

import numpy as np
import pytest
from motion import ns

from holdfast.estimator.far_clocks import COUNT, FarClocks
from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.messages import Height
from holdfast.sensors.clock import measured_later

RATE_HZ = 2.0


@pytest.fixture
def log():
    return EventLog("imu")


def height(t, off_s=0.0, late_s=0.05, sensor="barometer"):
    return Height(ns(t + off_s), ns(t + late_s), sensor, 0.0, None)


def read(clocks, off_s, *, since_s=0.0, count=20, late_s=0.05, sensor="barometer"):
    """By how much stamps are off [s] as they are read, of a clock that is off."""
    left = []
    for t in since_s + np.arange(count) / RATE_HZ:
        message = height(t, off_s, late_s, sensor)
        left.append((clocks.read(message, message.arrival_ns - message.stamp_ns).stamp_ns - ns(t)) * 1e-9)
    return np.array(left)


@pytest.mark.parametrize("off_s", [0.5, -0.5, -11.9])
def test_a_clock_that_may_be_right_is_left(log, off_s):
    np.testing.assert_allclose(read(FarClocks(log), off_s), off_s, atol=1e-6)
    assert not log.events


@pytest.mark.parametrize("off_s", [0.7, -13.0, 3600.0, -1.6e9])
def test_one_that_cannot_be_is_read_as_if_all_came_at_once(log, off_s):
    clocks = FarClocks(log)
    left = read(clocks, off_s)
    np.testing.assert_allclose(left[: COUNT - 1], off_s, atol=1e-6)
    np.testing.assert_allclose(left[COUNT - 1 :], 0.05, atol=1e-6)
    assert clocks.learnt() == {"barometer": pytest.approx(-(off_s - 0.05) * 1e9, abs=1e3)}
    (event,) = log.events
    assert event.kind is EventKind.CLOCK_STEP and "read by a clock that is off by that" in event.reason
    assert clocks.late_s("barometer") == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("off_s", [18.0, -18.0, 37.0])
def test_leap_seconds_are_known_exactly(log, off_s):
    np.testing.assert_allclose(read(FarClocks(log), off_s, late_s=0.2)[COUNT:], 0.0, atol=1e-6)


def test_what_transport_takes_is_known_from_before_and_of_sensors_with_one_clock(log):
    clocks = FarClocks(log)
    for sensor in ("barometer", "altimeter"):
        read(clocks, 0.0, sensor=sensor, late_s=0.3)
    np.testing.assert_allclose(read(clocks, 7.0, since_s=20.0, late_s=0.3)[COUNT:], 0.0, atol=1e-6)
    left = read(clocks, 7.0, since_s=20.0, sensor="altimeter", late_s=0.4)
    np.testing.assert_allclose(left[COUNT:], 0.0, atol=1e-6)


@pytest.mark.parametrize("off_s", [1.5, 18.0, 1.6e9])
def test_a_clock_that_is_set_right_is_believed_at_once(log, off_s):
    clocks = FarClocks(log)
    read(clocks, 0.0)
    read(clocks, off_s, since_s=10.0)
    np.testing.assert_allclose(read(clocks, 0.0, since_s=20.0), 0.0, atol=1e-6)
    assert clocks.learnt() == {} and "again" in log.events[-1].reason


def test_a_few_stamps_are_no_clock_nor_are_those_that_stand_still_or_come_at_once(log):
    clocks = FarClocks(log)
    assert (read(clocks, 3600.0, count=COUNT - 1) > 3599.0).all()
    for t in np.arange(0.0, 20.0, 0.5):
        clocks.read(height(t, 40.0 - t), ns(t) - ns(40.0))
    for t in np.arange(0.0, 1.0, 0.01):
        clocks.read(height(t, 5.0), ns(0.0) - ns(5.0))
    assert clocks.learnt() == {} and not log.events


def test_what_was_known_before_holds_while_it_can_be(log):
    before = {"barometer": -round(18e9)}
    np.testing.assert_allclose(read(FarClocks(log, before), 18.0), 0.0, atol=1e-6)
    assert not log.events
    np.testing.assert_allclose(read(FarClocks(log, before), 0.0), 0.0, atol=1e-6)
    np.testing.assert_allclose(read(FarClocks(log, before), 3600.0)[COUNT:], 0.05, atol=1e-6)


def test_it_is_told_at_the_time_of_the_imu_whatever_is_configured(log):
    """An event came 18 s before the recording."""
    clocks = FarClocks(log)
    for t in np.arange(COUNT) / RATE_HZ:
        message = height(t)
        clocks.read(message, message.arrival_ns - message.stamp_ns - ns(18.0) + ns(0.0), ns(18.0) - ns(0.0))
    assert [one.stamp_ns for one in log.events] == [message.arrival_ns]


def test_a_message_is_the_same_one_where_its_stamp_is():
    message = height(1.0)
    assert measured_later(message, 0) is message
    assert measured_later(message, 10).stamp_ns == message.stamp_ns + 10
