"""The position of a point of the machine in W: what antennas and prisms have in common."""

import gtsam
import numpy as np

from holdfast.config.sensors import RobustLoss
from holdfast.messages import Array
from holdfast.sensors.noise import noise_model
from holdfast.sensors.sensor import Innovation, Position, State


def position_innovation(position: Position, state: State, p_I_P: Array) -> Innovation:
    """Compare with a state: y = p_W_P - (p_W_I + R_W_I p_I_P), (13) in docs/math.md.

    The lever arm is the state's parameter if it has one, else `p_I_P` (3,).
    """
    is_estimated = state.parameter.size > 0
    arm = state.parameter if is_estimated else p_I_P
    R_W_I = state.nav.attitude().matrix()
    H = np.zeros((3, 9))
    H[:, :3] = -R_W_I @ gtsam.SO3.Hat(arm)
    H[:, 3:6] = R_W_I
    y = position.p_W_P - state.nav.position() - R_W_I @ arm
    return Innovation(y, H, position.covariance, R_W_I if is_estimated else np.zeros((3, 0)))


def position_factor(
    key: int, position: Position, p_I_P: Array | int, loss: RobustLoss, inflation: float
) -> gtsam.NonlinearFactor:
    """Return the factor with the lever arm inside: Eqs. (8)-(9) of the paper, covariance times `inflation`.

    `p_I_P` is the arm (3,), or the key of the variable that it is.
    """
    noise = noise_model(position.covariance * inflation, loss)
    if isinstance(p_I_P, int):
        return gtsam.GPSFactor2ArmCalib(key, p_I_P, position.p_W_P, noise)
    return gtsam.GPSFactor2Arm(key, position.p_W_P, p_I_P, noise)


def predicted_position(nav: gtsam.NavState, angular_velocity: Array, arm: Array, offset_s: float) -> Array:
    """Return where a point with a lever arm (3,) [m] is so long after the time of a node."""
    pose = nav.pose()
    at: Array = pose.transformFrom(arm)
    if offset_s != 0.0:
        at += offset_s * (nav.velocity() + pose.rotation().rotate(_cross(angular_velocity, arm)))
    return at


def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
