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

    def rotations(self, times_s: Array) -> list[gtsam.Rot3]:
        """Return the attitude at each of some increasing times in the frame at the first of them."""
        middles_s = (times_s[1:] + times_s[:-1]) / 2.0
        rates = np.column_stack([np.interp(middles_s, self.times_s, axis) for axis in self.angular.T])
        rotations = [gtsam.Rot3()]
        for step in rates * np.diff(times_s)[:, None]:
            rotations.append(rotations[-1].compose(gtsam.Rot3.Expmap(step)))
        return rotations

    def rotation(self, from_s: float, to_s: float) -> gtsam.Rot3:
        """Return the attitude at one time in the frame at an earlier one."""
        return self.rotations(np.linspace(from_s, to_s, 32))[-1]


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
    R_first_t = np.array([rotation.matrix() for rotation in rates.rotations(np.linspace(first_s, last_s, STEPS + 1))])
    R_at_first = rates.rotation(first_s, at_s).matrix().T
    step = np.rint((offsets_s - first_s) * (STEPS / max(last_s - first_s, SHORTEST_S))).astype(np.intp)
    rotated = np.einsum("nij,nj->ni", (R_at_first @ R_first_t)[step], points)
    moved: Array = rotated + (offsets_s - at_s)[:, None] * velocity
    return moved
