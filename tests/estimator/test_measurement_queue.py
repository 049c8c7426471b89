"""Measurements wait until the IMU has reached their time, and come back in the order of their stamps."""

from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from holdfast.estimator.queue import SHARE, VERY_LATE_NS, MeasurementQueue

SECOND = 1_000_000_000
LONGEST_NS = SECOND // 2


@dataclass(frozen=True, eq=False)
class Measured:
    stamp_ns: int
    sensor: str = "gnss"


@given(st.lists(st.integers(0, 20), max_size=30), st.integers(0, 20))
def test_what_is_due_comes_back_by_stamp_and_the_rest_waits(stamps, reached):
    queue, measurements = MeasurementQueue(LONGEST_NS), [Measured(stamp) for stamp in stamps]
    for measured in measurements:
        queue.push(measured)
    assert queue.is_due(reached) == any(stamp <= reached for stamp in stamps)
    # of two with one stamp, first the one that came first: the sort is stable
    assert list(queue.pop_due(reached)) == sorted(
        (m for m in measurements if m.stamp_ns <= reached), key=lambda m: m.stamp_ns
    )
    assert len(queue) == sum(stamp > reached for stamp in stamps)
    assert not queue.is_due(reached)


def test_a_measurement_that_comes_while_others_are_taken_is_taken_in_its_turn():
    queue = MeasurementQueue(LONGEST_NS)
    for stamp in (1, 3):
        queue.push(Measured(stamp))
    taken = []
    for measured in queue.pop_due(5):
        taken.append(measured.stamp_ns)
        if measured.stamp_ns == 1:
            queue.push(Measured(2))
    assert taken == [1, 2, 3]


def test_what_waits_is_counted_by_sensor():
    queue = MeasurementQueue(LONGEST_NS)
    for sensor in ("gnss", "lidar", "gnss"):
        queue.push(Measured(1, sensor))
    assert queue.counts() == {"gnss": 2, "lidar": 1}


def test_what_is_very_late_waits_for_others_that_are_and_comes_back_with_them_by_stamp():
    queue, now = MeasurementQueue(LONGEST_NS), 100 * SECOND
    first, second = Measured(now - 2 * SECOND), Measured(now - 2 * SECOND - 1)
    queue.push(first, 2 * SECOND)
    queue.push(second, 2 * SECOND + SECOND // 10 + 1)
    queue.push(Measured(now, "lidar"), 0)
    assert [one.sensor for one in queue.pop_due(now)] == ["lidar"]
    until = now + 2 * SECOND // SHARE  # the first tells, whatever comes after it
    assert len(queue) == 2
    assert queue.counts() == {"gnss": 2}
    assert not queue.is_due(until - 1)
    assert queue.is_due(until)
    assert list(queue.pop_due(until)) == [second, first]
    assert len(queue) == 0


@given(st.lists(st.tuples(st.integers(0, 10 * SECOND), st.integers(0, SECOND)), min_size=1, max_size=40))
def test_nothing_waits_longer_than_a_share_of_its_lateness(measured):
    queue, now, pushed = MeasurementQueue(LONGEST_NS), 20 * SECOND, []
    for late, pause in measured:
        now += pause
        while queue.is_due(now):
            for one in queue.pop_due(now):
                pushed.remove(one)
        one = Measured(now - late)
        queue.push(one, late)
        pushed.append(one)
        if late <= VERY_LATE_NS:
            assert one in list(queue.pop_due(now))
            pushed = [other for other in pushed if other is not one and now - other.stamp_ns > VERY_LATE_NS]
    rest = list(queue.pop_due(now + LONGEST_NS))
    assert len(queue) == 0
    assert set(map(id, rest)) >= {id(one) for one in pushed}


def test_what_waits_for_others_is_drained_with_the_rest():
    queue = MeasurementQueue(LONGEST_NS)
    for stamp in (3 * SECOND, 0):
        queue.push(Measured(stamp), 2 * SECOND - stamp)
    assert [one.stamp_ns for one in queue.drain()] == [0, 3 * SECOND]
    assert len(queue) == 0
