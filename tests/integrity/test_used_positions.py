"""The positions in the window: which one its successors contradict, and what is known of the others."""

from math import inf
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from holdfast.integrity.review import UsedPositions
from holdfast.sensors.sensor import Position

SECOND_NS = 1_000_000_000
QUARANTINE_NS = {"left": 2 * SECOND_NS, "right": 2 * SECOND_NS}


ARM = np.array([0.3, -0.2, 2.0])


class Antenna:
    limit, p_I_P, parameters = 16.0, ARM, ()


AT_ORIGIN = SimpleNamespace(nav=lambda _: gtsam.NavState(), angular_velocity=lambda _: np.zeros(3))


def position(t_s, east_m=0.0, sensor="left"):
    return Position(round(t_s * SECOND_NS), sensor, ARM + np.array([east_m, 0.0, 0.0]), np.eye(3) * 0.01**2, 0.0)


def used(*positions):
    found = UsedPositions({"left": Antenna(), "right": Antenna()})
    found.extend(list(positions))
    return found


def test_the_one_that_is_worst_is_found_if_it_is_beyond_its_gate():
    good, bad, worse, newest = position(0.0), position(0.1, 0.05), position(0.2, 0.06), position(0.3)
    assert used(good, bad, worse, newest).worst(AT_ORIGIN, QUARANTINE_NS) is worse
    assert used(good, position(0.1, 0.039), newest).worst(AT_ORIGIN, QUARANTINE_NS) is None


def test_the_newest_has_no_successor_yet_and_the_oldest_cannot_be_taken_out_any_more():
    assert used(position(0.0), position(0.1, 0.5)).worst(AT_ORIGIN, QUARANTINE_NS) is None
    assert used(position(0.0, 0.5), position(2.1)).worst(AT_ORIGIN, QUARANTINE_NS) is None
    assert used(position(0.0, 0.5), position(2.0)).worst(AT_ORIGIN, QUARANTINE_NS) is not None


def test_the_median_nis_is_not_moved_by_one_of_them_and_infinite_for_none():
    some = [position(0.0, 0.01), position(0.1, 0.02), position(0.2, 5.0)]
    assert used().median_nis(some, AT_ORIGIN) == pytest.approx(4.0)
    assert used().median_nis([], AT_ORIGIN) == inf


def test_the_time_since_the_last_one_of_a_receiver_is_told_apart_from_that_of_another():
    found = used(position(0.0), position(0.4, sensor="right"))
    assert found.since_last_s(position(1.0)) == pytest.approx(1.0)
    assert found.since_last_s(position(1.0, sensor="right")) == pytest.approx(0.6)
    assert used().since_last_s(position(1.0)) == inf


def test_what_left_the_window_or_was_taken_out_is_forgotten():
    one, other, right = position(0.0), position(1.0), position(0.5, sensor="right")
    found = used(one, other)
    found.add(right)
    assert found.newest_ns == right.stamp_ns  # the one that came last
    found.remove(other)
    assert found.of() == [one, right] and found.of("right") == [right] and len(found) == 2
    found.forget_before(SECOND_NS // 4)
    assert found.of() == [right] and found.of(since_ns=SECOND_NS) == []
