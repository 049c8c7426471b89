"""A pause of the whole recording: what came back is not silent, and a heading that was lost in it is found at once."""

import gtsam
import numpy as np
import pytest
from motion import ARM_RIGHT, Drive, fixes, imu, in_order, machine, run, scans, seconds, velocities

from holdfast.events import EventKind

PAUSE_S, END_S, MIDDLE_S = 20.0, 30.0, 24.0
MISLEADING = {EventKind.GNSS_LOST, EventKind.RECEIVER_LOST, EventKind.SENSOR_LOST, EventKind.OPTIMISER_FAULT}


def paused(drive, lasting_s, *, second=(), hz=5.0, seed=2, **sensors):
    """Events, times since its end [s] and errors [m] of a machine whose recording stands still from `PAUSE_S` on."""
    rng, until_s = np.random.default_rng(seed), END_S + lasting_s
    streams = [imu(drive, 0.0, until_s, 100.0, rng), fixes(drive, 0.0, until_s, hz, rng, phase_s=0.4 / hz)]
    streams += [make(drive, 0.0, until_s, 5.0, rng=rng, **how) for make, how in second]
    messages = [m for m in in_order(*streams) if not PAUSE_S < seconds(m.stamp_ns) < PAUSE_S + lasting_s]
    estimator, outputs = run(machine(**sensors), messages)
    estimates = [one.estimate for one in outputs if one.estimate is not None]
    t = np.array([seconds(one.stamp_ns) for one in estimates])
    off_m = [np.linalg.norm(one.position - drive.nav(at_s).position()) for one, at_s in zip(estimates, t, strict=True)]
    events = {one.kind for one in estimator.take_events() if seconds(one.stamp_ns) > PAUSE_S - 0.5}
    return events, t - PAUSE_S - lasting_s, np.array(off_m)


class Turning(Drive):
    """A car that is turned by half a circle in the middle of the pause, and goes back the way it has come."""

    def nav(self, t):
        if t <= MIDDLE_S:
            return super().nav(t)
        then = super().nav(2.0 * MIDDLE_S - t)
        return gtsam.NavState(gtsam.Rot3.Yaw(np.pi) * then.attitude(), then.position(), -then.velocity())

    def readings(self, t):
        if t <= MIDDLE_S:
            return super().readings(t)
        then_s = 2.0 * MIDDLE_S - t
        force, rate = super().readings(then_s)
        return self.nav(t).attitude().unrotate(super().nav(then_s).attitude().rotate(force)), -rate


RIGHT = {"right": True, "second": [(fixes, {"arm": ARM_RIGHT, "sensor": "gnss_right", "phase_s": 0.08})]}
DOPPLER = {
    "more": {"doppler": {"kind": "gnss_velocity", "topic": "/velocity", "frame": "gnss"}},
    "second": [(velocities, {})],
    "hz": 1.0,
}


@pytest.mark.parametrize("lasting_s", [2.0, 5.0])
def test_after_a_pause_no_sensor_is_called_silent(lasting_s):
    events, since_s, off_m = paused(Drive(speed=0.05, radius_m=20.0), lasting_s, second=[(scans, {})], hz=1.0)
    assert not events & MISLEADING
    assert off_m[since_s > 0.5].max() < 0.1


def test_two_antennas_tell_at_once_how_the_machine_has_turned_in_the_pause():
    """It pitches and rolls, and is turned by half a circle."""
    events, since_s, off_m = paused(Turning(speed=0.7), 8.0, lidar=False, **RIGHT)
    assert not events & MISLEADING and EventKind.BEGUN_ANEW not in events
    assert off_m[since_s > 0.5].max() < 0.1


@pytest.mark.parametrize("lasting_s", [15.0, 30.0])
def test_a_long_pause_is_crossed_and_the_answers_go_on(lasting_s):
    drive = Drive(speed=0.5, radius_m=20.0, tilt=0.1)
    events, since_s, off_m = paused(drive, lasting_s, lidar=False, **DOPPLER)
    assert EventKind.CLOCK_STEP not in events
    after_s = since_s[since_s > -0.5]
    assert np.diff(after_s).max() < 0.02 and after_s[0] < 0.02
    assert off_m[since_s > 2.0].max() < 0.5


def test_the_course_tells_how_a_car_has_turned_in_the_pause():
    """With one antenna nothing else tells."""
    drive = Turning(speed=0.05, radius_m=100.0, tilt=0.0, heave_m=0.0, roll_rad=0.0, pitch_rad=0.0)
    events, since_s, off_m = paused(drive, 8.0, lidar=False, **DOPPLER)
    assert EventKind.BEGUN_ANEW in events
    assert off_m[since_s > 2.0].max() < 1.0
