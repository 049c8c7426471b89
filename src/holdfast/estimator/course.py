"""Where the positions of one receiver lead: its place and velocity now, without an estimate."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.messages import Array
from holdfast.sensors.sensor import Position, Velocity

UNKNOWN_VARIANCE = 100.0  # [m^2/s^2] of a velocity axis about which too little is known
ACCELERATION_M_S2 = 2.0  # by which a machine usually departs from even motion


class Course(NamedTuple):
    """A point of the machine at one time.

    Attributes:
        p_W_P: (3,) its position [m].
        v_W_P: (3,) its velocity [m/s].
        of_position: (3, 3) covariance [m^2].
        of_velocity: (3, 3) covariance [m^2/s^2].
        p_I_P: (3,) its lever arm [m].
    """

    p_W_P: Array
    v_W_P: Array
    of_position: Array
    of_velocity: Array
    p_I_P: Array


def course_of(
    positions: Sequence[Position], velocities: Sequence[Velocity], stamp_ns: int, p_I_P: Array
) -> Course | None:
    """Return where positions of one receiver, sorted by stamp, lead at a time; None if they do not tell.

    The velocity is the newest that was measured, or else that of a line through the positions.
    """
    slope: Array
    of_velocity: Array
    if positions and velocities and velocities[-1].covariance.diagonal().max() < UNKNOWN_VARIANCE:
        slope, of_velocity = velocities[-1].v_W_P, velocities[-1].covariance
    elif len(positions) > 1:
        slope, of_velocity = _line(positions)
    else:
        return None
    last = positions[-1]
    ahead_s = (stamp_ns - last.stamp_ns) * 1e-9
    of_position = last.covariance + of_velocity * ahead_s**2
    return Course(last.p_W_P + slope * ahead_s, slope, of_position, of_velocity, p_I_P)


def _line(positions: Sequence[Position]) -> tuple[Array, Array]:
    """Return the velocity (3,) of a line through positions, and its covariance (3, 3)."""
    t = np.array([one.stamp_ns - positions[-1].stamp_ns for one in positions]) * 1e-9
    spread = t - t.mean()
    slope: Array = spread @ np.array([one.p_W_P for one in positions]) / (spread @ spread)
    changing = (ACCELERATION_M_S2 * 0.5 * -t[0]) ** 2
    noise: Array = np.mean([one.covariance for one in positions], axis=0) / (spread @ spread)
    return slope, noise + np.eye(3) * changing


def travel_m(fixes: Sequence[Position]) -> float:
    """Return how far one receiver has been from its first position [m]."""
    return max((float(np.linalg.norm(fix.p_W_P - fixes[0].p_W_P)) for fix in fixes), default=0.0)
