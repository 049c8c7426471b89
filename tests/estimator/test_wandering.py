"""Positions that wander do not move an estimate with which velocities agree; a place that is another is believed."""

from functools import cache

import numpy as np
import pytest
from motion import Drive, estimates, fix_at, fixes, imu, in_order, machine, run, seconds, velocities

from holdfast.events import EventKind

ROAD = Drive(start_s=4.0, ramp_s=4.0, radius_m=40.0, speed=0.2, tilt=0.0, heave_m=0.0)  # 8 m/s
CLAIM = 0.5, 0.5, 1.0
ASTRAY_S = 60.0
DOPPLER = {"doppler": {"kind": "gnss_velocity", "frame": "gnss"}}


@cache
def sent(end_s):
    """What the IMU and the Doppler velocities tell of the road."""
    rng = np.random.default_rng(1)
    return imu(ROAD, 0.0, end_s, 50.0, rng), velocities(ROAD, 0.0, end_s, rng=rng)


def astray(until_s, end_s, off_m):
    """A fix a second, off by (3,) [m] at a time [s], from a time on until another; they claim what they did."""
    rng = np.random.default_rng(2)
    found = fixes(ROAD, 0.0, ASTRAY_S, 1.0, rng, CLAIM, phase_s=0.0137)
    for t in np.arange(ASTRAY_S + 1.0137, end_s, 1.0):
        noise = rng.normal(0.0, CLAIM)
        found.append(fix_at(ROAD, t, noise + (off_m(t) if t < until_s else 0.0), CLAIM))
    return found


def wander(amplitude_m, tau_s=10.0, seed=5):
    """Errors as in narrow streets: other ones after some seconds."""
    rng, keep = np.random.default_rng(seed), np.exp(-1.0 / tau_s)
    errors = [rng.normal(0.0, amplitude_m, 3)]
    for _ in range(400):
        errors.append(keep * errors[-1] + np.sqrt(1.0 - keep**2) * rng.normal(0.0, amplitude_m, 3))
    return lambda t: errors[int(t)]


def driven(end_s, found, *, has_doppler=True):
    """Return the estimator, and its horizontal errors since the fixes were astray, by time."""
    streams = sent(end_s) if has_doppler else sent(end_s)[:1]
    estimator, outputs = run(machine(lidar=False, more=DOPPLER if has_doppler else None), in_order(*streams, found))
    errors = {
        seconds(one.stamp_ns): float(
            np.linalg.norm((one.nav.position() - ROAD.nav(seconds(one.stamp_ns)).position())[:2])
        )
        for one in estimates(outputs)
        if seconds(one.stamp_ns) > ASTRAY_S
    }
    return estimator, errors


@pytest.mark.parametrize("amplitude_m", [10.0, 30.0])
def test_fixes_that_wander_and_claim_half_a_metre_do_not_move_what_velocities_agree_with(amplitude_m):
    estimator, errors = driven(130.0, astray(110.0, 130.0, wander(amplitude_m)))
    assert max(errors.values()) < 4.0
    assert max(off for t, off in errors.items() if t > 125.0) < 3.0 * np.hypot(*CLAIM[:2])
    assert not [event for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]


def test_a_receiver_that_repeats_its_last_position_is_not_believed_however_long():
    there = ROAD.nav(ASTRAY_S).position()
    _, errors = driven(120.0, astray(115.0, 120.0, lambda t: there - ROAD.nav(t).position()))
    assert max(errors.values()) < 4.0


def test_another_place_beside_which_the_fixes_go_as_the_velocities_do_is_believed():
    """As after a base station was changed, or after a long error of the estimate that velocities do not see."""
    step = np.array([30.0, -20.0, 0.0])
    _, errors = driven(90.0, astray(1e3, 90.0, lambda _: step))
    beside = [off for t, off in errors.items() if t > ASTRAY_S + 20.0]
    assert np.allclose(beside, np.linalg.norm(step), atol=2.0)


def test_what_wanders_for_long_is_noisier_than_it_claims():
    estimator, errors = driven(180.0, astray(1e3, 180.0, wander(10.0)))
    assert max(errors.values()) < 10.0  # that of one fix is 14 m
    assert estimator.noise("gnss") > 3.0
    assert any(event.kind is EventKind.RECEIVER_REGAINED for event in estimator.events)


def test_without_velocities_what_wanders_is_believed_as_far_as_its_distance_shows():
    estimator, errors = driven(130.0, astray(110.0, 130.0, wander(20.0)), has_doppler=False)
    assert not [event for event in estimator.events if event.kind is EventKind.BEGUN_ANEW]
    assert max(errors.values()) < 30.0  # of the fixes 45
    assert max(off for t, off in errors.items() if t > 128.0) < 3.0 * np.hypot(*CLAIM[:2])
