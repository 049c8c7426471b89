"""How a machine has moved by the IMU alone, without a state: what positions of a point on it are compared with."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import Position

SAME_M = 1e-3  # a position that is no further from the others on an axis repeats them


class Motions(NamedTuple):
    """How I has moved until each of N positions beside a fall, in the axes that it had at the first.

    Attributes:
        p: (N, 3) [m].
        R: (N, 3, 3).
    """

    p: Array
    R: Array

    def of_point(self, p_I_P: Array) -> Array:
        """Return how a point (3,) in I has moved (N, 3) [m]."""
        moved: Array = self.p + self.R @ p_I_P
        return moved


def motions_between(buffer: ImuBuffer, positions: Sequence[Position]) -> Motions | None:
    """Return how I has moved from the first position to each; None where the IMU did not measure all along."""
    first_ns, last_ns = positions[0].stamp_ns, positions[-1].stamp_ns
    if not buffer.is_trusted(first_ns, last_ns):
        return None
    p, R = np.zeros((len(positions), 3)), np.tile(np.eye(3), (len(positions), 1, 1))
    for k, one in enumerate(positions[1:], 1):
        R[k], _, p[k] = buffer.motion(first_ns, one.stamp_ns, np.zeros(6))
    return Motions(p, R)


def times_of(positions: Sequence[Position]) -> Array:
    """Return the times (N,) [s] of positions since the first."""
    return np.array([one.stamp_ns - positions[0].stamp_ns for one in positions]) * 1e-9


def divided_difference(times_s: Array) -> Array:
    """Return the weights (N,) of norm 1 under which nothing is left of a polynomial of degree N - 2."""
    differences = times_s[:, None] - times_s + np.eye(len(times_s))
    weights: Array = 1.0 / differences.prod(axis=1)
    weights /= np.linalg.norm(weights)
    return weights


def white_acceleration(times_s: Array, weights: Array) -> Array:
    """Return the variance (N - 1,) [s^3] of a combination of positions by white noise of density 1 in each interval.

    An acceleration at a time counts as a velocity that begins there, which is linear from one of the times to the next.
    """
    counted = np.maximum(times_s - times_s[:, None], 0.0) @ weights
    before, after = counted[:-1], counted[1:]
    variances: Array = (before**2 + before * after + after**2) / 3.0 * np.diff(times_s)
    return variances
