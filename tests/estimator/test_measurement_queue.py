"""Measurements wait until the IMU has reached their time, and come back in the order of their stamps."""

from dataclasses import dataclass

from hypothesis import given
from hypothesis import strategies as st

from holdfast.estimator.queue import MeasurementQueue


@dataclass(frozen=True, eq=False)
class Measured:
    stamp_ns: int
    sensor: str = "gnss"


@given(st.lists(st.integers(0, 20), max_size=30), st.integers(0, 20))
def test_what_is_due_comes_back_by_stamp_and_the_rest_waits(stamps, reached):
    queue, measurements = MeasurementQueue(), [Measured(stamp) for stamp in stamps]
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
    queue = MeasurementQueue()
    for stamp in (1, 3):
        queue.push(Measured(stamp))
    taken = []
    for measured in queue.pop_due(5):
        taken.append(measured.stamp_ns)
        if measured.stamp_ns == 1:
            queue.push(Measured(2))
    assert taken == [1, 2, 3]


def test_what_waits_is_counted_by_sensor():
    queue = MeasurementQueue()
    for sensor in ("gnss", "lidar", "gnss"):
        queue.push(Measured(1, sensor))
    assert queue.counts() == {"gnss": 2, "lidar": 1}
