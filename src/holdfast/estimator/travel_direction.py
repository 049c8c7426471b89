"""In which of its own directions a machine travels, as cars do: then its course tells how it heads."""

from math import atan2, exp, hypot, remainder, sqrt, tau

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.sensors.sensor import Velocity
from holdfast.state import OptimisedState

LEAST_M_S, SIGMA = 1.0, 4.0  # of a machine whose course is one, and so many sigmas of it
KNOWN_RAD = 0.1  # sigma of an attitude from which is learnt
MEMORY_S, ENOUGH_S = 60.0, 5.0
STEADY = 0.9  # resultant of unit vectors: they spread by 26 deg, as where the IMU is far from the axle


class TravelDirection:
    """Learns the angle from the heading of the IMU to the course; none of a machine that goes all ways."""

    def __init__(self) -> None:
        self._sum = np.zeros(2)
        self._weight_s = 0.0
        self._last_ns: int | None = None
        self._axis: int | None = None  # of I, not upright: its heading is that of I

    def note(self, state: OptimisedState) -> None:
        """Take in an estimate; what is slow or of a vague attitude says nothing."""
        since_s = 0.0 if self._last_ns is None else min(1.0, max(0.0, (state.stamp_ns - self._last_ns) * 1e-9))
        self._last_ns = state.stamp_ns
        velocity = state.nav.velocity()
        if hypot(velocity[0], velocity[1]) < LEAST_M_S or np.trace(state.covariance[:3, :3]) > KNOWN_RAD**2:
            return
        angle = _course(velocity) - self._heading(state.nav.attitude())
        kept = exp(-since_s / MEMORY_S)
        self._sum = kept * self._sum + since_s * np.array([np.cos(angle), np.sin(angle)])
        self._weight_s = kept * self._weight_s + since_s

    def turned_beside(self, attitude: gtsam.Rot3, measured: Velocity) -> float | None:
        """Return by how much an attitude must be turned about the vertical [rad] to go with a velocity.

        None where the machine is too slow for a course, or goes in no direction of its own.
        """
        is_steady = self._weight_s > ENOUGH_S and hypot(*self._sum) > STEADY * self._weight_s
        velocity, sigma_m_s = measured.v_W_P, sqrt(measured.covariance.diagonal()[:2].max())
        if not is_steady or hypot(velocity[0], velocity[1]) < max(LEAST_M_S, SIGMA * sigma_m_s):
            return None
        ahead = atan2(self._sum[1], self._sum[0])
        return remainder(_course(velocity) - ahead - self._heading(attitude), tau)

    def _heading(self, attitude: gtsam.Rot3) -> float:
        R = attitude.matrix()
        if self._axis is None:
            self._axis = int(np.argmin(abs(R[2])))
        return atan2(R[1, self._axis], R[0, self._axis])


def _course(velocity: Array) -> float:
    return atan2(velocity[1], velocity[0])
