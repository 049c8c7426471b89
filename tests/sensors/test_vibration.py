"""The white noise that the samples show: found within a tenth, an engine left out, what is folded taken in."""

import gtsam
import numpy as np
import pytest
from motion import Drive, G, imu, machine, ns
from rig import buffered

from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import CALM, Density, ImuNoise, Step, preintegrate

DRIVING, STILL = Drive(start_s=-3.0), Drive(start_s=1000.0)
CONFIG = machine().imu


def filled(samples):
    buffer = ImuBuffer(CONFIG)
    for sample in samples:
        buffer.add(sample)
    return buffer


def shaking(hz, end_s=10.0, motion=STILL, *, amplitude, frequency_hz, since_s=0.0, until_s=np.inf):
    """An engine of one frequency that drifts by a per cent, as engines do, beside noise of 2e-3 and 2e-4."""
    rng = np.random.default_rng(2)
    samples, phase = imu(motion, 0.0, end_s, hz, rng), 0.0
    for k, sample in enumerate(samples):
        phase += 2.0 * np.pi * frequency_hz * (1.0 + 0.01 * np.sin(0.7 * k / hz)) / hz
        if since_s <= k / hz < until_s:
            sample.specific_force[:] += amplitude * np.sin(phase)
    return samples


@pytest.mark.parametrize("motion", [STILL, DRIVING], ids=["standing", "driving"])
@pytest.mark.parametrize("hz", [50.0, 100.0, 400.0])
@pytest.mark.parametrize("factor", [1.0, 10.0])
def test_white_noise_of_known_density_is_found_within_a_tenth(factor, hz, motion):
    densities = 2e-3 * factor, 2e-4 * factor
    end_s = 1.0 + 3000.0 / hz  # some 45 spectra
    found = filled(imu(motion, 0.0, end_s, hz, np.random.default_rng(1), densities)).density(ns(1.0), ns(end_s))
    assert found.accelerometer == pytest.approx(densities[0], rel=0.1)
    assert found.gyroscope == pytest.approx(densities[1], rel=0.1)


def test_a_machine_that_moves_smoothly_makes_no_noise():
    found = buffered(DRIVING, 12.0).density(ns(1.0), ns(11.0))
    assert found.accelerometer < 2e-4 and found.gyroscope < 2e-5


def test_an_engine_well_within_the_band_is_not_taken_for_noise():
    """28 Hz at 400 Hz: the samples follow it, and integrating them takes it out."""
    calm = filled(imu(STILL, 0.0, 10.0, 400.0, np.random.default_rng(2))).density(ns(1.0), ns(9.0))
    found = filled(shaking(400.0, amplitude=0.1, frequency_hz=28.0)).density(ns(1.0), ns(9.0))
    assert found.accelerometer < 1.1 * calm.accelerometer


@pytest.mark.parametrize("frequency_hz", [28.0, 72.0, 148.0])
def test_an_engine_is_a_line_and_no_noise_folded_or_not(frequency_hz):
    """At 100 Hz they look like 28, 28 and 48 Hz; each swings, and its integral is bounded."""
    calm = filled(imu(STILL, 0.0, 10.0, 100.0, np.random.default_rng(2))).density(ns(1.0), ns(9.0))
    found = filled(shaking(100.0, amplitude=1.0, frequency_hz=frequency_hz)).density(ns(1.0), ns(9.0))
    assert found.accelerometer < 1.5 * calm.accelerometer
    assert found.gyroscope == calm.gyroscope


def test_the_lines_of_an_engine_leave_room_for_the_noise_between_them():
    """Orders of 1, 1.5 and 2 of 28 Hz, the last folded to 44 Hz: half of what is looked at."""
    calm = filled(imu(STILL, 0.0, 10.0, 100.0, np.random.default_rng(2)))
    samples, phase = imu(STILL, 0.0, 10.0, 100.0, np.random.default_rng(2)), 0.0
    for k, sample in enumerate(samples):
        phase += 2.0 * np.pi * 28.0 * (1.0 + 0.01 * np.sin(0.007 * k)) / 100.0
        sample.specific_force[:] += np.sin(phase) + 0.3 * np.sin(1.5 * phase) + 0.5 * np.sin(2.0 * phase)
    seen, there = (one.density(ns(1.0), ns(9.0)).accelerometer for one in (filled(samples), calm))
    assert seen < 2.0 * there


def test_an_engine_does_not_count_as_an_acceleration():
    """An error in proportion to what swings about zero swings, too."""
    samples = shaking(100.0, 1.0, amplitude=3.0, frequency_hz=20.0)
    steps = [Step(0.01, one.specific_force, one.angular_velocity) for one in samples]
    noise, bias = ImuNoise(CONFIG, 1e-4, G), gtsam.imuBias.ConstantBias()
    calm = [one._replace(specific_force=np.array([0.0, 0.0, G])) for one in steps]
    shaken, still = (preintegrate(of[:20], noise, gtsam.Rot3(), bias).preintMeasCov() for of in (steps, calm))
    assert np.sqrt(shaken[8, 8] / still[8, 8]) < 1.1


def test_noise_beyond_half_the_rate_is_folded_and_raises_it():
    """Noise of 400 Hz, thinned to 100 Hz without a filter: four times the power per Hz, twice the density."""
    samples = imu(STILL, 0.0, 10.0, 400.0, np.random.default_rng(3), (2e-2, 2e-3))
    whole, thinned = filled(samples).density(ns(1.0), ns(9.0)), filled(samples[::4]).density(ns(1.0), ns(9.0))
    assert whole.accelerometer == pytest.approx(2e-2, rel=0.1)
    assert thinned.accelerometer == pytest.approx(4e-2, rel=0.1)


def test_it_falls_again_when_the_vibration_ends():
    rng = np.random.default_rng(2)
    samples = imu(STILL, 0.0, 12.0, 100.0, rng)
    for sample in samples[400:800]:
        sample.specific_force[:] += rng.normal(0.0, 0.5, 3)
    found = [filled(samples).density(ns(t), ns(t + 0.1)).accelerometer for t in (3.5, 6.0, 9.5)]
    assert found[1] > 10.0 * found[0]
    assert found[2] < 2.0 * found[0]


def test_a_short_time_is_judged_with_what_came_just_before_it():
    buffer = filled(imu(STILL, 0.0, 4.0, 100.0, np.random.default_rng(1)))
    assert buffer.density(ns(3.0), ns(3.01)) == buffer.density(ns(2.76), ns(3.01))


def test_gaps_do_not_disturb_it():
    """Readings differ by 5 m/s^2 across each gap."""
    samples = imu(DRIVING, 0.0, 10.0, 100.0, np.random.default_rng(1))
    for sample in samples[500:]:
        sample.specific_force[:] += 5.0
    healthy = filled(samples[:490]).density(ns(1.0), ns(4.8))
    cut = [one for k, one in enumerate(samples) if not (480 < k < 520 or 700 < k < 730)]
    found = filled(cut).density(ns(1.0), ns(10.0))
    assert found.accelerometer == pytest.approx(healthy.accelerometer, rel=0.2)
    assert found.gyroscope == pytest.approx(healthy.gyroscope, rel=0.2)


def test_without_samples_nothing_is_seen():
    buffer = ImuBuffer(CONFIG)
    assert buffer.density(ns(0.0), ns(1.0)) == CALM
    buffer.add(imu(STILL, 0.0, 0.0)[0])
    assert buffer.density(ns(0.0), ns(1.0)) == CALM


def test_forgotten_samples_leave_the_rest_as_it_was():
    buffer = filled(imu(STILL, 0.0, 30.0, 100.0, np.random.default_rng(1)))
    before = buffer.density(ns(28.0), ns(29.0))
    buffer.forget_before(ns(25.0))
    assert buffer.oldest_ns > ns(20.0)
    assert buffer.density(ns(28.0), ns(29.0)) == before


@pytest.mark.parametrize(("seen", "expected"), [(CALM, 2e-3), (Density(1e-3, 0.0), 2e-3), (Density(0.5, 0.0), 0.5)])
def test_the_larger_of_what_is_configured_and_what_is_seen_is_the_noise(seen, expected):
    noise, up = ImuNoise(CONFIG, 1e-4, G), np.array([0.0, 0.0, G])
    params = noise.params(up, np.zeros(3), gtsam.Rot3(), seen)
    np.testing.assert_allclose(np.sqrt(np.diag(params.getAccelerometerCovariance())), expected)
