"""What the accelerometer feels and no receiver sees: a folded engine is found; motion, noise and wrong arms are not."""

from dataclasses import replace

import numpy as np
import pytest
from faults import swung
from motion import ARM, ARM_RIGHT, Drive, StopAndGo, imu, machine, ns

from holdfast.event_log import EventLog
from holdfast.integrity.point_motion import Motions
from holdfast.integrity.sway import Felt, Sways, unseen
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position

CONFIG = machine(right=True)
FAST, ROAD, ROUGH = StopAndGo(speed=2.0), Drive(radius_m=8.0, speed=0.3), Drive(tilt=0.3, heave_m=0.05)
END_S = 60.0


def seen(t, p):
    """Return a position as a receiver sees it."""
    return p


def repeated(t, p):
    """Return what a receiver says that goes on as before, whatever the machine does."""
    return np.array([0.1 * t, 0.0, 0.0])


def densities(motion, samples, hz=5.0, sigma=0.01, *, receivers=(("gnss", ARM, seen),), ahead_s=0.0):
    """Return the sway (N,) after each position, and what was told of it."""
    rng = np.random.default_rng(0)
    buffer, log, samples = ImuBuffer(CONFIG.imu), EventLog("imu"), iter(samples)
    sways, one, found = Sways(sensors_of(CONFIG), buffer, log, "imu"), next(samples), []
    for t in np.arange(0.0, END_S - 1.0, 1.0 / hz):
        while one is not None and one.stamp_ns <= ns(t - ahead_s):
            buffer.check(one)
            buffer.add(one)
            one = next(samples, None)
        for name, arm, see in receivers:
            p = see(t, motion.pose(t).transformFrom(arm)) + rng.normal(0.0, sigma, 3)
            sways.add(Position(ns(t), name, p, np.eye(3), 0.0))
        found.append(buffer.sway)
    return np.array(found), log.take_events()


@pytest.mark.parametrize("hz", [1.0, 2.0, 5.0, 20.0])
@pytest.mark.parametrize("ahead_s", [0.0, 0.3])
@pytest.mark.parametrize("motion", [ROAD, ROUGH])
def test_an_engine_that_is_folded_is_found_and_told_a_few_times(hz, ahead_s, motion):
    found, events = densities(motion, swung(imu(motion, 0.0, END_S)), hz, ahead_s=ahead_s)
    at_s = np.arange(len(found)) / hz
    assert (found[at_s > 14.0] > 0.5).all() and (found < 6.0).all()
    assert 1 <= len(events) <= 3 and all("swings as no receiver sees" in one.reason for one in events)


@pytest.mark.parametrize("hz", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("sigma", [0.01, 1.0])
@pytest.mark.parametrize("arm", [ARM, ARM + np.array([1.0, -0.7, 0.8])])
@pytest.mark.parametrize("motion", [FAST, ROUGH])
def test_an_accelerometer_that_is_right_is_not_accused(hz, sigma, arm, motion):
    """Nor by fixes that are noisy, or of a point that is elsewhere, nor where the gyroscope has a bias."""
    samples = (
        replace(one, angular_velocity=one.angular_velocity + np.radians([2.0, -3.0, 1.0]))
        for one in imu(motion, 0.0, END_S, rng=np.random.default_rng(1))
    )
    found, events = densities(motion, samples, hz, sigma, receivers=[("gnss", arm, seen)])
    assert not found.any() and not events


def test_what_one_receiver_sees_the_machine_does():
    """One that does not follow it accuses the accelerometer alone."""
    right, stuck = ("gnss", ARM, seen), ("gnss_right", ARM_RIGHT, repeated)
    assert densities(FAST, imu(FAST, 0.0, END_S), receivers=[stuck])[0].any()
    assert not densities(FAST, imu(FAST, 0.0, END_S), receivers=[right, stuck])[0].any()


def test_it_is_forgotten_slowly_after_it_has_ended():
    found, _ = densities(ROUGH, swung(imu(ROUGH, 0.0, END_S), until_s=20.0))
    soon, late = found[5 * 25], found[-1]
    assert soon > 0.5 and late < 0.8 * soon


def test_positions_that_are_all_the_same_tell_nothing():
    found, _ = densities(FAST, imu(FAST, 0.0, END_S), sigma=0.0, receivers=[("gnss", ARM, lambda _, p: 0.0 * p)])
    assert not found.any()


def test_the_density_is_that_of_white_noise():
    rng, times_s, dt_s = np.random.default_rng(0), np.array([0.0, 0.5, 1.1, 1.6, 2.0]), 0.01
    fives = []
    for _ in range(2000):
        forces = 0.7 / np.sqrt(dt_s) * rng.standard_normal((200, 3))
        velocities = np.cumsum(forces, axis=0) * dt_s
        places = np.concatenate([np.zeros((1, 3)), np.cumsum(velocities, axis=0) * dt_s])
        p = places[np.round(times_s / dt_s).astype(int)]
        motions = Motions(p, np.tile(np.eye(3), (5, 1, 1)))
        fives.append(Felt.of(times_s, motions, np.zeros(3), np.zeros((5, 3))))
    assert np.mean(unseen(fives)) == pytest.approx(0.7**2, rel=0.05)
