"""Height of a point of the machine in W, of a laser receiver or a barometer, perhaps beside a constant."""

from dataclasses import dataclass
from math import isfinite
from typing import ClassVar

import gtsam
import numpy as np

from holdfast.config.sensors import HeightConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, Height, Message
from holdfast.sensors.sensor import Innovation, Parameter, Role, State, StateSensor, lever_arm, register

MAX_HEIGHT_M = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class PointHeight:
    """A checked height in W, time offset applied."""

    stamp_ns: int
    sensor: str
    height_m: float
    sigma_m: float


class HeightModel(StateSensor):
    """z = e_z . (p_W_I + R_W_I p_I_P) + c: (44) in docs/math.md; c is the parameter, if it is not known."""

    role: ClassVar[Role] = Role.STATE
    message: ClassVar[type[Message] | None] = Height

    def __init__(self, name: str, config: HeightConfig, p_I_P: Array) -> None:
        self.name = name
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.settings = config
        is_offset = config.offset_sigma_m > 0.0
        self.parameters = (Parameter(np.zeros(1), np.array([config.offset_sigma_m])),) if is_offset else ()
        self._p_I_P = p_I_P
        self._sigma_m = config.sigma_m

    def convert(self, message: Height, world: World) -> PointHeight | Outcome:  # noqa: ARG002 (it is a height in W)
        """Return the height with its noise, or what is wrong with it."""
        if not isfinite(message.height_m):
            return Outcome.NOT_FINITE
        if abs(message.height_m) > MAX_HEIGHT_M:
            return Outcome.OUT_OF_RANGE
        claim = message.sigma_m if message.sigma_m is not None and isfinite(message.sigma_m) else 0.0
        sigma_m = max(claim, self._sigma_m)
        return PointHeight(message.stamp_ns + self.offset_ns, self.name, message.height_m, sigma_m)

    def innovation(self, measured: PointHeight, state: State) -> Innovation | Outcome:
        """Compare with a state."""
        R_W_I = state.nav.attitude().matrix()
        H = np.zeros((1, 9))
        H[0, :3] = -(R_W_I @ gtsam.SO3.Hat(self._p_I_P))[2]
        H[0, 3:6] = R_W_I[2]
        constant = float(state.parameter[0]) if state.parameter.size else 0.0
        predicted = float(state.nav.position()[2] + R_W_I[2] @ self._p_I_P) + constant
        J = np.ones((1, 1)) if state.parameter.size else np.zeros((1, 0))
        return Innovation(np.array([measured.height_m - predicted]), H, np.array([[measured.sigma_m**2]]), J)


register(HeightConfig, lambda name, section, config: HeightModel(name, section, lever_arm(name, config)))
