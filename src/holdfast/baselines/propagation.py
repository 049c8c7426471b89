"""One IMU sample as a discrete linear model: the process model that both filters share.

x+ = f(x, u) with F = df/dx (15, 15) and process noise Q (15, 15), in the order of `holdfast.state`. State and Jacobians
come from GTSAM's preintegration of a single sample (Forster et al. 2017), which is a strapdown step.
"""

from dataclasses import dataclass

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import ImuConfig
from holdfast.messages import Array
from holdfast.sensors.preintegration import CALM, ImuNoise, MotionModel, Step, integrate, preintegration_params


@dataclass(frozen=True, slots=True)
class Tuning:
    """The tuning of a filter; docs/baselines.md gives its derivation.

    Attributes:
        acceleration: [m/s^2] average of the machine at work, for which the process noise is constant.
        angular_rate_rad_s: of its cabin.
        fix_inflation: of the variance that the receiver reports, because the errors of its fixes are not white.
        track_walk_m_per_sqrt_s: random walk of the odometry's frame V.
        track_walk_rad_per_sqrt_s: and of its attitude.
        rejects_outliers: by a chi-square test of the innovation.
    """

    acceleration: float = 0.4
    angular_rate_rad_s: float = 0.25
    fix_inflation: float = 10.0
    track_walk_m_per_sqrt_s: float = 0.01
    track_walk_rad_per_sqrt_s: float = 5e-4
    rejects_outliers: bool = True


class Propagation:
    """Carries a state over one step; leaves `F` (15, 15), `Q` (9, 9) and `walk` (6,), Q's diagonal for the biases."""

    def __init__(self, config: Config, gravity: float, tuning: Tuning) -> None:
        imu = config.imu
        self._pim = gtsam.PreintegratedImuMeasurements(
            _constant_noise(imu, config.graph.position_integration_sigma, gravity, tuning)
        )
        self._motion = MotionModel(config.motion_model, gravity)
        self._walk_density = np.repeat([imu.accelerometer_random_walk, imu.gyroscope_random_walk], 3) ** 2
        self._H_nav = np.zeros((9, 9), order="F")
        self._H_bias = np.zeros((9, 6), order="F")
        self.F = np.eye(15)
        self.Q = np.zeros((9, 9))
        self.walk = np.zeros(6)

    def advance(
        self, nav: gtsam.NavState, bias: gtsam.imuBias.ConstantBias, bias_accel: Array, bias_gyro: Array, step: Step
    ) -> gtsam.NavState:
        """Return the state after a step; `bias_accel` and `bias_gyro` (3,) are the two halves of `bias`."""
        self._pim.resetIntegrationAndSetBias(bias)
        integrate(self._pim, step, bias_accel, bias_gyro)
        return self._linearised(self._pim, nav, bias, step.dt_s)

    def coast(
        self, nav: gtsam.NavState, bias: gtsam.imuBias.ConstantBias, rate: Array, duration_s: float
    ) -> gtsam.NavState:
        """Return the state after a drop-out of the IMU, by a constant twist with `rate` (3,) [rad/s]."""
        return self._linearised(self._motion.preintegrate(duration_s, nav, rate, bias), nav, bias, duration_s)

    def _linearised(
        self,
        pim: gtsam.PreintegratedImuMeasurements,
        nav: gtsam.NavState,
        bias: gtsam.imuBias.ConstantBias,
        duration_s: float,
    ) -> gtsam.NavState:
        after = pim.predict(nav, bias, self._H_nav, self._H_bias)
        self.F[:9, :9], self.F[:9, 9:] = self._H_nav, self._H_bias
        self.Q = pim.residualCovariance()
        np.multiply(self._walk_density, duration_s, out=self.walk)
        return after


def _constant_noise(
    imu: ImuConfig, integration_sigma: float, gravity: float, tuning: Tuning
) -> gtsam.PreintegrationParams:
    """Return the noise of a machine that is always as agitated as on average: (10) in docs/math.md."""
    if tuning.acceleration == 0.0 and tuning.angular_rate_rad_s == 0.0:
        return preintegration_params(
            imu.accelerometer_noise_density, imu.gyroscope_noise_density, integration_sigma, gravity
        )
    level = gtsam.Rot3()
    force = np.array([tuning.acceleration, 0.0, gravity])
    rate = np.array([0.0, 0.0, tuning.angular_rate_rad_s])
    return ImuNoise(imu, integration_sigma, gravity).params(force, rate, level, CALM)
