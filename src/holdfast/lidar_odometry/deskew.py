"""Deskewing: the points of a sweep, measured one after the other, brought to one instant."""

from dataclasses import dataclass, field
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.geometry.rotations import attitudes
from holdfast.messages import Array

SHORTEST_S = 1e-6
STEPS = 511  # the usual sweep has 512 columns; for others times are rounded by 0.2 ms, 0.1 mrad at 0.6 rad/s
STILL = np.zeros(3)


class Travelled(NamedTuple):
    """What an IMU alone says of its motion since the first of K times, without gravity, in the axes of then.

    Attributes:
        rotations: (K, 3, 3) axes of L then in those of the first time.
        velocities: (K, 3) the integral of the specific force [m/s].
        shifts: (K, 3) the integral of that [m].
    """

    rotations: Array
    velocities: Array
    shifts: Array


class Moving(NamedTuple):
    """How the IMU moves at an instant, in the axes of L then: (3,) each; the lidar itself where there is no IMU.

    Attributes:
        velocity: [m/s].
        gravity: [m/s^2], and with it whatever is to be added to specific forces.
    """

    velocity: Array = STILL
    gravity: Array = STILL


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """What an IMU measured around a sweep, or a constant rate; extrapolated as constant at both ends.

    Attributes:
        times_s: (K,) increasing, after the stamp of a sweep [s].
        angular: (K, 3) angular velocity of L in L [rad/s].
        forces: (K, 3) specific force at the IMU in the axes of L [m/s^2]; None where none was measured.
        lever: (3,) the lidar's origin from the IMU's in the axes of L [m].
    """

    times_s: Array
    angular: Array
    forces: Array | None = None
    lever: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def constant(cls, angular: Array) -> "Rates":
        """Return one rate for all times."""
        return cls(np.zeros(1), angular[None])

    @property
    def turning(self) -> "Rates":
        """The rates without the forces and the lever, for a lidar whose own velocity is known."""
        return Rates(self.times_s, self.angular)

    def rotations(self, times_s: Array) -> Array:
        """Return the attitude (K, 3, 3) at each of K increasing times in the frame at the first of them."""
        return attitudes(self._at(times_s, self.angular))

    def rotation(self, from_s: float, to_s: float) -> gtsam.Rot3:
        """Return the attitude at one time in the frame at an earlier one."""
        return gtsam.Rot3(self.rotations(np.linspace(from_s, to_s, 32))[-1])

    def travelled(self, times_s: Array) -> Travelled:
        """Return the motion up to each of K increasing times from the first of them."""
        R = self.rotations(times_s)
        velocities, shifts = np.zeros((2, len(times_s), 3))
        if self.forces is not None:
            turned = np.einsum("nij,nj->ni", (R[1:] + R[:-1]) / 2.0, self._at(times_s, self.forces))
            steps_s = np.diff(times_s)[:, None]
            velocities[1:] = np.cumsum(turned, axis=0)
            shifts[1:] = np.cumsum((velocities[:-1] + turned / 2.0) * steps_s, axis=0)
        return Travelled(R, velocities, shifts)

    def _at(self, times_s: Array, readings: Array) -> Array:
        """Return the integrals (K - 1, 3) of readings between times."""
        middles_s, steps_s = (times_s[1:] + times_s[:-1]) / 2.0, np.diff(times_s)
        return np.column_stack([np.interp(middles_s, self.times_s, axis) * steps_s for axis in readings.T])


def deskew(points: Array, offsets_s: Array, at_s: float, rates: Rates, moving: Moving) -> Array:
    """Return the points (N, 3) as the lidar would have seen them all at `at_s`.

    A point p measured at t is R_at_t p + d(t), with d the way of the lidar, from its velocity, the specific forces and
    gravity, and from the lever r that turns with it.

    Args:
        points: (N, 3) each in L at its own time [m].
        offsets_s: (N,) the times after the stamp.
        at_s: the instant on the same clock, within the sweep.
        rates: the rotation, and the forces where they are known, during the sweep.
        moving: at the instant.
    """
    first_s, last_s = offsets_s.min(), offsets_s.max()
    times_s = np.linspace(first_s, last_s, STEPS + 1)
    R, velocities, shifts = rates.travelled(times_s)
    R_at_first = rates.rotation(first_s, at_s).matrix().T
    R_at = R_at_first @ R
    after_s = (times_s - at_s)[:, None]
    velocity_at, shift_at = (
        np.array([np.interp(at_s, times_s, axis) for axis in rows.T]) for rows in (velocities, shifts)
    )
    way = (shifts - shift_at - after_s * velocity_at) @ R_at_first.T
    way += after_s * moving.velocity + 0.5 * after_s**2 * moving.gravity + (R_at - np.eye(3)) @ rates.lever
    step = np.rint((offsets_s - first_s) * (STEPS / max(last_s - first_s, SHORTEST_S))).astype(np.intp)
    moved: Array = np.einsum("nij,nj->ni", R_at[step], points) + way[step]
    return moved
