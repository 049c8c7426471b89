"""The position of a point of the machine in W: what antennas and prisms have in common."""

from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.config.sensors import RobustLoss
from holdfast.geometry.rotations import skew
from holdfast.messages import Array
from holdfast.sensors.noise import noise_model
from holdfast.sensors.sensor import Innovation, Position, State


def position_innovation(position: Position, state: State, p_I_P: Array) -> Innovation:
    """Compare with a state: y = p_W_P - (p_W_I + R_W_I p_I_P), (13) in docs/math.md.

    A parameter of the state is the shift of the lever arm `p_I_P` (3,).
    """
    is_estimated = state.parameter.size > 0
    arm = p_I_P + state.parameter if is_estimated else p_I_P
    R_W_I = state.nav.attitude().matrix()
    H = np.zeros((3, 9))
    H[:, :3] = -R_W_I @ gtsam.SO3.Hat(arm)
    H[:, 3:6] = R_W_I
    y = position.p_W_P - state.nav.position() - R_W_I @ arm
    return Innovation(y, H, position.covariance, R_W_I if is_estimated else np.zeros((3, 0)))


def position_factor(
    key: int, position: Position, p_I_P: Array, loss: RobustLoss, inflation: float
) -> gtsam.NonlinearFactor:
    """Return the factor with the lever arm (3,) inside: Eqs. (8)-(9) of the paper, covariance times `inflation`."""
    noise = noise_model(position.covariance * inflation, loss)
    return gtsam.GPSFactor2Arm(key, position.p_W_P, p_I_P, noise)


def arm_factor(key: int, arm_key: int, position: Position, loss: RobustLoss, inflation: float) -> gtsam.NonlinearFactor:
    """Return the factor on a node and on the lever arm (3,) itself."""
    return gtsam.GPSFactor2ArmCalib(key, arm_key, position.p_W_P, noise_model(position.covariance * inflation, loss))


class Motion(NamedTuple):
    """How I moves in W, at one time or at many.

    Attributes:
        R: (..., 3, 3) attitude R_W_I.
        p: (..., 3) position [m].
        v: (..., 3) velocity [m/s].
        w: (..., 3) angular velocity of I in I [rad/s].
    """

    R: Array
    p: Array
    v: Array
    w: Array

    @classmethod
    def of(cls, nav: gtsam.NavState, angular_velocity: Array) -> "Motion":
        """Return that at one node."""
        return cls(nav.attitude().matrix(), nav.position(), nav.velocity(), angular_velocity)


def predicted_position(motion: Motion, arm: Array, offset_s: Array | float) -> Array:
    """Return where (..., 3) points with lever arms (..., 3) [m] are so long (...) after the times of nodes."""
    offset = np.asarray(offset_s)[..., None]
    in_I = arm[..., None] + offset[..., None] * (skew(motion.w) @ arm[..., None])
    at: Array = motion.p + offset * motion.v + (motion.R @ in_I)[..., 0]
    return at
