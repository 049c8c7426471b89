"""The base IMU: which readings can be used, and what its gyroscope says of turning about the joint's axis."""

from math import isfinite

from holdfast.config.sensors import BaseImuConfig
from holdfast.events import Outcome
from holdfast.messages import Array, ImuSample


class BaseGyro:
    """Checks and projects; noise [rad^2/s], bias [rad^2/s^2] and its walk [rad^2/s^3] are variances.

    Args:
        config: of the base IMU.
        T_J_S: (4, 4) its pose in J, the joint as it sits in the chassis.
    """

    def __init__(self, config: BaseImuConfig, T_J_S: Array) -> None:
        self.config = config
        self.T_J_S = T_J_S
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.max_gap_ns = round(config.max_gap_s * 1e9)
        self.noise_variance = config.gyroscope_noise_density**2
        self.bias_variance = config.gyroscope_bias_sigma**2
        self.walk_variance = config.gyroscope_random_walk**2
        self._ranges = (config.gyroscope_range, config.accelerometer_range)
        self._axis: list[float] = T_J_S[2, :3].tolist()  # of the joint, in S

    def check(self, sample: ImuSample) -> Outcome:
        """Say whether a sample can be used."""
        fx, fy, fz = sample.specific_force.tolist()
        wx, wy, wz = sample.angular_velocity.tolist()
        rate, force = self._ranges
        # NaN and infinity fail every comparison
        in_range = -force <= fx <= force and -force <= fy <= force and -force <= fz <= force
        if in_range and -rate <= wx <= rate and -rate <= wy <= rate and -rate <= wz <= rate:
            return Outcome.USED
        return Outcome.OUT_OF_RANGE if all(map(isfinite, (fx, fy, fz, wx, wy, wz))) else Outcome.NOT_FINITE

    def rate(self, sample: ImuSample) -> float:
        """Return how fast the chassis turns about the axis [rad/s], bias included."""
        x, y, z = sample.angular_velocity.tolist()
        a, b, c = self._axis
        return float(a * x + b * y + c * z)
