"""Standstill: seen in the deviation of the IMU's readings and in the fixes, and what it tells of the state."""

from collections.abc import Sequence

import gtsam
import numpy as np

from holdfast.config.model import StandstillConfig
from holdfast.config.sensors import InertialConfig
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import Position, Velocity

MAX_MEAN_RATE_RAD_S = 0.05  # turning evenly is not standing; a bias is smaller
CHANGE_FRACTION = 0.1  # of the allowed deviation, by which the mean may change within the window
BATCHES = 10  # parts of the window whose means are compared: an engine averages out in each, a motion does not
ENGINE = 10.0  # it may shake the machine so much more than a zero-velocity update allows, where GNSS is asked as well
STANDING_SPEED_M_S = 0.1
TELLING_SIGMA_M_S = 0.3  # of a speed that tells whether the machine moves
MAX_CLAIM_M_S = 0.35  # of a Doppler velocity that does
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
        # by neighbours: the deviation about the mean would grow with the change that is looked for
        noise = np.sqrt(np.mean(np.diff(batches, axis=0) ** 2, axis=0) / 2.0)
        # the means of two halves differ by so much where nothing but noise and vibration differs
        allowed = bound * CHANGE_FRACTION + 3.0 * noise * np.sqrt(4.0 / len(batches))
        if (
            batches.std(axis=0, ddof=1).max() > bound
            or readings.std(axis=0).max() > vibration * bound
            or (change > allowed).any()
        ):
            return None
        means.append(readings.mean(axis=0))
    if float(np.linalg.norm(means[1])) > MAX_MEAN_RATE_RAD_S:
        return None
    return means[0], means[1]


def fixes_stand(fixes: Sequence[Position]) -> bool | None:
    """Whether the fixes of one antenna stand, within their noise; None while they cannot tell.

    An even motion is as quiet as standstill: the IMU alone does not know.
    """
    if len(fixes) < 2:
        return None
    t = np.array([one.stamp_ns - fixes[0].stamp_ns for one in fixes]) * 1e-9
    t -= t.mean()
    sigma = float(np.sqrt(np.mean([one.covariance[:2, :2].trace() for one in fixes]) / max(t @ t, 1e-9)))
    if sigma > TELLING_SIGMA_M_S:
        return None
    slope = t @ np.array([one.p_W_P[:2] for one in fixes]) / (t @ t)
    return bool(np.linalg.norm(slope) < STANDING_SPEED_M_S + 2.0 * sigma)


def velocities_stand(velocities: Sequence[Velocity]) -> bool | None:
    """Whether measured velocities are zero within their noise; None while they cannot tell.

    Their errors last as long as the stretch that is asked about: the mean is no better than each.
    """
    known = [one for one in velocities if one.covariance[:2, :2].max() < MAX_CLAIM_M_S**2]
    if not known:
        return None
    sigma = float(np.sqrt(np.mean([one.covariance[:2, :2].trace() for one in known]) / 2.0))
    mean = np.mean([one.v_W_P[:2] for one in known], axis=0)
    return bool(np.linalg.norm(mean) < STANDING_SPEED_M_S + sigma)


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
