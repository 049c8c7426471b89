"""What positions tell of the lever arm of an antenna: a constant that is as it was measured, or far off."""

import numpy as np

from holdfast.graph.smoother import Smoother
from holdfast.messages import Array
from holdfast.sensors.lever_arm import ARM, IF_RIGHT_M
from holdfast.sensors.sensor import PositionSensor, State, part_of

KNOWN_M, SIGMA = 0.1, 3.0


def is_arm_proven(sensor: PositionSensor, smoother: Smoother) -> bool:
    """Whether a smoother knows the arm of a receiver in a plane, as motions are, and it is where it was measured."""
    arm = part_of(sensor.parameters, ARM)
    if arm is None or arm.if_right is None:
        return False
    value, covariance = smoother.parameters.unheld(arm.name(sensor.name), arm)
    variances, axes = np.linalg.eigh(covariance)
    off = axes.T[:2] @ (value - arm.mean)
    return bool(variances[1] <= KNOWN_M**2 and (off**2 <= SIGMA**2 * variances[:2] + IF_RIGHT_M**2).all())


def is_arm_known(sensor: PositionSensor, state: State, claimed: Array) -> bool:
    """Whether the arm of a receiver is known better than what its positions claim (3, 3) [m^2].

    Else it takes up their noise, and they look better than they are.
    """
    of_arm = state.parameter_covariance[:3, :3]
    return part_of(sensor.parameters, ARM) is None or float(np.trace(of_arm)) <= float(np.trace(claimed))
