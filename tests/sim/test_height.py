"""The simulated height: noise and its zero."""

import numpy as np
import pytest
from sampled import sampled

from holdfast.sim.readings import generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors.height import SimulatedHeight

TIMES = np.arange(0.0, 300.0, 0.1)
P_W = np.stack([TIMES, -TIMES, 3.0 + np.sin(TIMES)], axis=1)


def error(seed=1, **errors):
    sheet = SimulatedHeight(
        kind="height", topic="/h", frame="f", rate_hz=10.0, **{"noise_m": 0.0, "slow_m": 0.0} | errors
    )
    moving = FrameMotion(None, P_W, None, None, None)
    return sampled(sheet, moving, TIMES, generator(seed, "height")).values["height_m"] - P_W[:, 2]


def test_a_perfect_sensor_reports_the_height_in_w():
    np.testing.assert_array_equal(error(), 0.0)


def test_its_zero_is_a_constant_height_in_w():
    np.testing.assert_allclose(error(offset_m=1.5), -1.5)


def test_noise_is_white_and_of_the_datasheets_sigma():
    noise = error(noise_m=0.02)
    assert noise.std() == pytest.approx(0.02, rel=0.05)
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.08 * 0.02**2


def test_the_slow_error_stays_for_its_time_constant():
    slow = np.array([error(seed, slow_m=0.05, time_constant_s=5.0) for seed in range(60)])
    assert slow.std() == pytest.approx(0.05, rel=0.08)
    assert np.mean(slow[:, 50:] * slow[:, :-50]) == pytest.approx(np.exp(-1.0) * 0.05**2, rel=0.25)
