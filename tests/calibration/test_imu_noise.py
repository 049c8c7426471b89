"""White noise of an IMU at standstill, with vibration and with motion around it."""

import numpy as np
import pytest

from holdfast.calibration.evidence import Evidence, Nodes, Readings, States
from holdfast.calibration.imu_noise import imu_noise
from holdfast.config.load import config_of

RATE_HZ = 100.0
GYROSCOPE, ACCELEROMETER = 4e-4, 6e-3


def config_with(**imu):
    return config_of({"sensors": {"imu": {"kind": "imu", "topic": "/i", **imu}}}, "config")


def evidence(stand_s=30.0, move_s=30.0, vibration=0.0, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, stand_s + move_s, 1.0 / RATE_HZ)
    sigma = np.repeat([GYROSCOPE, ACCELEROMETER], 3) * np.sqrt(RATE_HZ)
    values = sigma * rng.standard_normal((len(t), 6)) + [0.0, 0.0, 0.0, 0.0, 0.0, 9.81]
    values += vibration * np.sin(2.0 * np.pi * 28.0 * t)[:, None] * [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    values[t > stand_s] += 3.0 * rng.standard_normal((int((t > stand_s).sum()), 6))
    none, nothing = np.zeros(0, np.int64), np.zeros((0, 3))
    return Evidence(
        "stand", config_with(), float(t[-1]), [], {}, Nodes(none, nothing, np.zeros((0, 3, 3))),
        States(none, nothing, nothing, np.zeros(0, np.bool_)),
        {"imu": Readings(np.round(t * 1e9).astype(np.int64), values)}, {}, {}, [], [],
    )  # fmt: skip


def by_key(found):
    return {one.path[-1]: one for one in found.estimates}


def test_noise_that_is_larger_than_configured_is_found_and_written():
    found = by_key(imu_noise([evidence()], config_with()))
    for key, true in (("gyroscope_noise_density", GYROSCOPE), ("accelerometer_noise_density", ACCELEROMETER)):
        assert found[key].after == pytest.approx(true, rel=0.1)
        assert found[key].is_written


def test_a_vibration_of_the_engine_is_no_white_noise():
    config = config_with(accelerometer_noise_density=ACCELEROMETER)
    found = by_key(imu_noise([evidence(vibration=0.1)], config))
    assert found["accelerometer_noise_density"].after == pytest.approx(ACCELEROMETER, rel=0.25)
    assert not found["accelerometer_noise_density"].is_written


def test_standing_is_no_reason_to_believe_a_smaller_noise():
    found = by_key(imu_noise([evidence()], config_with(gyroscope_noise_density=10.0 * GYROSCOPE)))
    assert found["gyroscope_noise_density"].reason == "standing shows the least of it"


def test_a_machine_that_never_stood_says_nothing():
    found = imu_noise([evidence(stand_s=5.0)], config_with())
    assert not found.changes
    assert all(one.reason.startswith("not observable") for one in found.estimates)
