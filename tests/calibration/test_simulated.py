"""Simulated machines whose file is wrong: what is true is found within three sigmas, whatever the seed."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

from calibration import calibrate, learn, run

from holdfast.calibration.held_out import is_worse

pytestmark = pytest.mark.slow
CLOCKS = ("gnss", "gnss_right", "heading", "lidar")


def rows(scenario, seed, duration_s=20.0):
    found, truth = run(scenario, seed, duration_s, calibrate)
    return found, {
        (one.what, str(one.path[-1])): (one, truth[one.what, str(one.path[-1])])
        for one in found.estimates
        if (one.what, str(one.path[-1])) in truth
    }


def is_within(one, true, sigmas=3.0):
    return abs(one.after - true) <= sigmas * one.sigma


def test_offsets_of_clocks_are_found_and_written():
    found, by_key = rows("offset-clocks", 11)
    for name in CLOCKS:
        one, true = by_key[name, "time_offset_s"]
        assert one.is_written and is_within(one, true) and one.sigma < 0.003
        assert abs(found.config.sensors[name].time_offset_s - true) < 0.004
    assert is_worse(found.held_out[0], found.held_out[-1]) == ""  # the estimator finds them by itself, too


def test_a_lidar_that_is_mounted_otherwise_is_turned_and_no_clock_is_accused():
    found, by_key = rows("wrong-mount", 13, 15.0)
    for axis in "xyz":
        one, true = by_key[f"lidar, about its {axis}", "rotation"]
        assert is_within(one, true), axis
    assert any(one.is_written and one.what.startswith("lidar, about") for one in found.estimates)
    assert not any(by_key[name, "time_offset_s"][0].is_written for name in CLOCKS)


def test_the_zero_of_the_encoder_and_the_drift_of_the_lidar_are_found_on_rough_ground():
    _, by_key = rows("rough", 14, 30.0)  # before, the ground has not been rough enough for the zero
    zero, true = by_key["zero of joint", "zero_offset_deg"]
    assert is_within(zero, true)
    for key in ("drift_m_per_sqrt_m", "translation_sigma_m"):
        one, true = by_key["lidar", key]
        assert one.is_observable and one.after == pytest.approx(true, rel=0.5)


@pytest.mark.parametrize("scenario", ["wrong-mount", "offset-clocks"])
def test_what_one_replay_learns_of_mountings_clocks_and_the_encoder_is_true(scenario):
    found, truth = run(scenario, 15, 20.0, learn)
    assert {key for _, key in (one.key for one in found)} == {"time_offset_s", "rotation", "zero_offset_deg"}
    assert all(abs(one.value - truth[one.key]) <= 3.0 * one.sigma for one in found)
