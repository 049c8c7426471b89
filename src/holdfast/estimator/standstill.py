"""Standstill: detected from the spread of the IMU readings, never assumed."""

import numpy as np

from holdfast.config.model import StandstillConfig
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer

MAX_MEAN_RATE_RAD_S = 0.05  # turning evenly is not standing; a bias is smaller
CHANGE_SHARE = 0.1  # of the allowed spread, by which the mean may change within the window


def quiet_window(
    config: StandstillConfig, buffer: ImuBuffer, end_ns: int, length_s: float
) -> tuple[Array, Array] | None:
    """Return mean specific force [m/s^2] and angular velocity [rad/s] over the window if the IMU was quiet, else None.

    Quiet is a standard deviation below the bounds on every axis, and the same mean in both halves of the window: engine
    vibration may be stronger than the acceleration with which a machine creeps away. It cannot tell standstill from
    even motion: ask for the speed as well.
    """
    window = buffer.window(end_ns - round(length_s * 1e9), end_ns)
    if window is None:
        return None
    forces, rates = window
    means: list[Array] = []
    for readings, spread in ((forces, config.max_acceleration), (rates, config.max_angular_rate_rad_s)):
        half = len(readings) // 2
        deviation = readings.std(axis=0)
        change = abs(readings[half:].mean(axis=0) - readings[:half].mean(axis=0))
        # the mean of half a window of white noise is uncertain by deviation * sqrt(4 / N) in the difference
        allowed = spread * CHANGE_SHARE + 3.0 * deviation * np.sqrt(4.0 / len(readings))
        if deviation.max() > spread or (change > allowed).any():
            return None
        means.append(readings.mean(axis=0))
    if float(np.linalg.norm(means[1])) > MAX_MEAN_RATE_RAD_S:
        return None
    return means[0], means[1]
