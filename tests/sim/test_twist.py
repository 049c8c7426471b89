"""The simulated velocity of a frame: scale, slip, noise, resolution."""

import numpy as np
import pytest
from sampled import sampled
from scipy.spatial.transform import Rotation

from holdfast.sim.readings import generator
from holdfast.sim.scene import FrameMotion
from holdfast.sim.sensors.twist import UNKNOWN_VARIANCE, SimulatedTwist

TIMES = np.arange(0.0, 100.0, 0.05)
PERFECT = dict.fromkeys(("noise_m_s", "noise_rad_s", "scale_sigma", "slip_ratio", "resolution_m_s"), 0.0)
V_F = np.array([2.0, 0.3, -0.1])
W_F = np.array([0.01, -0.02, 0.3])


def moving(velocity=V_F):
    """A frame with a constant velocity in itself [m/s], whatever its attitude."""
    attitude = Rotation.from_euler("ZYX", np.stack([0.3 * TIMES, 0.1 + 0.0 * TIMES, np.sin(TIMES)], axis=1))
    v_W, zero = attitude.apply(velocity), np.zeros((len(TIMES), 3))
    return FrameMotion(attitude.as_matrix(), zero, v_W, zero, np.broadcast_to(W_F, (len(TIMES), 3)))


def read(seed=1, velocity=V_F, **errors):
    sheet = SimulatedTwist(kind="twist", topic="/t", frame="f", rate_hz=20.0, **PERFECT | errors)
    return sampled(sheet, moving(velocity), TIMES, generator(seed, "twist"))


def test_a_perfect_sensor_reports_the_velocity_of_its_frame_in_its_frame():
    values = read(axes=("x", "y", "z")).values
    np.testing.assert_allclose(values["linear"], np.tile(V_F, (len(TIMES), 1)), atol=1e-12)
    np.testing.assert_allclose(values["angular"], np.tile(W_F, (len(TIMES), 1)), atol=1e-12)


def test_axes_that_are_not_measured_are_zero_with_a_wide_claim():
    values = read(axes=("x",), noise_m_s=0.1, noise_rad_s=0.02).values
    np.testing.assert_array_equal(values["linear"][:, 1:], 0.0)
    assert values["linear"][:, 0].std() > 0.05
    np.testing.assert_allclose(values["covariance"][0], [0.01, UNKNOWN_VARIANCE, UNKNOWN_VARIANCE, 4e-4, 4e-4, 4e-4])


def test_noise_is_white_and_of_the_datasheets_sigma():
    values = read(axes=("x", "y", "z"), noise_m_s=0.05, noise_rad_s=0.01).values
    linear, angular = values["linear"] - V_F, values["angular"] - W_F
    np.testing.assert_allclose(linear.std(axis=0), 0.05, rtol=0.06)
    np.testing.assert_allclose(angular.std(axis=0), 0.01, rtol=0.06)
    assert np.abs(np.mean(linear[1:] * linear[:-1], axis=0)).max() < 0.08 * 0.05**2


@pytest.mark.slow
def test_the_scale_is_drawn_once_returned_and_of_the_datasheets_sigma():
    """800 runs leave 2.5 % of chance in a sigma."""
    scales = []
    for seed in range(800):
        readings = read(seed, scale_sigma=0.02)
        scales.append(readings.constants["scale"])
        np.testing.assert_allclose(readings.values["linear"][:, 0], (1.0 + scales[-1]) * V_F[0])
    assert np.std(scales) == pytest.approx(0.02, rel=0.1)
    assert abs(np.mean(scales)) < 4.0 * 0.02 / np.sqrt(800)


@pytest.mark.parametrize("speed_m_s", [0.0, 1.0, 4.0])
def test_slip_is_in_proportion_to_the_speed_and_stays_for_its_time_constant(speed_m_s):
    slips = np.array([read(s, [speed_m_s, 0, 0], slip_ratio=0.05).values["linear"][:, 0] for s in range(40)])
    slips -= speed_m_s
    assert slips.std() == pytest.approx(0.05 * speed_m_s, rel=0.1, abs=1e-12)
    if speed_m_s:
        correlation = np.mean(slips[:, 20:] * slips[:, :-20]) / np.mean(slips**2)
        assert correlation == pytest.approx(np.exp(-1.0), abs=0.1)


def test_velocities_are_multiples_of_the_resolution():
    steps = read(noise_m_s=0.02, resolution_m_s=0.01).values["linear"][:, 0] / 0.01
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.ptp(steps) > 5


def test_equal_seeds_give_equal_bytes_and_others_do_not():
    first, again, other = (read(seed, noise_m_s=0.1).values["linear"].tobytes() for seed in (3, 3, 4))
    assert first == again != other
