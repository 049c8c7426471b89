"""Standstill: seen in the deviation of the IMU's readings and in the fixes, and what it tells of the state."""

from collections.abc import Sequence

import gtsam
import numpy as np

from holdfast.config.model import StandstillConfig
from holdfast.config.sensors import InertialConfig
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import Position

MAX_MEAN_RATE_RAD_S = 0.05  # turning evenly is not standing; a bias is smaller
CHANGE_FRACTION = 0.1  # of the allowed deviation, by which the mean may change within the window
BATCHES = 10  # parts of the window whose means are compared: an engine averages out in each, a motion does not
ENGINE = 10.0  # it may shake the machine so much more than a zero-velocity update allows, where GNSS is asked as well
STANDING_SPEED_M_S = 0.1
MIN_SPAN_NS = 200_000_000  # between fixes that tell whether the machine moves
STANDSTILL_VELOCITY_SIGMA_M_S = 0.05
GRAVITY_SIGMA_M_S2 = 1e-3  # between WGS84's normal gravity and the real one


def quiet_window(
    config: StandstillConfig, buffer: ImuBuffer, end_ns: int, length_s: float, vibration: float = 1.0
) -> tuple[Array, Array] | None:
    """Return mean specific force [m/s^2] and angular velocity [rad/s] over the window if the IMU was quiet, else None.

    Quiet is a standard deviation below the bounds on every axis, and the same mean in both halves of the window: engine
    vibration may be stronger than the acceleration with which a machine creeps away. It cannot tell standstill from
    even motion: ask for the speed as well. An engine may shake `vibration` times as much as the bounds allow, as long
    as the means of parts of the window stay within them.
    """
    window = buffer.window(end_ns - round(length_s * 1e9), end_ns)
    if window is None:
        return None
    means: list[Array] = []
    for readings, bound in zip(window, (config.max_acceleration, config.max_angular_rate_rad_s), strict=True):
        half = len(readings) // 2
        change = abs(readings[half:].mean(axis=0) - readings[:half].mean(axis=0))
        batches = np.array([part.mean(axis=0) for part in np.array_split(readings, min(BATCHES, len(readings)))])
        deviation = batches.std(axis=0, ddof=1)
        # the means of two halves differ by so much where nothing but noise and vibration differs
        allowed = bound * CHANGE_FRACTION + 3.0 * deviation * np.sqrt(4.0 / len(batches))
        if deviation.max() > bound or readings.std(axis=0).max() > vibration * bound or (change > allowed).any():
            return None
        means.append(readings.mean(axis=0))
    if float(np.linalg.norm(means[1])) > MAX_MEAN_RATE_RAD_S:
        return None
    return means[0], means[1]


def fixes_stand(fixes: Sequence[Position]) -> bool | None:
    """Whether the fixes of one antenna stand, within their noise; None while there are too few to tell.

    An even motion is as quiet as standstill: the IMU alone does not know.
    """
    if len(fixes) < 2 or fixes[-1].stamp_ns - fixes[0].stamp_ns < MIN_SPAN_NS:
        return None
    moved = float(np.linalg.norm(fixes[-1].p_W_P[:2] - fixes[0].p_W_P[:2]))
    noise = 3.0 * np.sqrt(fixes[0].covariance[:2, :2].trace() + fixes[-1].covariance[:2, :2].trace())
    return bool(moved < noise + STANDING_SPEED_M_S * (fixes[-1].stamp_ns - fixes[0].stamp_ns) * 1e-9)


def gyro_bias_sigma_rad_s(imu: InertialConfig, duration_s: float) -> float:
    """Return the standard deviation of a gyroscope bias that is the mean over a standstill."""
    return float(2.0 * imu.gyroscope_noise_density / np.sqrt(duration_s) + 1e-5)


def standstill_covariance(  # noqa: PLR0917 (one number per source of doubt)
    imu: InertialConfig,
    duration_s: float,
    gravity: float,
    up: Array,
    yaw_sigma_rad: float,
    position_covariance: Array,
    arm: Array,
) -> Array:
    """Return the covariance (15, 15) of a state found at standstill: (22) in docs/math.md.

    Tilt is known as well as the accelerometer's bias across gravity, and is wrong together with it; position is wrong
    together with attitude through the lever arm.

    Args:
        imu: whose noise and biases they are.
        duration_s: over which its readings were averaged.
        gravity: [m/s^2].
        up: (3,) unit vector of the specific force in I.
        yaw_sigma_rad: of the heading.
        position_covariance: (3, 3) of the antenna, in I [m^2].
        arm: (3,) lever arm p_I_G [m].
    """
    along = np.outer(up, up)
    across = np.eye(3) - along
    up_cross, arm_cross = gtsam.SO3.Hat(up), gtsam.SO3.Hat(arm)
    bias_sigma, noise = imu.accelerometer_bias_sigma, imu.accelerometer_noise_density / duration_s**0.5
    tilt_noise = (noise / gravity) ** 2
    P = np.zeros((15, 15))
    P[:3, :3] = ((bias_sigma / gravity) ** 2 + tilt_noise) * across + yaw_sigma_rad**2 * along
    P[9:12, 9:12] = bias_sigma**2 * across + (noise**2 + GRAVITY_SIGMA_M_S2**2) * along
    P[:3, 9:12] = bias_sigma**2 / gravity * up_cross
    P[3:6, 3:6] = position_covariance + arm_cross @ P[:3, :3] @ arm_cross.T
    P[3:6, :3] = arm_cross @ P[:3, :3]
    P[3:6, 9:12] = arm_cross @ P[:3, 9:12]
    P[6:9, 6:9] = np.eye(3) * STANDSTILL_VELOCITY_SIGMA_M_S**2
    P[12:, 12:] = np.eye(3) * gyro_bias_sigma_rad_s(imu, duration_s) ** 2
    P[:3, 3:6], P[9:12, 3:6], P[9:12, :3] = P[3:6, :3].T, P[3:6, 9:12].T, P[:3, 9:12].T
    return P
