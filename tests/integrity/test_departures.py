"""An estimate that is wrong is left smoothly by good positions, one that is right roughly by positions that wander."""

import numpy as np
import pytest

from holdfast.integrity.departures import Departures

CLAIM = np.eye(3)


def rough(departures, claim=CLAIM, dt_s=1.0):
    return gathered(departures, claim, dt_s).are_rough()


def gathered(departures, claim=CLAIM, dt_s=1.0):
    found = Departures()
    for k, off in enumerate(departures):
        found.add(round(k * dt_s * 1e9), np.array(off), claim)
    return found


def noisy(way, sigma=1.0, seed=0):
    rng = np.random.default_rng(seed)
    return [np.array([*way(float(t)), 0.0]) + rng.normal(0.0, sigma, 3) for t in range(8)]


@pytest.mark.parametrize(
    "way",
    [
        pytest.param(lambda _: (30.0, -20.0), id="elsewhere"),
        pytest.param(lambda t: (30.0 + 5.0 * t, 3.0 * t), id="another velocity"),
        pytest.param(lambda t: (2.0 * t**2, 4.0 * t**2), id="another tilt"),
        pytest.param(lambda t: (8.0 * np.cos(0.1 * t), 8.0 * t * np.sin(0.1 * t)), id="another heading in a turn"),
    ],
)
def test_what_leaves_an_estimate_that_is_wrong_is_smooth(way):
    found = [rough(noisy(way, seed=seed)) for seed in range(50)]
    assert np.mean(found) < 0.05


def test_what_wanders_is_rough_whatever_the_distance():
    rng, found = np.random.default_rng(1), []
    for _ in range(50):
        off, departures = rng.normal(0.0, 20.0, 3), []
        for _ in range(8):
            off = off * np.exp(-0.1) + rng.normal(0.0, 20.0 * np.sqrt(1.0 - np.exp(-0.2)), 3)
            departures.append(off)
        found.append(rough(departures))
    assert np.mean(found) > 0.95


def test_what_wanders_slowly_is_not_smooth_at_ten_hertz_either():
    t = np.arange(0.0, 12.0, 0.1)
    astray = np.column_stack([20.0 * np.sin(0.9 * t), 20.0 * np.cos(0.7 * t), 0.0 * t])
    assert rough(astray, dt_s=0.1)
    assert not gathered(astray[:12], dt_s=0.1).are_smooth()


def test_few_positions_or_such_at_one_time_tell_nothing():
    assert not rough(np.random.default_rng(2).normal(0.0, 30.0, (4, 3)))
    assert not rough(np.random.default_rng(2).normal(0.0, 30.0, (8, 3)), dt_s=0.0)


def test_what_is_corrected_is_forgotten_and_a_claim_is_believed():
    departures = np.random.default_rng(2).normal(0.0, 30.0, (8, 3))
    assert rough(departures)
    assert not rough(departures, claim=np.eye(3) * 30.0**2)
    found = Departures()
    for k, off in enumerate(departures):
        found.add(k * 10**9, off, CLAIM)
    found.clear()
    assert not found.are_rough()
