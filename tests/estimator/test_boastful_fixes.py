"""Fixes that scatter by ten or thirty times what they claim: it starts and goes on by what they are worth."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM, FigureEight, fixes, horizontal_errors_m, imu, in_order, machine, run, velocities

from holdfast.events import EventKind

DRIVE = FigureEight(start_s=15.0, ramp_s=4.0, speed=0.3)  # up to 8 m/s
CLAIMED = np.array([0.01, 0.01, 0.02])
END_S = 60.0
DOPPLER = {"kind": "gnss_velocity", "frame": "gnss"}


@pytest.mark.parametrize("times", [1.0, 10.0, 30.0])
@pytest.mark.parametrize("hz", [2.0, 5.0])
def test_the_estimate_goes_on_by_what_they_are_worth_and_accuses_nothing_else(times, hz):
    rng = np.random.default_rng(7)
    noisy = fixes(DRIVE, 0.0, END_S, hz, rng, tuple(times * CLAIMED))
    boastful = [replace(one, covariance=np.diag(CLAIMED**2)) for one in noisy]
    sent = imu(DRIVE, 0.0, END_S, 50.0, rng), boastful, velocities(DRIVE, 0.0, END_S, hz, ARM, rng)
    config = machine(lidar=False, heading_deg=None, more={"doppler": DOPPLER})
    estimator, outputs = run(config, in_order(*sent))
    wrong = {EventKind.BEGUN_ANEW, EventKind.SENSOR_LOST, EventKind.RECEIVER_LOST}
    assert not [event for event in estimator.events if event.kind in wrong]
    assert 0.4 * times < estimator.noise("gnss") < 2.5 * times
    assert np.sqrt(np.mean(np.square(horizontal_errors_m(DRIVE, outputs, 30.0)))) < times * 0.014
