"""By how much the clock of GNSS is off, as a batch shows."""

from math import inf

import numpy as np
import pytest
from motion import ns

from holdfast.estimator.batch_clock import Offset, kept, offset_of, restamped
from holdfast.graph.alignment_problem import Evidence
from holdfast.sensors.sensor import Position, Velocity


def evidence():
    positions = [Position(ns(t), "gnss", np.zeros(3), np.eye(3), 0.0) for t in range(10)]
    return Evidence(positions, [Velocity(ns(t), "doppler", np.zeros(3), np.eye(3)) for t in range(10)])


@pytest.mark.parametrize("off_s", [-0.5, -0.22, 0.0, 0.1, 0.37])
def test_it_is_where_the_misfit_is_least_and_as_sure_as_that_rises(off_s):
    found = offset_of(lambda by_s: 0.5 + 40.0 * (by_s - off_s) ** 2, 100)
    assert found.by_s == pytest.approx(off_s, abs=1e-6)
    assert found.sigma_s == pytest.approx(np.sqrt(1.0 / (40.0 * 100)))
    assert found.is_off == (off_s != 0.0)


@pytest.mark.parametrize("misfit", [lambda _: 1.0, lambda by_s: -abs(by_s), lambda by_s: inf if by_s else 1.0])
def test_what_no_offset_explains_tells_none(misfit):
    found = offset_of(misfit, 100)
    assert found is None or not found.is_off


@pytest.mark.parametrize(("by_s", "sigma_s"), [(0.03, 0.001), (0.2, 0.05), (0.7, 0.01)])
def test_one_that_is_small_vague_or_beyond_reach_is_left(by_s, sigma_s):
    assert not Offset(by_s, sigma_s).is_off


def test_it_is_told_in_words():
    assert [str(Offset(by_s, 0.01)) for by_s in (0.25, -0.1)] == ["0.25 s early", "0.10 s late"]


def test_what_comes_later_stays_within_the_time_of_the_batch():
    later = restamped(evidence(), {"gnss", "doppler"}, 0.25)
    assert [one.stamp_ns for one in later.positions] == [ns(t + 0.25) for t in range(9)]
    assert [one.stamp_ns for one in later.velocities] == [ns(t + 0.25) for t in range(9)]
    positions_alone = restamped(evidence(), {"gnss"}, -0.25)
    assert [one.stamp_ns for one in positions_alone.positions] == [ns(t - 0.25) for t in range(1, 10)]
    assert [one.stamp_ns for one in positions_alone.velocities] == [ns(t) for t in range(1, 9)]


def test_too_few_positions_are_no_batch():
    assert restamped(evidence(), {"gnss"}, 7.5) is None


@pytest.mark.parametrize(("by_s", "since", "until"), [(0.25, 0, 8), (-0.25, 1, 9), (2.5, 0, 6), (-2.5, 3, 9)])
def test_what_is_left_of_a_batch_that_comes_later_is_told_as_it_was_stamped(by_s, since, until):
    sensors = {"gnss", "doppler"}
    left = kept(evidence(), restamped(evidence(), sensors, by_s), sensors, by_s)
    assert [one.stamp_ns for one in left.positions] == [ns(t) for t in range(since, until + 1)]
    assert [one.stamp_ns for one in left.velocities] == [ns(t) for t in range(since, until + 1)]
