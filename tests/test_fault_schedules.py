"""Whatever goes wrong, and in whatever order: no exception, no number that is none, and O does not jump.

These are a few of them; benchmarks/fault_schedules.py runs as many as one likes.
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

from fault_schedules import complaints

AFTER_SILENCE = (
    "the IMU was silent, or its samples lay on a line; then the velocity was corrected at once and O stepped"
)
MEAN_RATE = "the published angular velocity was the mean since the sample before: over a long step O seemed to rotate"
AHEAD = (
    "a measurement had led the state past a sample; over the next one O went on by constant twist, not reported as such"
)
ONCE_FAILED = {
    7: AFTER_SILENCE,
    576: "late fixes had left the window behind newer ones, and their factors were looked for at the recovery",
    717: MEAN_RATE,
    498: AHEAD,
    115: "velocity corrected by 0.3 m/s at once: O stepped by 3.1 mm",
    41: "the velocity was corrected by 0.5 m/s at once, after a jump of the lidar without GNSS",
    40: "started in motion, the heading was corrected by 9 deg; the velocity in O turned at once",
    320: "the covariance that a failed optimisation left behind was not positive, and no window could begin with it",
    344: "begun anew with swapped antennas and the attitude in doubt, the optimisation diverged",
    63: "the clocks of IMU and GNSS went back; what was driven in the meantime went into T_W_O",
}

ONCE_BEGAN_ANEW = {
    384: "the IMU was silent for 14 s: a lidar was said to be turned, and a start at standstill took the last samples",
    452: "two antennas seemed nearer to each other while the attitude that they are compared by was being mended",
    810: "a receiver that had lied for 14 s made its arm wrong, which had been right for two",
    920: "a lidar whose clock had stepped was witness to a gyroscope whose bias had not",
    436: "a lidar turned by half a circle while samples lay on a line: it was taken for its mount",
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1004))
def test_no_schedule_breaks_the_estimator(seed):
    assert complaints(seed) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2000, 2003))
def test_no_hostile_schedule_breaks_the_estimator(seed):
    assert complaints(seed, hostile=True) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2020, 2022))
def test_no_hostile_schedule_breaks_the_engine_whose_optimiser_is_killed(seed):
    """How late its answers are is for a quiet machine: benchmarks/fault_schedules.py --realtime."""
    assert [line for line in complaints(seed, hostile=True, rate=8.0) if "late answers" not in line] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", ONCE_FAILED)
def test_a_schedule_that_broke_the_estimator_once_does_so_no_more(seed):
    assert complaints(seed) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", ONCE_BEGAN_ANEW)
def test_an_estimate_that_is_right_does_not_begin_anew(seed):
    assert complaints(seed, starts=True) == []


@pytest.mark.slow
def test_a_batch_whose_positions_came_at_one_time_but_for_a_prism_that_lies_is_left():
    """The hostile schedule 247, after a step of clocks."""
    assert complaints(247, hostile=True) == []


@pytest.mark.slow
def test_antennas_that_were_swapped_leave_no_speed_that_leaves_the_earth():
    """The hostile schedule 474: the window diverged to 7500 km/s, and its covariance was lost in rounding."""
    assert complaints(474, hostile=True) == []
