"""By how much a variable must move until the factors on it are linearised anew."""

import gtsam
import numpy as np

from holdfast.graph.nodes import BIAS, FRAME, NODE
from holdfast.graph.parameters import MAX_SIZE, parameter_letter
from holdfast.graph.slow_errors import SLOW

LINEAR = 1e6  # a threshold that is never reached
PARAMETER = 0.01  # 1 cm, 0.6 deg, 1 %


def thresholds(attitude_rad: float, slow_size: int) -> gtsam.ISAM2ThresholdMap:
    """Return the thresholds of all kinds of variables: position, velocity and bias enter (almost) linearly.

    Args:
        attitude_rad: of an attitude.
        slow_size: of the variables of slow errors, 0 where there are none.
    """
    found = gtsam.ISAM2ThresholdMap()
    for letter in NODE, FRAME:
        found.insert((letter, np.repeat([attitude_rad, 50.0 * attitude_rad, 50.0 * attitude_rad], 3)))
    found.insert((BIAS, np.repeat([20.0 * attitude_rad, attitude_rad], 3)))
    for size in range(1, MAX_SIZE + 1):
        found.insert((parameter_letter(size), np.full(size, PARAMETER)))
    if slow_size:
        found.insert((SLOW, np.full(slow_size, LINEAR)))
    return found
