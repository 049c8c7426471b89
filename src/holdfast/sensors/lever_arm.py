"""Lever arms as constants that the graph estimates: held as they were measured, until they prove to be far off."""

import numpy as np

from holdfast.messages import Array
from holdfast.sensors.sensor import CHANGE_M, Parameter

ARM = "arm"  # which parameter of a sensor it is
IF_RIGHT_M, IF_WRONG_M = 0.03, 2.0  # sigmas of one that was measured, and of one with a wrong sign
CHANGE: Array = np.full(3, CHANGE_M)


def measured_arm(mean: Array) -> Parameter:
    """Return a lever arm (3,) [m] that is as it was measured, or far off: (54) in docs/math.md."""
    return Parameter(mean, np.full(3, IF_WRONG_M), np.full(3, IF_RIGHT_M), part=ARM, change=CHANGE)


def doubtful_arm(mean: Array, sigma_m: float) -> Parameter:
    """Return a lever arm (3,) [m] that is known to a sigma per axis."""
    return Parameter(mean, np.full(3, sigma_m), part=ARM, change=CHANGE)


def found_arm(mean: Array, sigmas: Array) -> Parameter:
    """Return a lever arm (3,) [m] that motions have told, and sigmas (3,) of it."""
    return doubtful_arm(mean, 1.0)._replace(sigmas=sigmas)


def arm_name(sensor: str) -> str:
    """Return the name under which the graph knows the lever arm of a sensor."""
    return f"{sensor} {ARM}"


def arm_of(parameters: tuple[Parameter, ...]) -> Parameter | None:
    """Return the lever arm among the parameters of a sensor, which is the first of an antenna's."""
    return next((one for one in parameters if one.part == ARM), None)


def is_in_doubt(parameters: tuple[Parameter, ...]) -> bool:
    """Whether the lever arm among the parameters of a sensor is not believed to be as it was measured."""
    arm = arm_of(parameters)
    return arm is not None and arm.if_right is None
