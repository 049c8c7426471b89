"""How a machine moved between a node and a time nearby, as the IMU measured it: what clocks that are off are about.

A machine that its engine shakes moves otherwise in 50 ms than its velocity at one end says: taken for its motion, that
velocity makes the offset of a clock look up to a third smaller than it is.
"""

from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import STEADY

LEAST_S = 1e-3  # over less the machine moves evenly
SHAKEN_S = 0.1  # over less its acceleration is that of its engine


class Motion(NamedTuple):
    """How a machine moves over a time from a node on.

    Attributes:
        twist_beyond: (6,) by how much the mean twist of I differs from that at the node [rad/s, m/s].
        acceleration: (3,) mean, in the axes of I at the node [m/s^2].
    """

    twist_beyond: Array
    acceleration: Array


UNKNOWN = Motion(STEADY, STEADY[:3])


class MotionNearby:
    """How a machine moves over a time from a node on, or over one that ends there.

    Args:
        imu: the samples.
        stamp_ns: of the node.
        nav: its state.
        angular_velocity: (3,) of I there [rad/s].
        bias: of the IMU.
        gravity: magnitude [m/s^2].
    """

    __slots__ = ("_before", "_bias", "_gravity", "_imu", "_known", "_nav", "_rate", "_stamp_ns")

    def __init__(
        self,
        imu: ImuBuffer,
        stamp_ns: int,
        nav: gtsam.NavState,
        angular_velocity: Array,
        *,
        bias: gtsam.imuBias.ConstantBias,
        gravity: float,
    ) -> None:
        self._imu, self._gravity, self._stamp_ns = imu, gravity, stamp_ns
        self._nav, self._rate, self._bias = nav, angular_velocity, bias
        self._known = (0.0, UNKNOWN)  # over how long [s]
        self._before: Array | None = None  # acceleration of the last tenth of a second

    def twist_beyond(self, duration_s: float) -> Array:
        """Return by how much the mean twist (6,) over a time differs from that at the node; zero if it is too short.

        In the axes of I at the node [rad/s, m/s]; a negative time ends at the node. Where the IMU did not measure all
        along, it is zero.
        """
        return UNKNOWN.twist_beyond if abs(duration_s) < LEAST_S else self._over(duration_s).twist_beyond

    def acceleration(self, duration_s: float) -> Array:
        """Return the mean acceleration (3,) over a time in the axes of I [m/s^2]; before the node if it is too short.

        Zero where the IMU did not measure all along.
        """
        if abs(duration_s) >= SHAKEN_S:
            return self._over(duration_s).acceleration
        if self._before is None:  # kept beside what is known over the offset, which a velocity asks for in turn
            self._before = self._measured(-SHAKEN_S).acceleration
        return self._before

    def _over(self, duration_s: float) -> Motion:
        """Return the motion over a time; at nearly the same times, as an offset is estimated, the same as before."""
        over_s, known = self._known
        if abs(duration_s - over_s) >= LEAST_S:
            known = self._measured(duration_s)
            self._known = duration_s, known
        return known

    def _measured(self, duration_s: float) -> Motion:
        there_ns = self._stamp_ns + round(duration_s * 1e9)
        start_ns, end_ns = min(self._stamp_ns, there_ns), min(max(self._stamp_ns, there_ns), self._imu.latest_ns)
        dt_s = (end_ns - start_ns) * 1e-9
        if dt_s < LEAST_S or not self._imu.is_trusted(start_ns, end_ns):
            return UNKNOWN
        R, v, p = self._imu.motion(start_ns, end_ns, self._bias.vector())
        velocity = self._nav.bodyVelocity()
        falling = self._nav.attitude().unrotate(np.array([0.0, 0.0, -self._gravity]))
        if duration_s > 0.0:
            moved = gtsam.Pose3(gtsam.Rot3(R), velocity * dt_s + 0.5 * falling * dt_s**2 + p)
            mean, gained = gtsam.Pose3.Logmap(moved) / dt_s, falling * dt_s + v
        else:  # from the start of the stretch, whose attitude in the axes of the node is R^T
            gained = falling * dt_s + R.T @ v
            at_start = velocity - gained
            moved = gtsam.Pose3(gtsam.Rot3(R.T), -(at_start * dt_s + 0.5 * falling * dt_s**2 + R.T @ p))
            mean = gtsam.Pose3.Logmap(moved) / -dt_s
        return Motion(mean - np.concatenate([self._rate, velocity]), gained / dt_s)
