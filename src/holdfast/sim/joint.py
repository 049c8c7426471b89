"""What the encoder of the cabin's turn joint reads."""

import numpy as np

from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedJoint
from holdfast.sim.imu import quantised
from holdfast.sim.readings import Readings


def joint_readings(
    sheet: SimulatedJoint, angles_rad: Array, times_s: Array, rng: np.random.Generator
) -> tuple[Readings, float]:
    """Return what the encoder measures and its constant bias [rad].

    reading = angle + bias + white noise, rounded to the resolution. The angle is not wrapped: a cabin that goes on
    turning is read beyond half a turn.

    Args:
        sheet: errors of the encoder.
        angles_rad: (N,) true angle at `times_s`.
        times_s: (N,) true time since the start of the scenario.
        rng: the encoder's own random numbers.

    Returns:
        Column `angle_rad` (N,), and the bias.
    """
    bias_rad = sheet.bias_sigma_rad * float(rng.standard_normal())
    noise_rad = sheet.noise_rad * rng.standard_normal(len(angles_rad))
    measured = quantised(angles_rad + bias_rad + noise_rad, sheet.resolution_rad)
    return Readings(times_s, {"angle_rad": measured}), bias_rad
