"""An odometry whose clock is off from the start, as of a driver that stamps what it has computed, beside 1-Hz fixes."""

import numpy as np
import pytest
from motion import FigureEight, StopAndGo, deviation, estimates, fixes, imu, in_order, machine, ns, run, scans

from holdfast.events import EventKind

GAP = 28.0, 29.6
RIGHT_S, END_S = 15.0, 38.0


@pytest.fixture(scope="module", params=[0.3, -0.3])
def driven(request):
    """A drive of 10 m/s with stamps that are early by so much; in it the IMU is silent once."""
    rng, drive, early_s = np.random.default_rng(1), FigureEight(speed=0.35), request.param
    samples = [one for one in imu(drive, 0.0, END_S, 100.0, rng) if not ns(GAP[0]) < one.stamp_ns < ns(GAP[1])]
    poses = scans(drive, 0.0, END_S, 10.0, rng, phase_s=0.0071, delay_s=0.05, stamp_shift_s=-early_s)
    estimator, outputs = run(machine(), in_order(samples, fixes(drive, 0.0, END_S, 1.0, rng, phase_s=0.0137), poses))
    return drive, early_s, estimator, estimates(outputs)


def test_the_clock_is_found_and_the_odometry_trusted(driven):
    _, early_s, estimator, _ = driven
    offset = estimator.constants()["lidar"]
    assert offset.value[-1] == pytest.approx(early_s, abs=0.01)
    told = [event.kind for event in estimator.events if event.sensor == "lidar"]
    assert told.count(EventKind.SENSOR_LOST) == told.count(EventKind.SENSOR_REGAINED)


def test_fixes_are_believed_rather_than_it_and_a_gap_of_the_imu_is_crossed(driven):
    """1.6 s at 10 m/s: taken for the motion over 0.3 s, the velocity beside the gap says what nobody measured."""
    drive, _, _, given = driven
    assert max(deviation(drive, one)[0] for one in given if one.stamp_ns > ns(RIGHT_S)) < 0.3


@pytest.mark.parametrize(
    ("drive", "early_s"), [(StopAndGo(radius_m=4.0, speed=0.35), 1.2), (FigureEight(speed=0.35), -0.8)]
)
def test_one_that_is_seconds_off_is_dated_anew_and_holds_an_outage(drive, early_s):
    """It was not trusted, for good, or its clock crept and bent all else: 20 s without fixes cost metres."""
    rng = np.random.default_rng(1)
    poses = scans(drive, 0.0, 75.0, 10.0, rng, phase_s=0.0071, delay_s=1.3, stamp_shift_s=-early_s)
    streams = imu(drive, 0.0, 75.0, 100.0, rng), fixes(drive, 0.0, 55.0, 5.0, rng), poses
    estimator, outputs = run(machine(), in_order(*streams))
    told = [event for event in estimator.events if "beside the motion" in event.reason]
    assert [event.sensor for event in told] == ["lidar"]
    known_s = estimator.early_ns["lidar"] * 1e-9 + estimator.constants()["lidar"].value[-1]
    assert known_s == pytest.approx(early_s, abs=0.02)
    assert max(deviation(drive, one)[0] for one in estimates(outputs) if one.stamp_ns > ns(45.0)) < 0.3
