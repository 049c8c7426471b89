"""Measurements of one instant that arrive apart: who is waited for, and for how long."""

import pytest

from holdfast.estimator.epochs import MAX_WAIT_NS, Epochs

MS = 1_000_000
PERIOD_NS = 50 * MS


def after(*came):
    """What an estimator that received (sensor, stamp [ms], arrival [ms]) waits for."""
    epochs = Epochs()
    for sensor, stamp_ms, arrival_ms in came:
        epochs.add(sensor, round(stamp_ms * MS), round(arrival_ms * MS))
    return epochs


FIRST = ("left", 0, 50), ("right", 0, 56), ("heading", 0, 61)  # nobody knows yet that they measure together


def test_nothing_is_waited_for_before_sensors_have_measured_together():
    assert not Epochs().is_incomplete(50 * MS)
    for count in (1, 2, 3):
        assert not after(*FIRST[:count]).is_incomplete(62 * MS)


def test_sensors_that_measured_together_are_waited_for_until_the_last_of_them_came():
    assert after(*FIRST, ("left", 50, 101)).is_incomplete(102 * MS)
    assert after(*FIRST, ("left", 50, 101), ("heading", 50, 103)).is_incomplete(104 * MS)
    assert not after(*FIRST, ("left", 50, 101), ("heading", 50, 103), ("right", 50, 110)).is_incomplete(111 * MS)


def test_stamps_of_one_node_are_one_epoch():
    ours = ("left", 0, 50), ("right", 0.04, 51)
    assert after(*ours, ("left", 50.01, 101)).is_incomplete(102 * MS)
    assert not after(*ours, ("left", 50.01, 101), ("right", 50.04, 102)).is_incomplete(103 * MS)


def test_what_does_not_come_in_time_is_no_longer_waited_for():
    epochs = after(*FIRST, ("left", 50, 101), ("right", 50, 102))
    assert epochs.is_incomplete(101 * MS + MAX_WAIT_NS - 1)
    assert not epochs.is_incomplete(101 * MS + MAX_WAIT_NS)
    epochs.add("left", 100 * MS, 151 * MS)  # the heading is lost: with it the others measured at 0, not at 50
    epochs.add("right", 100 * MS, 153 * MS)
    assert not epochs.is_incomplete(154 * MS)


def test_a_sensor_that_always_comes_too_late_is_never_waited_for():
    epochs = after(("left", 0, 50), ("lidar", 0, 120))
    for second in (1, 2, 3):
        epochs.add("left", second * 1000 * MS, (second * 1000 + 50) * MS)
        assert not epochs.is_incomplete((second * 1000 + 60) * MS)
        epochs.add("lidar", second * 1000 * MS, (second * 1000 + 120) * MS)


@pytest.mark.parametrize("other_ms", [20.0, 49.0])
def test_sensors_that_measure_at_other_times_neither_wait_nor_are_waited_for(other_ms):
    epochs = after(*FIRST, ("lidar", other_ms, 100), ("lidar", other_ms + 50, 149))
    assert not epochs.is_incomplete(100 * MS)
    epochs.add("left", 50 * MS, 150 * MS)
    epochs.add("lidar", round((other_ms + 100) * MS), 151 * MS)
    assert epochs.is_incomplete(152 * MS)  # for the right antenna still
    epochs.add("right", 50 * MS, 153 * MS)
    epochs.add("heading", 50 * MS, 154 * MS)
    assert not epochs.is_incomplete(155 * MS)


def test_a_clock_of_arrivals_that_goes_back_ends_the_wait():
    assert not after(*FIRST, ("left", 50, 101)).is_incomplete(-3_600_000 * MS)
