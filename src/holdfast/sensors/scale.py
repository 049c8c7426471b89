"""The scale of the distances of an odometry as a constant that the graph estimates.

It is held at one until it proves to be far off: a laser measures distances, wheels and cameras rarely do.
"""

import numpy as np

from holdfast.sensors.sensor import Parameter

SCALE = "scale"  # which parameter of a sensor it is
IF_RIGHT = 0.001  # sigma of one that is right
CHANGE = 0.01  # from one day to the next, as a camera initialises anew, or tyres


def measured_scale(sigma: float) -> Parameter:
    """Return the logarithm of a scale factor, which is one, or known to `sigma`: (54) in docs/math.md."""
    one = np.ones(1)
    return Parameter(np.zeros(1), sigma * one, if_right=IF_RIGHT * one, part=SCALE, change=CHANGE * one)
