"""Heading of a dual-antenna receiver."""

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedHeading
from holdfast.sim.gnss import Quality
from holdfast.sim.motion import FrameMotion
from holdfast.sim.readings import Readings, slow_noise

FLOAT_RATIO = 10.0  # a float baseline is known to centimetres instead of millimetres


def heading_readings(
    sheet: SimulatedHeading,
    left: FrameMotion,
    right: FrameMotion,
    times_s: Array,
    *,
    left_quality: NDArray[np.int64],
    right_quality: NDArray[np.int64],
    rng: np.random.Generator,
) -> Readings:
    """Return the yaw of the horizontal projection of the baseline from the left to the right antenna in W.

    There are no rows where an antenna is worse than float; where one is float, error and claim are ten times those of
    the datasheet.

    Args:
        sheet: of the receiver.
        left: (N,) motion of the left antenna at `times_s`.
        right: (N,) motion of the right antenna at `times_s`.
        times_s: (N,) true times of measurement.
        left_quality: (N,) `Quality` of the left antenna at `times_s`.
        right_quality: (N,) `Quality` of the right antenna at `times_s`.
        rng: of this sensor.

    Columns:
        yaw_rad: (M,) within [-pi, pi], 0 is east, counter-clockwise.
        sigma_rad: (M,) claimed standard deviation.
    """
    worst = np.minimum(left_quality, right_quality)
    ratio = np.where(worst < Quality.RTK_FIXED, FLOAT_RATIO, 1.0)
    slow = slow_noise(rng, np.diff(times_s, prepend=times_s[:1]) / sheet.time_constant_s)
    error = sheet.white_rad * rng.standard_normal(len(times_s)) + sheet.slow_rad * slow
    baseline = right.p_W - left.p_W
    columns = {
        "yaw_rad": wrapped_rad(np.arctan2(baseline[:, 1], baseline[:, 0]) + ratio * error),
        "sigma_rad": ratio * np.hypot(sheet.white_rad, sheet.slow_rad),
    }
    return Readings(times_s, columns).taken(worst >= Quality.RTK_FLOAT)


def wrapped_rad(angle_rad: Array) -> Array:
    """Return the same angles within [-pi, pi]."""
    return np.arctan2(np.sin(angle_rad), np.cos(angle_rad))
