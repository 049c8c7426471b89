"""A prism that a robotic total station follows: positions in the station's site grid, and how they lie in W."""

from collections.abc import Sequence
from math import radians
from typing import ClassVar

import gtsam
import numpy as np

from holdfast.config.sensors import PrismConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, Message, PointPosition
from holdfast.sensors.position import position_factor, position_innovation
from holdfast.sensors.sensor import (
    ANYWHERE,
    Innovation,
    Parameter,
    Position,
    Role,
    State,
    claimed_covariance,
    lever_arm,
    register,
)

MAX_DISTANCE_M = 1e5


class PrismModel:
    """One prism; `p_I_P` (3,) [m] is its lever arm in the IMU's frame."""

    role: ClassVar[Role] = Role.POSITION
    message: ClassVar[type[Message] | None] = PointPosition
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, name: str, config: PrismConfig, p_I_P: Array) -> None:
        self.name = name
        self.offset_ns = round((config.time_offset_s - config.latency_s) * 1e9)
        self.p_I_P = p_I_P
        self.limit = config.gate_sigma**2
        self._R_W_grid: Array = gtsam.Rot3.Yaw(radians(config.grid_yaw_deg)).matrix()
        self._p_W_grid = np.array(config.grid_position_m)
        self.loss, self.offset_sigma_s = config.robust_loss, config.time_offset_sigma_s
        self._config = config

    def convert(self, message: PointPosition, world: World) -> Position | Outcome:  # noqa: ARG002 (the grid is in W)
        """Return the position in W, or what is wrong with it."""
        if not np.isfinite(message.position).all():
            return Outcome.NOT_FINITE
        if abs(message.position).max() > MAX_DISTANCE_M:
            return Outcome.OUT_OF_RANGE
        covariance = claimed_covariance(message.covariance, np.full(3, self._config.sigma_m))
        if np.diag(covariance)[:2].max() > self._config.max_sigma_m**2:
            return Outcome.LARGE_COVARIANCE
        R = self._R_W_grid
        p_W_P, stamp_ns = self._p_W_grid + R @ message.position, message.stamp_ns + self.offset_ns
        return Position(stamp_ns, self.name, p_W_P, R @ covariance @ R.T, self._config.correlation_s)

    def innovation(self, position: Position, state: State) -> Innovation:
        """Compare a position with a state."""
        return position_innovation(position, state, self.p_I_P)

    def factor(
        self,
        keys: Sequence[int],
        position: Position,
        inflation: float,
        state: State = ANYWHERE,  # noqa: ARG002
    ) -> gtsam.NonlinearFactor:
        """Return the factor of a position on a node."""
        return position_factor(keys[0], position, self.p_I_P, self.loss, inflation)


register(PrismConfig, lambda name, section, config: PrismModel(name, section, lever_arm(name, config)))
