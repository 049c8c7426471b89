"""The simulated encoder of the turn joint."""

import numpy as np
import pytest
from sampled import sampled

from holdfast.sim.readings import generator
from holdfast.sim.sensors.joint import SimulatedJoint
from holdfast.sim.transport import sample_times_s

TIMES = sample_times_s(50.0, 20.0)
ANGLES = 0.6 * TIMES - 3.0


def joint(**errors):
    """An encoder with the named errors only."""
    perfect = {"bias_sigma_rad": 0.0, "noise_rad": 0.0, "resolution_rad": 0.0}
    return SimulatedJoint(kind="joint", topic="/joint", frame="cabin", rate_hz=50.0, **(perfect | errors))


def read(seed=1, **errors):
    readings = sampled(joint(**errors), None, TIMES, generator(seed, "joint"), joint_rad=ANGLES)
    return readings.values["angle_rad"], readings.constants["zero_offset_rad"]


def test_a_perfect_encoder_reads_the_angle_beyond_half_a_revolution():
    readings = sampled(joint(), None, TIMES, generator(1, "joint"), joint_rad=ANGLES)
    assert np.array_equal(readings.times_s, TIMES)
    assert np.array_equal(readings.values["angle_rad"], ANGLES)
    assert ANGLES.max() > np.pi
    assert readings.constants == {"zero_offset_rad": 0.0}


def test_bias_is_constant_returned_and_of_the_datasheets_sigma():
    """800 runs leave 2.5 % of chance in a sigma."""
    biases = []
    for seed in range(800):
        angles, bias = read(seed, bias_sigma_rad=2e-3)
        assert np.array_equal(angles, ANGLES + bias)
        biases.append(bias)
    assert np.std(biases) == pytest.approx(2e-3, rel=0.1)
    assert abs(np.mean(biases)) < 4.0 * 2e-3 / np.sqrt(800)


def test_noise_is_white_and_of_the_datasheets_sigma():
    """20 runs of 1000 readings leave 0.5 % of chance in a sigma and 0.7 % in a correlation."""
    errors = np.array([read(seed, noise_rad=2e-4)[0] - ANGLES for seed in range(20)])
    assert errors.std() == pytest.approx(2e-4, rel=0.025)
    assert abs(np.mean(errors[:, 1:] * errors[:, :-1])) < 0.03 * errors.var()


def test_readings_are_multiples_of_the_resolution_and_nearest_to_what_was_sensed():
    step = 3.83e-4
    fine, _ = read(bias_sigma_rad=2e-3, noise_rad=2e-4)
    coarse, _ = read(bias_sigma_rad=2e-3, noise_rad=2e-4, resolution_rad=step)
    assert coarse / step == pytest.approx(np.round(coarse / step), abs=1e-6)
    assert 0.4 * step < np.abs(coarse - fine).max() <= step / 2.0 + 1e-12


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    errors = {"bias_sigma_rad": 2e-3, "noise_rad": 2e-4, "resolution_rad": 3.83e-4}
    assert read(5, **errors)[0].tobytes() == read(5, **errors)[0].tobytes()
    assert not np.array_equal(read(5, **errors)[0], read(6, **errors)[0])
