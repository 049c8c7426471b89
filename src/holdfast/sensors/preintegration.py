"""How samples of the IMU become preintegrated measurements, and with what noise.

A drop-out of the IMU is crossed by a constant-twist motion model in the form of such a measurement.
"""

from math import hypot, sqrt
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import MotionModelConfig
from holdfast.config.sensors import InertialConfig
from holdfast.kernel.propagation import MAX_MOTION_STEPS, MOTION_STEP_S
from holdfast.messages import Array

MOTION_INTEGRATION_SIGMA = 0.1  # of position where the motion model stands in [m/sqrt(s)]
MOTION_CORRELATION_S = 1.0  # of the error that is proportional to the motion
LEAST_DENSITY, LEAST_RATIO = 5e-5, 3e-4  # of a gyroscope, whatever is learnt: [rad/s/sqrt(Hz)] and of the turning
LEAST_FORCE_RATIO = 1e-3  # of an accelerometer
EYE = np.eye(3)


def preintegration_params(
    accelerometer_density: float, gyroscope_density: float, integration_sigma: float, gravity: float
) -> gtsam.PreintegrationParams:
    """Return GTSAM's parameters from continuous-time densities; W is east, north, up.

    The small integration covariance gives a one-sample factor full rank: (9) in docs/math.md.
    """
    params = gtsam.PreintegrationParams.MakeSharedU(gravity)
    params.setAccelerometerCovariance(EYE * accelerometer_density**2)
    params.setGyroscopeCovariance(EYE * gyroscope_density**2)
    params.setIntegrationCovariance(EYE * integration_sigma**2)
    return params


class Density(NamedTuple):
    """White noise of an IMU: accelerometer [m/s^2/sqrt(Hz)] and gyroscope [rad/s/sqrt(Hz)]."""

    accelerometer: float
    gyroscope: float


CALM = Density(0.0, 0.0)


class ImuNoise:
    """The noise of preintegrated measurements: its density, and an error that grows with the motion.

    The density is the datasheet's, or that which the samples show if it is larger: vibration beyond half the sampling
    rate is folded into the band. Scale factor and misalignment make a reading wrong in proportion to itself; over
    `MOTION_CORRELATION_S` that is like white noise: (10) in docs/math.md.
    """

    def __init__(self, config: InertialConfig, integration_sigma: float, gravity: float) -> None:
        self.config = config
        self._integration_sigma = integration_sigma
        self._up = np.array([0.0, 0.0, gravity])
        self.gravity = gravity
        self.density = Density(config.accelerometer_noise_density, config.gyroscope_noise_density)
        self.force_scale = 1.0  # how many times larger the accelerometer's error in proportion is, as has been learnt
        self.yaw_scale = 1.0  # how many times larger the gyroscope's noise is about the vertical, as has been learnt
        self.walk_scale = 1.0  # how many times faster the biases walk, as contradictions have shown
        self._rate_error = config.gyroscope_error_ratio * sqrt(MOTION_CORRELATION_S)

    def params(
        self, specific_force: Array, rate: Array, attitude: gtsam.Rot3, seen: Density
    ) -> gtsam.PreintegrationParams:
        """Return the parameters while the machine, at attitude R_W_I, senses (3,) [m/s^2] and (3,) [rad/s]."""
        config = self.config
        fx, fy, fz = specific_force.tolist()
        up = attitude.unrotate(self._up)
        ux, uy, uz = up.tolist()
        ax, ay, az = fx - ux, fy - uy, fz - uz
        wx, wy, wz = rate.tolist()
        force_ratio = _scaled(config.accelerometer_error_ratio, self.force_scale, LEAST_FORCE_RATIO)
        turning = sqrt(wx * wx + wy * wy + wz * wz)
        params = preintegration_params(
            hypot(
                max(config.accelerometer_noise_density, seen.accelerometer),
                force_ratio * sqrt(MOTION_CORRELATION_S * (ax * ax + ay * ay + az * az)),
            ),
            hypot(max(config.gyroscope_noise_density, seen.gyroscope), self._rate_error * turning),
            self._integration_sigma,
            self.gravity,
        )
        if self.yaw_scale != 1.0:
            white = _scaled(config.gyroscope_noise_density, self.yaw_scale, LEAST_DENSITY)
            ratio = _scaled(config.gyroscope_error_ratio, self.yaw_scale, LEAST_RATIO)
            about_up = max(white, seen.gyroscope) ** 2 + (ratio * turning) ** 2 * MOTION_CORRELATION_S
            isotropic = params.getGyroscopeCovariance()
            excess = (about_up - isotropic[0, 0]) / self.gravity**2
            params.setGyroscopeCovariance(isotropic + excess * np.outer(up, up))
        return params

    def rotation_variance(self, rotation_rad: float, duration_s: float) -> float:
        """Return the configured variance [rad^2] per axis of an even rotation: white noise, (10) in docs/math.md."""
        return self.density.gyroscope**2 * duration_s + (self._rate_error * rotation_rad) ** 2 / duration_s


def _scaled(configured: float, scale: float, least: float) -> float:
    """Return a sigma as it has been learnt: no smaller than any sensor's, unless it is configured so."""
    return max(scale * configured, min(configured, least))


class Step(NamedTuple):
    """A stretch of IMU data with its mean readings, specific force (3,) [m/s^2] and angular velocity (3,) [rad/s]."""

    dt_s: float
    specific_force: Array
    angular_velocity: Array


def integrate(pim: gtsam.PreintegratedImuMeasurements, step: Step, bias_accel: Array, bias_gyro: Array) -> None:
    """Add a step to a preintegrated measurement, the specific force turned to the middle of the step.

    GTSAM rotates a reading by the attitude at the start of its step, which is wrong by half a step of turning (1.7 m
    after 10 s at 1 rad/s, tilted, and 100 Hz): (4) in docs/math.md. The biases are (3,) [m/s^2] and [rad/s].
    """
    dt_s, force, sensed = step
    turn = gtsam.Rot3.Expmap(0.5 * dt_s * (sensed - bias_gyro))
    pim.integrateMeasurement(turn.rotate(force - bias_accel) + bias_accel, sensed, dt_s)


def preintegrate(
    steps: list[Step],
    noise: ImuNoise,
    attitude: gtsam.Rot3,
    bias: gtsam.imuBias.ConstantBias,
    seen: Density = CALM,
) -> gtsam.PreintegratedImuMeasurements:
    """Preintegrate consecutive steps (Forster et al. 2017, Eqs. 35-38 and 63); `attitude` is R_W_I at their start."""
    bias_accel, bias_gyro = bias.accelerometer(), bias.gyroscope()
    lengths_s = np.array([one.dt_s for one in steps])
    force = lengths_s @ np.array([one.specific_force for one in steps]) / lengths_s.sum()
    rate = lengths_s @ np.array([one.angular_velocity for one in steps]) / lengths_s.sum()
    params = noise.params(force - bias_accel, rate - bias_gyro, attitude, seen)
    return preintegrate_with(params, steps, bias)


def preintegrate_with(
    params: gtsam.PreintegrationParams, steps: list[Step], bias: gtsam.imuBias.ConstantBias
) -> gtsam.PreintegratedImuMeasurements:
    """Preintegrate consecutive steps with given parameters."""
    bias_accel, bias_gyro = bias.accelerometer(), bias.gyroscope()
    pim = gtsam.PreintegratedImuMeasurements(params, bias)
    for step in steps:
        integrate(pim, step, bias_accel, bias_gyro)
    return pim


class MotionModel:
    """Constant twist in place of a silent IMU, as a preintegrated pseudo-measurement with loose noise.

    Body velocity and angular rate stay what they are; the departure from that is white acceleration and white angular
    rate: (12) in docs/math.md. It has the form of an IMU factor, so that position and velocity stay correlated.

    Args:
        config: densities of both.
        gravity: magnitude [m/s^2].

    Attributes:
        angular_rate_density: as configured [rad/s/sqrt(Hz)].
    """

    def __init__(self, config: MotionModelConfig, gravity: float) -> None:
        self._config, self._gravity = config, gravity
        self.angular_rate_density = config.angular_rate_density

    def preintegrate(
        self,
        duration_s: float,
        nav: gtsam.NavState,
        rate: Array,
        bias: gtsam.imuBias.ConstantBias,
        turning: Array | None = None,
    ) -> gtsam.PreintegratedImuMeasurements:
        """Return the pseudo-measurement from state `nav` on.

        Args:
            duration_s: how long it lasts.
            nav: at its start.
            rate: (3,) angular velocity of I [rad/s].
            bias: of the IMU.
            turning: (3, 3) density of the departure from that rate [rad^2/s]; None: as configured.
        """
        params = preintegration_params(
            self._config.acceleration_density, self.angular_rate_density, MOTION_INTEGRATION_SIGMA, self._gravity
        )
        if turning is not None:
            params.setGyroscopeCovariance(turning)
        pim = gtsam.PreintegratedImuMeasurements(params, bias)
        n = min(max(1, round(duration_s / MOTION_STEP_S)), MAX_MOTION_STEPS)
        dt_s = duration_s / n
        centripetal = np.cross(rate, nav.bodyVelocity())
        up = np.array([0.0, 0.0, self._gravity])
        attitude = nav.attitude().compose(gtsam.Rot3.Expmap(0.5 * dt_s * rate))
        turn = gtsam.Rot3.Expmap(dt_s * rate)
        bias_accel, bias_gyro = bias.accelerometer(), bias.gyroscope()
        for _ in range(n):
            force = centripetal + attitude.unrotate(up)
            integrate(pim, Step(dt_s, force + bias_accel, rate + bias_gyro), bias_accel, bias_gyro)
            attitude = attitude.compose(turn)
        return pim
