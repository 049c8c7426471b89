"""Heading of a dual-antenna receiver: which headings can be used, and the factor that they become.

By how much the measured axis is mounted otherwise is a constant that the graph estimates (97): a baseline that nobody
has surveyed, a compass beside iron, magnetic north. It is held near zero until it proves to be far off.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from math import atan2, cos, degrees, hypot, isfinite, pi, radians, remainder, sin, tau
from typing import ClassVar

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import GnssConfig, HeadingConfig
from holdfast.errors import ConfigError
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, Heading, Message
from holdfast.sensors.noise import FREE_TILT_RAD, FREE_VARIANCE, Colour
from holdfast.sensors.sensor import (
    Innovation,
    Parameter,
    Role,
    State,
    StateSensor,
    innovation_factor,
    lever_arm,
    register,
)

MAX_SIGMA_RAD = 1.0  # a heading that is less sure says nothing
MIN_HORIZONTAL = 0.2  # fraction of the axis that must lie in the horizon
MOUNT = "mount"  # which parameter of a sensor it is
IF_RIGHT_RAD = radians(0.3)  # of a mounting that was measured
MOUNT_ODDS = 1e4  # about five sigmas: what a model leaves unexplained turns an estimate, too


@dataclass(frozen=True, slots=True, eq=False)
class AxisYaw:
    """A checked heading: yaw in W of the measured axis, time offset applied; `colour` is that of its error."""

    stamp_ns: int
    sensor: str
    yaw_rad: float
    sigma_rad: float
    colour: Colour | None = None


class HeadingModel(StateSensor):
    """One heading; `axis` is the measured axis in the IMU's frame.

    Args:
        name: of the sensor.
        config: of the sensor.
        arms: lever arms (3,) [m] of the antennas by name, in the order of the baseline; where there are two, the
            baseline is the measured axis unless `mounting_yaw_deg` says otherwise.

    Raises:
        ConfigError: the baseline has no length.
    """

    role: ClassVar[Role] = Role.HEADING
    message: ClassVar[type[Message] | None] = Heading

    def __init__(self, name: str, config: HeadingConfig, arms: Mapping[str, Array]) -> None:
        self.name = name
        yaw = radians(config.mounting_yaw_deg or 0.0)
        self.axis: Array | None = np.array([cos(yaw), sin(yaw), 0.0])
        self.turned_rad = 0.0
        self.antennas: tuple[str, ...] = ()  # whose lever arms are the axis
        if config.mounting_yaw_deg is None and len(arms) == 2:
            start, end = arms.values()
            baseline = end - start
            length_m = float(np.linalg.norm(baseline))
            if length_m == 0.0:
                raise ConfigError(f"sensors.{name}: the two antennas of its baseline sit at one place")
            self.axis, self.antennas = baseline / length_m, tuple(arms)
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.settings = config
        self._colour = Colour(0.5, 0.5, config.slow_time_constant_s) if config.slow_size else None
        self.parameters = (_measured_mount(config.mounting_sigma_deg),) if config.mounting_sigma_deg > 0.0 else ()
        self.offset_sigma_s = config.time_offset_sigma_s

    def turned(self, by_rad: float) -> "HeadingModel":
        """Return a model of the same sensor whose axis is known to be turned by so much from where it is configured."""
        other = copy(self)
        other.turned_rad, other.parameters = by_rad, ()
        return other

    def without_axis(self) -> "HeadingModel":
        """Return a model of the same sensor whose axis is not known: its headings tell nothing."""
        other = copy(self)
        other.axis = None
        return other

    def reversed(self) -> "HeadingModel":
        """Return a model of the same sensor whose axis points the other way."""
        other = copy(self)
        other.axis = None if self.axis is None else -self.axis
        return other

    def is_opposite(self, measured: AxisYaw, attitude: gtsam.Rot3) -> bool:
        """Whether the axis points the other way than an attitude says."""
        axis_yaw = None if self.axis is None else yaw_of(attitude.rotate(self.axis))
        return axis_yaw is not None and cos(measured.yaw_rad - axis_yaw) < 0.0

    def convert(self, heading: Heading, world: World) -> AxisYaw | Outcome:
        """Return the heading with its noise, the claim above a floor or the default; or what is wrong with it."""
        claim = radians(self.settings.default_sigma_deg) if heading.sigma_rad is None else heading.sigma_rad
        if not (isfinite(heading.yaw_rad) and 0.0 < claim < float("inf")):
            return Outcome.NOT_FINITE
        if claim > MAX_SIGMA_RAD:
            return Outcome.LARGE_COVARIANCE
        sigma = max(claim, radians(self.settings.min_sigma_deg))
        yaw_rad = 0.5 * pi - heading.yaw_rad if self.settings.clockwise else heading.yaw_rad
        east, north, _ = world.axes @ [cos(yaw_rad), sin(yaw_rad), 0.0]
        return AxisYaw(heading.stamp_ns + self.offset_ns, self.name, atan2(north, east), sigma, self._colour)

    def of_imu(self, measured: AxisYaw, level: gtsam.Rot3) -> tuple[float, float] | None:
        """Return the heading of the IMU's x axis and its sigma [rad], given the IMU's attitude with zero heading."""
        axis_yaw = None if self.axis is None else yaw_of(level.rotate(self.axis))
        return None if axis_yaw is None else (measured.yaw_rad - self.turned_rad - axis_yaw, measured.sigma_rad)

    def innovation(self, measured: AxisYaw, state: State) -> Innovation | Outcome:
        """Compare with a state: measured minus predicted yaw of the axis, within +-pi; not if it is near vertical."""
        if self.axis is None:
            return Outcome.BASELINE
        predicted = yaw_of(state.nav.attitude().rotate(self.axis))
        if predicted is None:
            return Outcome.OUT_OF_RANGE
        H = np.zeros((1, 9))
        H[0, :3] = state.nav.attitude().unrotate(np.array([0.0, 0.0, 1.0]))
        turned_rad = float(state.parameter[0]) if self.parameters else self.turned_rad
        y = np.array([remainder(measured.yaw_rad - turned_rad - predicted, tau)])
        return Innovation(y, H, np.array([[measured.sigma_rad**2]]), np.ones((1, len(self.parameters))))

    def factor(
        self,
        keys: Sequence[int],
        measured: AxisYaw,
        state: State,
        innovation: Innovation,
        inflation: float,
    ) -> gtsam.NonlinearFactor:
        """Return the factor on a node, and on the mounting if that is estimated.

        Where it is known, it is a rotation about the vertical, all else free: (30) in docs/math.md.
        """
        if self.parameters:
            return innovation_factor(self, keys, measured, state, innovation.R * inflation)
        R_W_I = gtsam.Rot3.Yaw(float(innovation.y[0])).compose(state.nav.attitude())
        rotated = gtsam.NavState(R_W_I, state.nav.position(), state.nav.velocity())
        R = R_W_I.matrix()
        covariance = np.eye(9) * FREE_VARIANCE
        yaw_variance = float(innovation.R[0, 0]) * inflation
        covariance[:3, :3] = R.T @ np.diag([FREE_TILT_RAD**2, FREE_TILT_RAD**2, yaw_variance]) @ R
        return gtsam.PriorFactorNavState(keys[0], rotated, gtsam.noiseModel.Gaussian.Covariance(covariance))


def _measured_mount(sigma_deg: float) -> Parameter:
    """Return the angle by which an axis is turned, which is as it was measured, or far off."""
    if_right = np.array([IF_RIGHT_RAD])
    sigmas = np.maximum(np.radians([sigma_deg]), if_right)
    return Parameter(np.zeros(1), sigmas, if_right, part=MOUNT, change=if_right, odds=MOUNT_ODDS, held=1.0)


def yaw_of(axis_W: Array) -> float | None:
    """Return the yaw [rad] of an axis (3,) in W, or None where it is too steep to have one."""
    return None if hypot(axis_W[0], axis_W[1]) < MIN_HORIZONTAL else atan2(axis_W[1], axis_W[0])


def configured_yaw_deg(name: str, config: Config) -> float:
    """Return the yaw of the measured axis in the IMU's frame: `mounting_yaw_deg`, or that of the baseline."""
    axis = _configured(name, config.sensors_of(HeadingConfig)[name], config).axis
    assert axis is not None
    return degrees(atan2(axis[1], axis[0]))


def _configured(name: str, section: HeadingConfig, config: Config) -> HeadingModel:
    antennas = section.baseline or tuple(config.sensors_of(GnssConfig))[:2]
    return HeadingModel(name, section, {one: lever_arm(one, config) for one in antennas})


register(HeadingConfig, _configured)
