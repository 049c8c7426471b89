"""The simulated total station: errors along and across the line of sight, and its site grid."""

import numpy as np
import pytest
from sampled import sampled

from holdfast.sim.readings import generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors.prism import SimulatedPrism, in_grid

TIMES = np.arange(0.0, 200.0, 0.1)


def sheet(**values):
    return SimulatedPrism(
        **{"kind": "prism", "topic": "/p", "frame": "f", "rate_hz": 10.0, "station_m": (0, 0, 0)} | values
    )


def read(p_W, seed=1, **values):
    p_W = np.tile(p_W, (len(TIMES), 1)).astype(float)
    zero = np.zeros_like(p_W)
    moving = FrameMotion(np.tile(np.eye(3), (len(TIMES), 1, 1)), p_W, zero, zero, zero)
    return sampled(sheet(**values), moving, TIMES, generator(seed, "prism")).values


def test_a_perfect_station_reports_the_position():
    values = read([30.0, 40.0, 2.0], range_noise_m=0.0, range_noise_ppm=0.0, angle_noise_rad=0.0)
    np.testing.assert_array_equal(values["position"], np.tile([30.0, 40.0, 2.0], (len(TIMES), 1)))
    assert not values["faulty"].any()


@pytest.mark.parametrize("distance_m", [10.0, 1000.0])
def test_errors_are_those_of_the_range_along_and_of_the_direction_across_the_line_of_sight(distance_m):
    error = read([0.0, distance_m, 0.0])["error"]
    along = 3e-3 + 1.5e-6 * distance_m
    np.testing.assert_allclose(error.std(axis=0), [2.4e-5 * distance_m, along, 2.4e-5 * distance_m], rtol=0.06)
    assert np.abs(error[1:, 1] * error[:-1, 1]).mean() < along**2


@pytest.mark.parametrize("seed", range(3))
def test_claims_are_honest_on_every_axis(seed):
    values = read([300.0, 200.0, 50.0], seed, station_m=(10.0, 20.0, 1.0), angle_noise_rad=5e-5)
    np.testing.assert_allclose(values["error"].std(axis=0) / values["sigma"][0], 1.0, rtol=0.06)
    np.testing.assert_allclose(values["position"] - values["error"], np.tile([300.0, 200.0, 50.0], (len(TIMES), 1)))


def test_noise_is_white():
    error = read([0.0, 30.0, 0.0])["error"]
    correlation = np.mean(error[1:] * error[:-1], axis=0) / error.var(axis=0)
    assert np.abs(correlation).max() < 0.09


def test_a_prism_at_the_station_is_no_division_by_zero():
    assert np.isfinite(read([0.0, 0.0, 0.0])["position"]).all()


def test_the_grid_is_shifted_and_rotated_against_w():
    grid = sheet(grid_position_m=(100.0, 200.0, 5.0), grid_yaw_deg=90.0)
    np.testing.assert_allclose(in_grid(grid, np.array([[100.0, 203.0, 6.0]])), [[3.0, 0.0, 1.0]], atol=1e-12)
