"""The position of a point of the machine in W: what antennas and prisms have in common."""

import gtsam
import numpy as np

from holdfast.config.sensors import RobustLoss
from holdfast.messages import Array
from holdfast.sensors.noise import noise_model
from holdfast.sensors.sensor import Innovation, Position, State


def position_innovation(position: Position, state: State, p_I_P: Array) -> Innovation:
    """Compare with a state: y = p_W_P - (p_W_I + R_W_I p_I_P), (13) in docs/math.md; `p_I_P` (3,) is the lever arm."""
    R_W_I = state.nav.attitude().matrix()
    H = np.zeros((3, 9))
    H[:, :3] = -R_W_I @ gtsam.SO3.Hat(p_I_P)
    H[:, 3:6] = R_W_I
    y = position.p_W_P - state.nav.position() - R_W_I @ p_I_P
    return Innovation(y, H, position.covariance, np.zeros((3, 0)))


def position_factor(
    key: int, position: Position, p_I_P: Array, loss: RobustLoss, inflation: float
) -> gtsam.NonlinearFactor:
    """Return the factor with the lever arm inside: Eqs. (8)-(9) of the paper, covariance times `inflation`."""
    return gtsam.GPSFactor2Arm(key, position.p_W_P, p_I_P, noise_model(position.covariance * inflation, loss))
