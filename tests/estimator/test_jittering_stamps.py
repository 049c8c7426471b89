"""A receiver with RTK whose driver stamps what it says when it arrives: the car is where it is all the same."""

from dataclasses import replace

import numpy as np
import pytest
from motion import ARM, FigureEight, fix_at, fixes, horizontal_errors_m, imu, in_order, machine, ns, run, velocities

from holdfast.events import EventKind

DRIVE = FigureEight(start_s=15.0, ramp_s=4.0, speed=0.3)  # up to 8 m/s
CLAIMED = (0.01, 0.01, 0.02)
END_S = 60.0
DOPPLER = {"kind": "gnss_velocity", "frame": "gnss"}


def stamped_at_arrival(messages, jitter_s):
    rng = np.random.default_rng(11)
    by_ns = {one.stamp_ns: round(rng.uniform(-jitter_s, jitter_s) * 1e9) for one in messages}
    return [replace(one, stamp_ns=one.stamp_ns + by_ns[one.stamp_ns]) for one in messages]


@pytest.mark.parametrize("jitter_s", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("has_velocities", [True, False])
def test_the_car_is_where_it_is_whatever_stamps_the_driver_gives(jitter_s, has_velocities):
    """At 8 m/s 30 ms are 24 cm."""
    rng = np.random.default_rng(7)
    said = fixes(DRIVE, 0.0, END_S, 5.0, rng, CLAIMED)
    if has_velocities:
        said += velocities(DRIVE, 0.0, END_S, 5.0, ARM, rng)
    sent = imu(DRIVE, 0.0, END_S, 50.0, rng), stamped_at_arrival(said, jitter_s)
    config = machine(lidar=False, heading_deg=None, more={"doppler": DOPPLER} if has_velocities else {})
    estimator, outputs = run(config, in_order(*sent))
    wrong = {EventKind.BEGUN_ANEW, EventKind.SENSOR_LOST, EventKind.RECEIVER_LOST}
    assert not [event for event in estimator.events if event.kind in wrong]
    assert np.sqrt(np.mean(np.square(horizontal_errors_m(DRIVE, outputs, 30.0)))) < 0.03


def test_what_measures_at_uneven_times_keeps_its_stamps_once_it_moves():
    """As a station that is asked for a position when somebody has time."""
    rng = np.random.default_rng(7)
    times_s = 0.2 * np.arange(1, 300) + rng.uniform(-0.03, 0.03, 299)
    said = [fix_at(DRIVE, t, rng.normal(0.0, CLAIMED), CLAIMED) for t in times_s]
    estimator, outputs = run(machine(lidar=False, heading_deg=None), in_order(imu(DRIVE, 0.0, END_S, 50.0, rng), said))
    (told,) = [event for event in estimator.events if "uneven stamps are right" in event.reason]
    assert told.stamp_ns < ns(DRIVE.start_s + 10.0)
    assert np.sqrt(np.mean(np.square(horizontal_errors_m(DRIVE, outputs, 35.0)))) < 0.02
