"""What is known of the IMU's biases before a start: by the datasheet, by standstills, and by what proved wrong."""

import gtsam
import numpy as np

from holdfast.config.sensors import ImuConfig
from holdfast.graph.alignment import SAME_BIAS_RAD_S
from holdfast.graph.alignment_problem import BiasPrior
from holdfast.messages import Array
from holdfast.sensors.standstill import gyro_bias_sigma_rad_s

DRIFT_RAD_S = 1e-3  # from a standstill to the motion after it, with temperature and vibration
MOST_STANDSTILLS = 30
DOUBTED = 3.0  # times the sigma at power-on: of the bias of a gyroscope that has jumped


class KnownBiases:
    """The prior of the biases.

    Args:
        imu: its configuration.
        standstill_s: over which a standstill is averaged [s].
    """

    def __init__(self, imu: ImuConfig, standstill_s: float) -> None:
        at_power_on = np.repeat([imu.accelerometer_bias_sigma, imu.gyroscope_bias_sigma], 3)
        self.prior = BiasPrior(gtsam.imuBias.ConstantBias(), at_power_on)
        self.doubted: Array = at_power_on * np.repeat([1.0, DOUBTED], 3)
        gyroscope = gyro_bias_sigma_rad_s(imu, standstill_s) + DRIFT_RAD_S
        self._at_standstill = np.repeat([imu.accelerometer_bias_sigma, gyroscope], 3)
        self._standstills = 0  # that have this bias, less those that have another

    def note_standstill(self, bias: gtsam.imuBias.ConstantBias) -> None:
        """Keep the mean over standstills; what most others contradict was an even motion."""
        change: Array = (bias - self.prior.bias).vector()
        if self._standstills and np.linalg.norm(change[3:]) > SAME_BIAS_RAD_S:
            self._standstills -= 1
            return
        self._standstills = min(self._standstills + 1, MOST_STANDSTILLS)
        mean: Array = self.prior.bias.vector() + change / self._standstills
        self.prior = BiasPrior(gtsam.imuBias.ConstantBias(mean[:3], mean[3:]), self._at_standstill)

    def doubt(self, bias: gtsam.imuBias.ConstantBias | None = None) -> None:
        """Doubt what standstills have told, for what it led to has proved wrong; a bias is believed as far as that."""
        self._standstills = 0
        self.prior = BiasPrior(self.prior.bias if bias is None else bias, self.doubted)
