"""Stamps: no duplicates, none that is ahead of the IMU's clock."""

import pytest

from holdfast.events import Outcome
from holdfast.sensors.stamp_filter import FUTURE_NS, RECENT, StampFilter

SECOND_NS = 1_000_000_000


def test_a_stamp_a_second_ahead_of_those_before_of_its_sensor_is_a_clock_jump():
    """It would wait for the IMU and enter where the machine is a second later."""
    stamps, reached_ns = StampFilter(), 100 * SECOND_NS
    for k in range(5):
        now_ns = reached_ns + k * SECOND_NS
        assert stamps.check("gnss", now_ns - 50_000_000, now_ns, now_ns, now_ns) is Outcome.USED
        assert stamps.check("slow", now_ns + 700_000_000, now_ns, now_ns, now_ns) is Outcome.USED  # it was ever ahead
    now_ns = reached_ns + 5 * SECOND_NS
    assert stamps.check("gnss", now_ns + 950_000_000, now_ns, now_ns, now_ns) is Outcome.CLOCK_JUMP
    assert stamps.check("gnss", now_ns, now_ns, now_ns, now_ns) is Outcome.USED
    assert stamps.check("slow", now_ns + 950_000_000, now_ns, now_ns, now_ns) is Outcome.USED


def test_a_stamp_is_used_once_by_each_sensor():
    stamps = StampFilter()
    outcomes = [stamps.check(sensor, 5, 5, 5, 5) for sensor in ("gnss", "gnss", "lidar")]
    assert outcomes == [Outcome.USED, Outcome.DUPLICATE, Outcome.USED]


def test_a_duplicate_is_found_among_the_recent_stamps_in_any_order():
    stamps = StampFilter()
    for k in range(RECENT):
        stamps.check("gnss", 1000 - k, 0, 1000, 0)
    assert stamps.check("gnss", 1000, 0, 1000, 0) is Outcome.DUPLICATE
    stamps.check("gnss", 2000, 0, 2000, 0)
    assert stamps.check("gnss", 1000, 0, 2000, 0) is Outcome.USED  # forgotten: the work per message is bounded


@pytest.mark.parametrize(("ahead_ns", "outcome"), [(FUTURE_NS, Outcome.USED), (FUTURE_NS + 1, Outcome.CLOCK_JUMP)])
def test_a_stamp_that_is_far_ahead_of_the_imu_is_an_error_of_a_clock(ahead_ns, outcome):
    reached_ns = 100 * SECOND_NS
    assert StampFilter().check("gnss", reached_ns + ahead_ns, 7, reached_ns, 7) is outcome


def test_a_silence_of_the_imu_explains_a_stamp_that_is_ahead_of_it():
    reached_ns = 100 * SECOND_NS
    stamp_ns = reached_ns + 30 * SECOND_NS
    assert StampFilter().check("gnss", stamp_ns, 30 * SECOND_NS, reached_ns, 0) is Outcome.USED
    assert StampFilter().check("gnss", stamp_ns, 20 * SECOND_NS, reached_ns, 0) is Outcome.CLOCK_JUMP


def test_before_the_first_sample_of_the_imu_no_stamp_is_ahead():
    assert StampFilter().check("gnss", 10**18, 0, 0, 0) is Outcome.USED


def test_a_stamp_that_was_refused_may_come_again():
    stamps = StampFilter()
    stamp_ns = 10 * SECOND_NS
    assert stamps.check("gnss", stamp_ns, 0, SECOND_NS, 0) is Outcome.CLOCK_JUMP
    assert stamps.check("gnss", stamp_ns, 0, stamp_ns, 0) is Outcome.USED
