"""How a machine goes on turning where its IMU falls silent: learnt of its gyroscope, whatever the mounting."""

import gtsam
import numpy as np
import pytest

from holdfast.config.sensors import ImuConfig
from holdfast.messages import ImuSample
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.rate_forecast import RateForecast

HZ, START_NS = 100, 1_700_000_000_000_000_000
DENSITY = 0.2  # as by default [rad/s/sqrt(Hz)]
BIAS = np.array([0.05, -0.1, 0.08])
MOUNT = gtsam.Rot3.RzRyRx(0.4, -0.9, 2.0)  # of the IMU in the machine


def at(time_s: float) -> int:
    return START_NS + round(time_s * 1e9)


def wandering(rng, count, sigma, memory_s):
    """Return a rate that forgets itself after some time."""
    kept, found = np.exp(-1.0 / (HZ * memory_s)), [rng.normal(0.0, sigma)]
    for noise in rng.normal(0.0, sigma * np.sqrt(1.0 - kept**2), count - 1):
        found.append(kept * found[-1] + noise)
    return np.array(found)


def car(seed, lasts_s):
    """Return the rates (N, 3) of a car, in the axes of the IMU: it turns for seconds, and shakes about all axes."""
    rng, count = np.random.default_rng(seed), round(lasts_s * HZ)
    shaken = np.stack([wandering(rng, count, 0.05, 0.1) for _ in range(3)], axis=1)
    shaken[:, 2] += wandering(rng, count, 0.3, 2.0)
    return shaken @ MOUNT.matrix()


def driven(rates, learn_until_s=np.inf):
    """Return a buffer that has measured some rates, of which the forecast has learnt until a time, once every 0.1 s."""
    buffer, force = ImuBuffer(ImuConfig(kind="imu", topic="imu")), np.array([0.0, 0.0, 9.81])
    for k, rate in enumerate(rates):
        stamp = at(k / HZ)
        sample = ImuSample(stamp, stamp, "imu", specific_force=force, angular_velocity=rate + BIAS)
        buffer.check(sample)
        buffer.add(sample)
        if k % 10 == 0 and k / HZ < learn_until_s:
            buffer.forecast.learn(buffer, stamp, BIAS)
    return buffer


@pytest.mark.parametrize("over_s", [0.2, 0.7, 1.5])
def test_a_car_turns_on_as_its_gyroscope_has_shown_and_hardly_tilts(over_s):
    buffer = driven(car(1, 240.0), learn_until_s=180.0)
    squared, of_constant_twist, tilts = [], [], []
    for time_s in np.arange(181.0, 237.0, 0.5):
        rate = buffer.angular_velocity(at(time_s)) - BIAS
        R = buffer.motion(at(time_s), at(time_s + over_s), np.r_[np.zeros(3), BIAS]).R
        found = buffer.forecast.over(over_s, 0.0, rate, DENSITY)
        turned = gtsam.Rot3.Logmap(gtsam.Rot3(R))
        off, covariance = turned - over_s * found.rate, over_s * found.density
        squared.append(off @ np.linalg.solve(covariance, off) / 3.0)
        in_machine = MOUNT.matrix() @ covariance @ MOUNT.matrix().T
        tilts.append(np.sqrt(in_machine[0, 0] / in_machine[2, 2]))
        of_constant_twist.append(np.sum((turned - over_s * rate) ** 2) - np.sum(off**2))
    assert 0.1 < np.mean(squared) < 1.5  # between the spans it is modest
    assert np.mean(of_constant_twist) > 0.0
    assert over_s < 0.5 or max(tilts) < 0.5


def test_parts_of_a_gap_depart_as_the_whole_does():
    forecast = driven(car(2, 60.0)).forecast
    rate = np.array([0.0, 0.1, 0.2])
    whole = 1.8 * forecast.over(1.8, 0.0, rate, DENSITY).density
    parts = [0.6 * forecast.over(0.6, silent_s, rate, DENSITY).density for silent_s in (0.0, 0.6, 1.2)]
    np.testing.assert_allclose(sum(parts), whole, rtol=0.02, atol=1e-6)


def test_where_nothing_is_known_the_twist_is_constant_with_the_noise_that_is_configured():
    rate = np.array([0.3, -0.2, 0.1])
    for over_s in (0.01, 0.3, 2.0):
        found = RateForecast().over(over_s, 0.0, rate, DENSITY)
        np.testing.assert_allclose(found.rate, rate)
        np.testing.assert_allclose(found.density, DENSITY**2 * np.eye(3), atol=1e-9)


def test_a_machine_that_stands_does_not_tell_how_it_turns():
    rng = np.random.default_rng(3)
    found = driven(rng.normal(0.0, 2e-3, (6000, 3))).forecast.over(1.0, 0.0, np.zeros(3), DENSITY)
    np.testing.assert_allclose(found.density, DENSITY**2 * np.eye(3), atol=1e-9)
