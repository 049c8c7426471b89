"""Heading of a dual-antenna receiver: which headings can be believed, and the factor that they become."""

from dataclasses import dataclass
from math import atan2, cos, hypot, isfinite, radians, remainder, sin, tau

import gtsam
import numpy as np

from holdfast.config.model import HeadingConfig
from holdfast.messages import Array, Heading
from holdfast.state import Outcome

MAX_SIGMA_RAD = 1.0  # a heading that is less sure says nothing
FREE = 1e6  # sigma of what a heading says nothing about
FREE_TILT = 1e2  # [rad]; much more, and the rotated covariance could not be inverted
MIN_HORIZONTAL = 0.2  # share of the axis that must lie in the horizon


@dataclass(frozen=True, slots=True, eq=False)
class AxisYaw:
    """A checked heading: yaw in W of the measured axis, time offset applied."""

    stamp_ns: int
    sensor: str
    yaw_rad: float
    sigma_rad: float


class HeadingModel:
    """Checks, weights and factors.

    Args:
        config: of the sensor.
        baseline: (3,) from the left to the right antenna in the IMU's frame [m], or None where there are not two; it is
            the measured axis unless `mounting_yaw_deg` says otherwise.
    """

    def __init__(self, config: HeadingConfig, baseline: Array | None) -> None:
        yaw = radians(config.mounting_yaw_deg or 0.0)
        self.axis: Array = np.array([cos(yaw), sin(yaw), 0.0])
        if config.mounting_yaw_deg is None and baseline is not None:
            self.axis = baseline / np.linalg.norm(baseline)
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.correlation_s = config.correlation_s
        self.limit = config.gate_sigma**2
        self._config = config

    def check(self, heading: Heading) -> Outcome:
        """Say whether a heading can be used, by what the receiver says of it."""
        sigma = self._claim(heading)
        if not (isfinite(heading.yaw_rad) and 0.0 < sigma < float("inf")):
            return Outcome.NOT_FINITE
        return Outcome.LARGE_COVARIANCE if sigma > MAX_SIGMA_RAD else Outcome.USED

    def measured(self, heading: Heading) -> AxisYaw:
        """Return a checked heading with its noise: the claim above a floor, or the default."""
        sigma = max(self._claim(heading), radians(self._config.min_sigma_deg))
        return AxisYaw(heading.stamp_ns + self.offset_ns, heading.sensor, heading.yaw_rad, sigma)

    def _claim(self, heading: Heading) -> float:
        return radians(self._config.default_sigma_deg) if heading.sigma_rad is None else heading.sigma_rad

    def of_imu(self, measured: AxisYaw, level: gtsam.Rot3) -> tuple[float, float] | None:
        """Return the heading of the IMU's x axis and its sigma [rad], given the IMU's attitude with zero heading."""
        axis_yaw = yaw_of(level.rotate(self.axis))
        return None if axis_yaw is None else (measured.yaw_rad - axis_yaw, measured.sigma_rad)

    def innovation(self, nav: gtsam.NavState, yaw_rad: float) -> float | None:
        """Return measured minus predicted yaw of the axis [rad], within +-pi; None if the axis is near vertical."""
        predicted = yaw_of(nav.attitude().rotate(self.axis))
        return None if predicted is None else remainder(yaw_rad - predicted, tau)

    def nis(self, nav: gtsam.NavState, covariance: Array, innovation: float, sigma_rad: float) -> float:
        """Return the normalised innovation squared, given the covariance (9, 9) of the state."""
        up = nav.attitude().unrotate(np.array([0.0, 0.0, 1.0]))
        return innovation**2 / (float(up @ covariance[:3, :3] @ up) + sigma_rad**2)

    def factor(self, key: int, nav: gtsam.NavState, innovation: float, sigma_rad: float) -> gtsam.NonlinearFactor:
        """Return the factor on a node: a turn about the vertical, all else free: (30) in docs/math.md."""
        R_W_I = gtsam.Rot3.Yaw(innovation).compose(nav.attitude())
        turned = gtsam.NavState(R_W_I, nav.position(), nav.velocity())
        R = R_W_I.matrix()
        covariance = np.eye(9) * FREE**2
        covariance[:3, :3] = R.T @ np.diag([FREE_TILT**2, FREE_TILT**2, sigma_rad**2]) @ R
        return gtsam.PriorFactorNavState(key, turned, gtsam.noiseModel.Gaussian.Covariance(covariance))


def yaw_of(axis_W: Array) -> float | None:
    """Return the yaw [rad] of an axis (3,) in W, or None where it is too steep to have one."""
    return None if hypot(axis_W[0], axis_W[1]) < MIN_HORIZONTAL else atan2(axis_W[1], axis_W[0])
