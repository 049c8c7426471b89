"""Standstill as the IMU and the fixes see it, and what is known of a state that was found there."""

from dataclasses import replace

import numpy as np
import pytest
from motion import Drive, G, imu, machine, ns, seconds

from holdfast.config.model import StandstillConfig
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import Position
from holdfast.sensors.standstill import ENGINE, fixes_stand, quiet_window, standstill_covariance

CONFIG = StandstillConfig()
STANDING = Drive(start_s=100.0)
END_NS = ns(2.0)
AROUND = np.array([0.0, 0.0, 0.06])


def buffered(change=lambda sample: sample):
    buffer = ImuBuffer(machine().imu)
    for sample in imu(STANDING, 0.0, 2.0, 100.0, np.random.default_rng(1)):
        buffer.add(change(sample))
    return buffer


def shaken(acceleration):
    """An engine at 28 Hz."""
    return lambda sample: replace(
        sample,
        specific_force=sample.specific_force
        + acceleration * np.sqrt(2.0) * np.sin(2.0 * np.pi * 28.0 * seconds(sample.stamp_ns)),
    )


def test_a_quiet_window_gives_the_mean_of_its_readings():
    force, rate = quiet_window(CONFIG, buffered(), END_NS, 1.0)
    true_force, true_rate = STANDING.readings(0.0)
    np.testing.assert_allclose(force, true_force, atol=5.0 * 0.02 / np.sqrt(100.0))
    np.testing.assert_allclose(rate, true_rate, atol=5.0 * 0.002 / np.sqrt(100.0))


@pytest.mark.parametrize(
    ("acceleration", "vibration", "is_quiet"), [(0.1, 1.0, True), (0.5, 1.0, False), (0.5, ENGINE, True)]
)
def test_an_engine_may_shake_the_machine_as_much_as_is_allowed(acceleration, vibration, is_quiet):
    window = quiet_window(CONFIG, buffered(shaken(acceleration)), END_NS, 1.0, vibration)
    assert (window is not None) == is_quiet


def test_a_machine_that_sets_off_within_the_window_is_not_quiet():
    def creeping(sample):
        return replace(sample, specific_force=sample.specific_force + 0.4 * (seconds(sample.stamp_ns) > 1.5))

    assert quiet_window(CONFIG, buffered(creeping), END_NS, 1.0) is None


def test_an_even_rotation_is_not_quiet():
    rotating = buffered(lambda sample: replace(sample, angular_velocity=sample.angular_velocity + AROUND))
    assert quiet_window(CONFIG, rotating, END_NS, 1.0) is None


def test_a_window_that_the_imu_has_not_measured_throughout_is_not_quiet():
    assert quiet_window(CONFIG, buffered(), END_NS, 2.5) is None


def fix(t, east_m, sigma_m=0.01):
    return Position(ns(t), "gnss", np.array([east_m, 0.0, 0.0]), np.eye(3) * sigma_m**2, 0.0)


@pytest.mark.parametrize(
    ("fixes", "stands"),
    [
        ([], None),
        ([fix(0.0, 0.0)], None),
        ([fix(0.0, 0.0, 0.02), fix(0.1, 0.0, 0.02)], None),  # too soon to tell: a slope known to 0.4 m/s
        ([fix(0.0, 0.0), fix(0.1, 0.0)], True),  # 0.2 m/s
        ([fix(0.1 * k, 0.0, 1.5) for k in range(20)], None),
        ([fix(0.1 * k, 0.0, 1.5) for k in range(50)], True),
        ([fix(0.1 * k, 0.1 * k, 1.5) for k in range(50)], False),  # 1 m/s, known to 0.2 m/s
        ([fix(0.0, 0.0), fix(1.0, 0.1)], True),  # 0.1 m/s, and noise of 0.06 m
        ([fix(0.0, 0.0), fix(1.0, 0.2)], False),
        ([fix(0.0, 0.0, 0.1), fix(1.0, 0.2, 0.1)], True),
    ],
)
def test_fixes_stand_if_they_move_by_no_more_than_their_noise(fixes, stands):
    assert fixes_stand(fixes) is stands


def test_tilt_is_as_unsure_as_the_bias_of_the_accelerometer_and_wrong_together_with_it():
    """A level machine: a bias across gravity looks like a tilt, the rotation that would explain it."""
    config = machine().imu
    up, arm = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 2.0])
    P = standstill_covariance(config, 1.0, G, up, 0.1, np.eye(3) * 0.01**2, arm)
    np.testing.assert_allclose(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0
    tilt = config.accelerometer_bias_sigma / G
    np.testing.assert_allclose(np.sqrt(np.diag(P)[:3]), [tilt, tilt, 0.1], rtol=1e-3)
    # a bias along x reads as a rotation about -y: R f + a = g up
    assert P[1, 9] == pytest.approx(-(config.accelerometer_bias_sigma**2) / G) or P[1, 9] == pytest.approx(
        config.accelerometer_bias_sigma**2 / G
    )
    # 2 m below its antenna the machine is shifted by 2 m times the tilt
    assert P[3, 3] == pytest.approx(0.01**2 + 4.0 * P[1, 1])
