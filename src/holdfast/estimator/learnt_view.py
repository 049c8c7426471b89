"""What the estimator has learnt of its sensors, for whoever estimates once more with the past and the future."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from holdfast.sensors.constants import Constant
from holdfast.sensors.noise import Colour
from holdfast.sensors.sensor import Measurement


class LearntView(NamedTuple):
    """What the estimator knows of its sensors, read when it is asked.

    Attributes:
        noise: how many times noisier a sensor is than its measurements say, by name.
        used: the measurements later than one time [ns] and not later than another whose factors the graph holds.
        constants: what the graph knows of mountings and clocks.
        colour: how the errors of a sensor are composed, by name, where the claim is believed times a factor.
        force_scale: how many times larger the error of the accelerometer in proportion to the motion is.
        sway: density of what the accelerometer feels and no receiver sees [m/s^2/sqrt(Hz)].
    """

    noise: Callable[[str], float]
    used: Callable[[int, int], list[Measurement]]
    constants: Callable[[], Mapping[str, Constant]]
    colour: Callable[[str, Colour, float], Colour]
    force_scale: Callable[[], float]
    sway: Callable[[], float]
