"""What measurements that follow each other closely weigh together."""

import pytest

from holdfast.sensors.noise import correlation_inflation, shared_inflation


def test_measurements_far_apart_count_in_full_and_close_ones_share_the_weight_of_one():
    assert correlation_inflation(0.25, 1e6) == pytest.approx(1.0, abs=1e-6)
    # n of them within a time much shorter than tau: T / (2 tau) independent ones, whatever n
    for dt in (0.001, 0.01):
        assert 0.1 / dt / correlation_inflation(5.0, dt) == pytest.approx(0.1 / (2.0 * 5.0), rel=2e-3)


def test_measurements_that_enter_at_once_weigh_as_much_as_one_after_the_other_and_none_more_than_another():
    gaps_s = [45.0, 0.05, 0.05, 0.1, 0.05]
    one_by_one = sum(1.0 / correlation_inflation(0.25, gap_s) for gap_s in gaps_s)
    assert len(gaps_s) / shared_inflation(0.25, gaps_s) == pytest.approx(one_by_one)
    assert shared_inflation(0.25, gaps_s) > 3.0  # the first alone would count in full
    assert shared_inflation(0.25, [0.2]) == pytest.approx(correlation_inflation(0.25, 0.2))
    assert shared_inflation(0.0, gaps_s) == pytest.approx(1.0)
