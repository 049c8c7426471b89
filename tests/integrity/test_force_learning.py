"""An accelerometer that is wrong in motion is told from an attitude that is wrong, and from fixes that are noisy."""

from dataclasses import replace
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest
from motion import ARM, StopAndGo, imu, machine, ns

from holdfast.integrity.force_learning import ForceLearning
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.noise import Colour
from holdfast.sensors.preintegration import ImuNoise
from holdfast.sensors.sensor import Position

CONFIG = machine(right=False, lidar=False, imu_={"accelerometer_error_ratio": 0.02})
DRIVE, END_S, SIGMA_M = StopAndGo(speed=2.0), 60.0, 0.01
COLOUR = Colour(0.5, 0.5, 60.0)


def tilted(t, *, deg, deg_s):
    """The state of the drive, with a roll in W that it does not have."""
    nav = DRIVE.nav(t)
    off = gtsam.Rot3.RzRyRx(np.radians(deg + deg_s * t), 0.0, 0.0)
    return gtsam.NavState(off.compose(nav.attitude()), nav.position(), nav.velocity())


def learnt(ratio=0.0, deg=0.0, deg_s=0.0):
    """Return what is learnt by an estimate whose attitude is so wrong, of forces wrong by a ratio of the motion."""
    rng, buffer = np.random.default_rng(0), ImuBuffer(CONFIG.imu)
    errors = ratio * rng.normal(0.0, 1.0, (round(END_S) + 2, 3))
    smoother = SimpleNamespace(
        imu=buffer,
        imu_noise=ImuNoise(CONFIG.imu, 1e-4, 9.81),
        newest=SimpleNamespace(bias=gtsam.imuBias.ConstantBias(), covariance=1e-6 * np.eye(15)),
        nav=lambda stamp_ns: tilted((stamp_ns - ns(0.0)) * 1e-9, deg=deg, deg_s=deg_s),
    )
    learning, at_s = ForceLearning(), 1.0
    for one in imu(DRIVE, 0.0, END_S, 100.0, rng, densities=(1e-3, 1e-4)):
        t = (one.stamp_ns - ns(0.0)) * 1e-9
        up = DRIVE.nav(t).attitude().unrotate(np.array([0.0, 0.0, 9.81]))
        accelerated = np.linalg.norm(DRIVE.readings(t)[0] - up)
        sample = replace(one, specific_force=one.specific_force + errors[int(t)] * accelerated)
        buffer.check(sample)
        buffer.add(sample)
        if t > at_s + 0.1:
            position = Position(ns(at_s), "gnss", DRIVE.pose(at_s).transformFrom(ARM), SIGMA_M**2 * np.eye(3), 0.0)
            learning.learn(smoother, position, rng.normal(0.0, SIGMA_M, 3), COLOUR)
            at_s += 1.0
    return learning


def test_an_accelerometer_that_is_wrong_is_found():
    assert 3.0 < learnt(ratio=0.12).accelerometer_scale < 12.0


@pytest.mark.parametrize("wrong", [{}, {"deg": 0.1}, {"deg": 2.0}, {"deg": 5.0}, {"deg": 1.0, "deg_s": 0.1}])
def test_an_attitude_that_is_wrong_does_not_accuse_it(wrong):
    """It was believed thirty times less, so that nothing mended the attitude."""
    learning = learnt(**wrong)
    assert learning.accelerometer_scale < 1.5
    found = learning.learnt()
    assert np.exp(found.log_mean) <= learning.accelerometer_scale
