"""What the estimator would start from now, ready for the day on which its state turns out to be wrong.

It collects measurements beside the graphs, and is asked only where positions that agree among themselves contradict
the estimate for long: position, velocity, heading and biases then begin anew, from these positions alone if they tell
the heading, else at the attitude as it is, held in doubt.
"""

from math import radians
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.estimator.initialisation import Initialising
from holdfast.sensors.sensor import Measurement
from holdfast.state import OptimisedState

COURSE_S = 3.0  # over which positions and velocities are averaged
DOUBT_RAD = radians(60.0)  # of a heading that is kept
TILT_DOUBT_RAD = radians(15.0)


class Beginning(NamedTuple):
    """A state to begin anew from, and why it is believed."""

    state: OptimisedState
    reason: str


class Successor:
    """Collects, and begins anew.

    Args:
        start: what the estimator has started from, or would.
        is_in_doubt: whether the heading of the estimate is, so that the first that motion tells is better.
    """

    def __init__(self, start: Initialising, *, is_in_doubt: bool = False) -> None:
        self.start = start
        self._is_in_doubt = is_in_doubt

    def add(self, measurement: Measurement) -> None:
        """Take in a checked measurement."""
        self.start.add(measurement)

    @property
    def oldest_ns(self) -> int:
        """Samples of the IMU before this time are of no use."""
        return self.start.oldest_ns

    def begin(self, current: OptimisedState) -> Beginning | None:
        """Return a state to begin anew from, now; `current` is the estimate that is contradicted."""
        state = self.start.attempt()
        self._is_in_doubt = state is None
        if state is not None:
            return Beginning(state, self.start.reason)
        moved = self._moved(current)
        return None if moved is None else Beginning(moved, "position and velocity of the fixes, the heading in doubt")

    def settle_doubt(self) -> Beginning | None:
        """Return a state to begin from once more, as soon as the motion tells the heading that was kept in doubt."""
        state = self.start.attempt() if self._is_in_doubt else None
        if state is None:
            return None
        self._is_in_doubt = False
        return Beginning(state, f"no longer in doubt: {self.start.reason}")

    def _moved(self, current: OptimisedState) -> OptimisedState | None:
        """Return the estimate with position and velocity of the positions, its attitude in doubt."""
        course = self.start.course(current.stamp_ns, COURSE_S)
        if course is None:
            return None
        nav, R = current.nav, current.nav.attitude().matrix()
        covariance = np.zeros((15, 15))
        covariance[9:, 9:] = current.covariance[9:, 9:]
        in_W = np.diag([TILT_DOUBT_RAD**2, TILT_DOUBT_RAD**2, DOUBT_RAD**2])
        covariance[:3, :3] = current.covariance[:3, :3] + R.T @ in_W @ R
        across = gtsam.SO3.Hat(course.p_I_P)
        covariance[3:6, 3:6] = R.T @ course.of_position @ R + across @ covariance[:3, :3] @ across.T
        covariance[6:9, 6:9] = R.T @ course.of_velocity @ R
        moved = gtsam.NavState(nav.attitude(), course.p_W_P - R @ course.p_I_P, course.v_W_P)
        return OptimisedState(current.stamp_ns, moved, current.bias, covariance, current.angular_velocity)
