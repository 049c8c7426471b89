"""A constraint instead of a sensor: the wheels of a machine slip neither sideways nor off the ground."""

from dataclasses import dataclass
from math import hypot, radians
from typing import ClassVar, Never

import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import NonholonomicConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Message
from holdfast.sensors.mount import Mount
from holdfast.sensors.sensor import CHANGE_RAD, ConstraintSensor, Innovation, Parameter, Role, State, register


@dataclass(frozen=True, slots=True, eq=False)
class NoSlip:
    """That the constraint holds at a time."""

    stamp_ns: int
    sensor: str


class NonholonomicModel(ConstraintSensor):
    """0 = v_y - psi v_x and 0 = v_z + theta v_x: (42) in docs/math.md.

    The parameter (psi, theta) [rad] is by how much the frame is turned against the direction in which the machine
    drives, about z and about y; it is learnt while something else tells the velocity.
    """

    role: ClassVar[Role] = Role.STATE
    message: ClassVar[type[Message] | None] = None

    def __init__(self, name: str, config: NonholonomicConfig, mount: Mount) -> None:
        self.name = name
        self.offset_ns = 0
        self.period_ns = round(1e9 / config.rate_hz)
        self.settings = config
        sigma_rad = radians(config.mounting_sigma_deg)
        angles = Parameter(np.zeros(2), np.full(2, sigma_rad), change=np.full(2, CHANGE_RAD))
        self.parameters = (angles,) if sigma_rad > 0.0 else ()
        self.mount = mount
        self._axes = ["xyz".index(axis) for axis in config.axes]

    def convert(self, message: Message, world: World) -> Never:
        """Refuse: there are no messages."""
        raise TypeError(f"{self.name} is a constraint, it has no messages such as {message!r} in {world!r}")

    def at(self, stamp_ns: int) -> NoSlip:
        """Return the constraint at a time."""
        return NoSlip(stamp_ns, self.name)

    def innovation(self, measured: NoSlip, state: State) -> Innovation | Outcome:  # noqa: ARG002 (it is always zero)
        """Compare with a state; beyond the turn joint its angle must be known."""
        if self.mount.is_beyond_joint and state.joint is None:
            return Outcome.NO_JOINT_ANGLE
        axes = self._axes
        v, H = self.mount.velocity(state)
        by_angles = np.array([[0.0, 0.0], [-v[0], 0.0], [0.0, v[0]]])
        psi, theta = state.parameter if state.parameter.size else (0.0, 0.0)
        aligned = np.array([[1.0, 0.0, 0.0], [-psi, 1.0, 0.0], [theta, 0.0, 1.0]])
        sigma = hypot(self.settings.sigma_m_s, self.settings.slip_ratio * float(np.linalg.norm(v)))
        J = by_angles[axes] if state.parameter.size else np.zeros((len(axes), 0))
        return Innovation(-(aligned @ v)[axes], (aligned @ H)[axes], np.eye(len(axes)) * sigma**2, J)


def _configured(name: str, section: NonholonomicConfig, config: Config) -> NonholonomicModel:
    return NonholonomicModel(name, section, Mount(config, config.frame_of(name)))


register(NonholonomicConfig, _configured)
