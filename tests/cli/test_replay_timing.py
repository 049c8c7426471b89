"""The line about time that `replay` and `smooth` end with."""

import pytest

from holdfast.cli.replay import timing_line

TIMED = {"recorded_s": 1.0, "wall_s": 2.0, "real_time_factor": 3.0}


@pytest.mark.parametrize(("times", "line"), [
    ({"imu_us": {"median": 9.0}, "update_ms": {"median": 4.21}}, ", IMU sample 9 us, update 4.2 ms (medians)"),
    ({"imu_us": {"median": 9.0}, "update_ms": None}, ", IMU sample 9 us (medians)"),
    ({"imu_us": None, "update_ms": None}, ""),
])  # fmt: skip
def test_the_line_about_time_leaves_out_what_was_never_timed(times, line):
    """A run in real time that ended before its first update was done ended in a traceback."""
    assert timing_line({**TIMED, **times}) == f"1 s in 2.0 s (3 x real time){line}"


def test_the_line_about_time_leaves_out_a_factor_that_nobody_knows():
    assert timing_line({**TIMED, "real_time_factor": None, "imu_us": None, "update_ms": None}) == "1 s in 2.0 s"
