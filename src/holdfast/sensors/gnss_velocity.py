"""Doppler velocity of a GNSS antenna: which axes of it can be used, and what they weigh."""

from typing import ClassVar

import gtsam
import numpy as np

from holdfast.config.sensors import GnssVelocityConfig
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, GnssVelocity, Message
from holdfast.sensors.noise import FREE_VARIANCE
from holdfast.sensors.sensor import (
    Innovation,
    Role,
    State,
    StateSensor,
    Velocity,
    claimed_covariance,
    lever_arm,
    register,
)

MAX_SPEED_M_S = 515.0  # beyond, receivers are not allowed to report
UP_RATIO = 2.0  # of the vertical sigma to the horizontal one: all satellites are above


class GnssVelocityModel(StateSensor):
    """z = v_W + R_W_I (omega x p_I_P), (46) in docs/math.md; `p_I_P` (3,) [m] is the antenna's lever arm."""

    role: ClassVar[Role] = Role.VELOCITY
    message: ClassVar[type[Message] | None] = GnssVelocity

    def __init__(self, name: str, config: GnssVelocityConfig, p_I_P: Array) -> None:
        self.name = name
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.settings = config
        self.p_I_P = p_I_P
        self.offset_sigma_s = config.time_offset_sigma_s
        self._is_used = np.array([axis in config.axes for axis in "xyz"])
        self._floors = config.sigma_m_s * np.array([1.0, 1.0, UP_RATIO])

    def convert(self, message: GnssVelocity, world: World) -> Velocity | Outcome:
        """Return the velocity with its noise, or what is wrong with it; axes without a value or a variance are free."""
        claim = np.zeros((3, 3)) if message.covariance is None else message.covariance
        is_measured = self._is_used & np.isfinite(message.velocity)
        is_claimed = is_measured & np.isfinite(claim.diagonal()) & (claim.diagonal() > 0.0)
        if is_claimed.any():
            is_measured = is_claimed
        if not is_measured.any():
            return Outcome.NOT_FINITE
        if abs(message.velocity[is_measured]).max() > MAX_SPEED_M_S:
            return Outcome.OUT_OF_RANGE
        axes = np.ix_(is_measured, is_measured)
        covariance = np.eye(3) * FREE_VARIANCE
        covariance[axes] = claimed_covariance(_consistent(claim[axes]), self._floors[is_measured])
        velocity = world.axes @ np.where(is_measured, message.velocity, 0.0)
        return Velocity(message.stamp_ns + self.offset_ns, self.name, velocity, covariance)

    def innovation(self, measured: Velocity, state: State) -> Innovation:
        """Compare with a state: y = v_W_P - (v_W + R_W_I (omega x p_I_P))."""
        R_W_I = state.nav.attitude().matrix()
        v_I = np.cross(state.angular_velocity, self.p_I_P)
        H = np.zeros((3, 9))
        H[:, :3], H[:, 6:] = -R_W_I @ gtsam.SO3.Hat(v_I), R_W_I
        y = measured.v_W_P - state.nav.velocity() - R_W_I @ v_I
        return Innovation(y, H, measured.covariance, np.zeros((3, 0)))


def _consistent(claim: Array) -> Array:
    """Return a claimed covariance (m, m), without its correlations where no errors can have them."""
    is_possible = np.isfinite(claim).all() and np.linalg.eigvalsh(claim)[0] > 0.0
    return claim if is_possible else np.diag(claim.diagonal())


register(GnssVelocityConfig, lambda name, section, config: GnssVelocityModel(name, section, lever_arm(name, config)))
