"""Deskewing: the points of a sweep, measured one after the other, brought to one instant."""

from dataclasses import dataclass

import gtsam
import numpy as np

from holdfast.messages import Array

SHORTEST_S = 1e-6
STEPS = 511  # the usual sweep has 512 columns; for others times are rounded by 0.2 ms, 0.1 mrad at 0.6 rad/s


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """Angular rates of the lidar, measured by a gyroscope or constant; extrapolated as constant at both ends.

    Attributes:
        times_s: (K,) increasing, after the stamp of a sweep [s].
        angular: (K, 3) angular velocity of L in L [rad/s].
    """

    times_s: Array
    angular: Array

    @classmethod
    def constant(cls, angular: Array) -> "Rates":
        """Return one rate for all times."""
        return cls(np.zeros(1), angular[None])

    def rotations(self, times_s: Array) -> Array:
        """Return the attitude (K, 3, 3) at each of K increasing times in the frame at the first of them."""
        middles_s = (times_s[1:] + times_s[:-1]) / 2.0
        rates = np.column_stack([np.interp(middles_s, self.times_s, axis) for axis in self.angular.T])
        products = np.concatenate([np.eye(3)[None], _exponentials(rates * np.diff(times_s)[:, None])])
        reach = 1
        while reach < len(products):  # in log2(K) rounds (Hillis and Steele, 1986)
            products[reach:] = products[:-reach] @ products[reach:]
            reach *= 2
        return products

    def rotation(self, from_s: float, to_s: float) -> gtsam.Rot3:
        """Return the attitude at one time in the frame at an earlier one."""
        return gtsam.Rot3(self.rotations(np.linspace(from_s, to_s, 32))[-1])

    def less(self, bias: Array) -> "Rates":
        """Return the rates without a bias (3,) [rad/s]."""
        return Rates(self.times_s, self.angular - bias)


def _exponentials(vectors: Array) -> Array:
    """Return the rotations (K, 3, 3) of rotation vectors (K, 3) [rad], by Rodrigues' formula."""
    angles = np.linalg.norm(vectors, axis=1)[:, None, None]
    hats = np.zeros((len(vectors), 3, 3))
    hats[:, 2, 1], hats[:, 0, 2], hats[:, 1, 0] = vectors.T
    hats -= hats.transpose(0, 2, 1)
    # sin(a) / a, and (1 - cos(a)) / a^2 = (sin(a/2) / (a/2))^2 / 2
    first, second = np.sinc(angles / np.pi), 0.5 * np.sinc(0.5 * angles / np.pi) ** 2
    found: Array = np.eye(3) + first * hats + second * (hats @ hats)
    return found


def deskew(points: Array, offsets_s: Array, at_s: float, rates: Rates, velocity: Array) -> Array:
    """Return the points (N, 3) as the lidar would have seen them all at `at_s`.

    A point p measured at t is R_at_t p + (t - at) v.

    Args:
        points: (N, 3) each in L at its own time [m].
        offsets_s: (N,) the times after the stamp.
        at_s: the instant on the same clock, within the sweep.
        rates: the rotation during the sweep.
        velocity: (3,) of L in L at the instant [m/s]; constant during the sweep.
    """
    first_s, last_s = offsets_s.min(), offsets_s.max()
    R_first_t = rates.rotations(np.linspace(first_s, last_s, STEPS + 1))
    R_at_first = rates.rotation(first_s, at_s).matrix().T
    step = np.rint((offsets_s - first_s) * (STEPS / max(last_s - first_s, SHORTEST_S))).astype(np.intp)
    rotated = np.einsum("nij,nj->ni", (R_at_first @ R_first_t)[step], points)
    moved: Array = rotated + (offsets_s - at_s)[:, None] * velocity
    return moved
