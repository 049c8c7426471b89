import numpy as np
import pytest

from holdfast.evaluation.spans import Span, gaps, longest_s, settling_s


def test_a_span_holds_its_start_but_not_its_end():
    assert Span(1.0, 2.0).holds(np.array([0.9, 1.0, 1.9, 2.0])).tolist() == [False, True, True, False]


def test_gaps_lie_between_the_times_and_reach_to_the_ends_of_the_whole():
    times = np.array([2.0, 2.5, 3.0, 6.0, 6.5, 9.0])
    assert gaps(times, 1.0, Span(0.0, 12.0)) == [(0.0, 2.0), (3.0, 6.0), (6.5, 9.0), (9.0, 12.0)]
    assert gaps(times, 1.0, Span(2.2, 6.2)) == [(3.0, 6.0)]


def test_a_gap_of_just_the_length_is_none():
    assert gaps(np.array([1.0, 2.0]), 1.0, Span(1.0, 2.0)) == []


def test_without_any_time_the_whole_is_a_gap():
    assert gaps(np.zeros(0), 1.0, Span(3.0, 9.0)) == [(3.0, 9.0)]


def test_the_longest_stretch_lasts_until_the_first_time_after_it():
    times = np.array([0.0, 1.0, 2.0, 4.0, 7.0, 8.0])
    assert longest_s(times, np.array([True, True, False, True, False, False])) == 3.0
    assert longest_s(times, np.array([False, False, False, False, True, True])) == 1.0
    assert longest_s(times, np.zeros(6, dtype=bool)) == 0.0


def test_a_value_has_settled_when_it_comes_below_the_limit_to_stay():
    times = np.arange(10) * 0.5
    values = np.array([5, 1, 5, 1, 1, 5, 1, 1, 1, 1])
    assert settling_s(times, values, 2.0, hold_s=0.5) == 0.5
    assert settling_s(times, values, 2.0, hold_s=0.9) == 1.5
    assert settling_s(times, values, 2.0, hold_s=1.5) == 3.0  # the end cuts it short


def test_a_value_at_the_limit_has_not_settled():
    assert settling_s(np.arange(3.0), np.full(3, 2.0), 2.0, hold_s=0.0) == np.inf


@pytest.mark.parametrize("hold_s", [0.0, 1.0, 100.0])
def test_what_is_below_the_limit_from_the_start_settles_at_once(hold_s):
    assert settling_s(np.arange(5.0) + 7.0, np.ones(5), 2.0, hold_s) == 0.0
