"""The simulated Doppler velocity: error, correlation, claim, sky."""

import numpy as np
import pytest
from sampled import sampled

from holdfast.sim.readings import generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors.gnss_velocity import SimulatedGnssVelocity

TIMES = np.arange(0.0, 4000.0, 0.2)
V_W = np.array([3.0, -2.0, 0.1])


def read(seed=1, open_sky=1.0, **settings):
    still = np.zeros((len(TIMES), 3))
    moving = FrameMotion(np.tile(np.eye(3), (len(TIMES), 1, 1)), still, still + V_W, still, still)
    sheet = SimulatedGnssVelocity(kind="gnss_velocity", topic="/v", frame="f", rate_hz=5.0, **settings)
    return sampled(sheet, moving, TIMES, generator(seed, "doppler"), open_sky=open_sky)


def test_without_noise_it_is_the_velocity_of_the_antenna_in_the_world():
    np.testing.assert_array_equal(read(white_m_s=0.0, slow_m_s=0.0).values["velocity"], np.tile(V_W, (len(TIMES), 1)))


def test_its_errors_are_those_of_the_datasheet_and_of_an_honest_claim_and_twice_as_large_upwards():
    values = read(white_m_s=0.03, slow_m_s=0.04).values
    np.testing.assert_allclose(values["sigma"][0], [0.05, 0.05, 0.1])
    np.testing.assert_allclose((values["velocity"] - V_W).std(axis=0), values["sigma"][0], rtol=0.05)
    np.testing.assert_allclose(read(claim_ratio=0.5).values["sigma"], 0.5 * read().values["sigma"])


def test_the_slow_part_decorrelates_in_its_time_constant():
    error = read(white_m_s=0.0, slow_m_s=0.05, time_constant_s=2.0).values["velocity"] - V_W
    lag = 10  # 2 s
    correlation = np.mean(error[lag:] * error[:-lag], axis=0) / np.mean(error**2, axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1.0), atol=0.08)


@pytest.mark.parametrize(("open_sky", "count"), [(0.11, 0), (0.2, len(TIMES))])
def test_without_sky_there_is_none(open_sky, count):
    assert len(read(open_sky=open_sky).times_s) == count


def test_equal_seeds_give_equal_bytes_and_others_do_not():
    first, again, other = (read(seed).values["velocity"].tobytes() for seed in (3, 3, 4))
    assert first == again != other
