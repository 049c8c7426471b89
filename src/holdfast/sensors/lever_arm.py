"""Lever arms as constants that the graph estimates, as shifts (3,) [m] from where they were measured.

One is held there until it proves to be far off. Of antennas the shift is a common one, in the axes of I: a wrong origin
moves them all, and that one of several is wrong shows by their distance.
"""

import numpy as np

from holdfast.messages import Array
from holdfast.sensors.sensor import CHANGE_M, Parameter, part_of

ARM, GNSS_ARM = "arm", "arm of GNSS"  # which parameter of a sensor it is, and its name where antennas share it
IF_RIGHT_M, IF_WRONG_M = 0.03, 2.0  # sigmas of one that was measured, and of one with a wrong sign
GNSS_ODDS = 1e4  # about five sigmas: what a model leaves unexplained looks like three, and moves the estimate with it
CHANGE: Array = np.full(3, CHANGE_M)


def measured_arm() -> Parameter:
    """Return the shift of a lever arm that is as it was measured, or far off: (54) in docs/math.md."""
    return doubtful_arm(np.full(3, IF_WRONG_M))._replace(if_right=np.full(3, IF_RIGHT_M))


def measured_antennas() -> Parameter:
    """Return the shift of all antennas, which are where they were measured, or far off."""
    return measured_arm()._replace(shared=GNSS_ARM, odds=GNSS_ODDS)


def doubtful_arm(sigmas: Array, shared: str = "") -> Parameter:
    """Return the shift of a lever arm that is known to sigmas (3,) [m]."""
    return Parameter(np.zeros(3), sigmas, shared=shared, part=ARM, change=CHANGE)


def is_in_doubt(parameters: tuple[Parameter, ...]) -> bool:
    """Whether the lever arm among the parameters of a sensor is not believed to be as it was measured."""
    arm = part_of(parameters, ARM)
    return arm is not None and arm.if_right is None
