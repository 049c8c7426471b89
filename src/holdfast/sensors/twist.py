"""Velocity of wheels or tracks: a body velocity of which some axes are used, and a scale factor that is estimated."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from holdfast.config.sensors import TwistConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, Message, Twist
from holdfast.sensors.mount import Mount
from holdfast.sensors.sensor import Innovation, Parameter, Role, State, StateSensor, claimed_covariance, register

MAX_SPEED_M_S = 100.0
SCALE_CHANGE = 0.005  # by which rolling radii change until the next day


@dataclass(frozen=True, slots=True, eq=False)
class BodyVelocity:
    """A checked velocity (3,) of the sensor's frame in its own axes [m/s], with covariance (3, 3), offset applied."""

    stamp_ns: int
    sensor: str
    velocity: Array
    covariance: Array


class TwistModel(StateSensor):
    """z = (1 + k) v_S on the axes in use: (41) in docs/math.md; k is the parameter, unless it is known."""

    role: ClassVar[Role] = Role.STATE
    message: ClassVar[type[Message] | None] = Twist

    def __init__(self, name: str, config: TwistConfig, mount: Mount) -> None:
        self.name = name
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.settings = config
        is_scaled = config.scale_sigma > 0.0
        scale = Parameter(np.zeros(1), np.array([config.scale_sigma]), change=np.array([SCALE_CHANGE]))
        self.parameters = (scale,) if is_scaled else ()
        self.mount = mount
        self._axes = ["xyz".index(axis) for axis in config.axes]

    def convert(self, message: Twist, world: World) -> BodyVelocity | Outcome:  # noqa: ARG002 (it needs no W)
        """Return the velocity with its noise, or what is wrong with it."""
        used = message.linear[self._axes]
        if not np.isfinite(used).all():
            return Outcome.NOT_FINITE
        if abs(used).max() > MAX_SPEED_M_S:
            return Outcome.OUT_OF_RANGE
        claim = None if message.covariance is None else message.covariance[3:, 3:]
        covariance = claimed_covariance(claim, np.full(3, self.settings.sigma_m_s))
        return BodyVelocity(message.stamp_ns + self.offset_ns, self.name, message.linear, covariance)

    def innovation(self, measured: BodyVelocity, state: State) -> Innovation | Outcome:
        """Compare with a state; beyond the turn joint its angle must be known."""
        if self.mount.is_beyond_joint and state.joint is None:
            return Outcome.NO_JOINT_ANGLE
        axes = self._axes
        v, H = self.mount.velocity(state)
        scale = 1.0 + (state.parameter[0] if state.parameter.size else 0.0)
        slip = self.settings.slip_ratio * float(np.linalg.norm(v))
        R = measured.covariance[np.ix_(axes, axes)] + np.eye(len(axes)) * slip**2
        J = v[axes, None] if state.parameter.size else np.zeros((len(axes), 0))
        return Innovation(measured.velocity[axes] - scale * v[axes], scale * H[axes], R, J)


register(TwistConfig, lambda name, section, config: TwistModel(name, section, Mount(config, config.frame_of(name))))
