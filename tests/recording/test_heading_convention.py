"""A heading that counts clockwise is found by the gyroscope, whatever its zero and the mounting of the IMU."""

import numpy as np
import pytest
from driven import driven, standing, straight, turning

from holdfast.recording.heading_convention import is_clockwise


def headings(motion, sign, rate_hz, zero_rad=0.0):
    t = np.arange(0.0, 100.0, 1.0 / rate_hz)
    noise = np.random.default_rng(0).normal(size=len(t)) * 0.01
    return t, np.angle(np.exp(1j * (sign * motion(t)[1] + zero_rad + noise)))


@pytest.mark.parametrize("rate_hz", [1, 20])
@pytest.mark.parametrize("zero_rad", [0.0, np.pi / 2.0, 3.0])
def test_a_clockwise_heading_is_found_and_no_other(rate_hz, zero_rad):
    imu = driven(turning)
    assert is_clockwise(*imu, *headings(turning, -1.0, rate_hz, zero_rad))
    assert not is_clockwise(*imu, *headings(turning, 1.0, rate_hz, zero_rad))
    assert not is_clockwise(*imu, *headings(turning, 0.0, rate_hz, zero_rad))


@pytest.mark.parametrize("motion", [straight, standing])
def test_without_turns_nothing_is_said(motion):
    assert not is_clockwise(*driven(motion), *headings(motion, -1.0, 20))


def test_nor_with_few_messages():
    t, yaw = headings(turning, -1.0, 1)
    assert not is_clockwise(*driven(turning), t[:8], yaw[:8])
    assert not is_clockwise(*driven(turning), t[:0], yaw[:0])
    assert not is_clockwise(np.empty(0), np.empty((0, 6)), t, yaw)
