"""The gyroscope in the chassis: what it measures about the axis of the joint, and which samples can be used."""

from math import inf, nan, sqrt

import numpy as np
import pytest

from holdfast.chassis.base_gyro import BaseGyro
from holdfast.config.sensors import BaseImuConfig
from holdfast.events import Outcome
from holdfast.messages import ImuSample

CONFIG = BaseImuConfig(kind="base_imu", topic="/base", gyroscope_range=5.0, accelerometer_range=50.0, time_offset_s=0.1)
T_J_S = np.array([[1.0, 0.0, 0.0, 0.4], [0.0, 0.8, -0.6, 0.2], [0.0, 0.6, 0.8, 0.7], [0.0, 0.0, 0.0, 1.0]])
GYRO = BaseGyro(CONFIG, T_J_S)
GRAVITY = (0.0, 0.0, 9.8)


def sample(rate=(0.0, 0.0, 0.0), force=GRAVITY):
    return ImuSample(0, 0, "base_imu", np.array(rate), np.array(force))


def test_the_rate_is_that_about_the_axis():
    assert GYRO.rate(sample((7.0, 1.0, 2.0))) == pytest.approx(0.6 + 1.6)


@pytest.mark.parametrize(
    ("rate", "force", "outcome"),
    [
        ((5.0, -5.0, 0.0), (0.0, 0.0, 50.0), Outcome.USED),
        ((5.1, 0.0, 0.0), GRAVITY, Outcome.OUT_OF_RANGE),
        ((0.0, 0.0, 0.0), (0.0, -50.1, 0.0), Outcome.OUT_OF_RANGE),
        ((nan, 0.0, 0.0), GRAVITY, Outcome.NOT_FINITE),
        ((0.0, 0.0, 0.0), (0.0, 0.0, inf), Outcome.NOT_FINITE),
    ],
)
def test_a_sample_must_be_finite_and_within_the_ranges(rate, force, outcome):
    assert GYRO.check(sample(rate, force)) is outcome


def test_noise_is_that_of_the_configuration_as_variances():
    assert sqrt(GYRO.noise_variance) == pytest.approx(CONFIG.gyroscope_noise_density)
    assert sqrt(GYRO.bias_variance) == pytest.approx(CONFIG.gyroscope_bias_sigma)
    assert sqrt(GYRO.walk_variance) == pytest.approx(CONFIG.gyroscope_random_walk)
    assert (GYRO.offset_ns, GYRO.max_gap_ns) == (100_000_000, 50_000_000)
