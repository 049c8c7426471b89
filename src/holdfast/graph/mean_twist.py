"""How a machine moved between a node and a time nearby, as the IMU measured it: what clocks that are off are about.

A machine that its engine shakes moves otherwise in 50 ms than its velocity at one end says: taken for its motion, that
velocity makes the offset of a clock look up to a third smaller than it is.
"""

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.sensor import STEADY

LEAST_S = 1e-3  # over less the machine moves evenly


class MeanTwist:
    """By how much the mean twist of I over a time from a node on differs from that at the node.

    Args:
        imu: the samples.
        stamp_ns: of the node.
        nav: its state.
        angular_velocity: (3,) of I there [rad/s].
        bias: of the IMU.
        gravity: magnitude [m/s^2].
    """

    __slots__ = ("_beyond", "_bias", "_gravity", "_imu", "_nav", "_over_s", "_rate", "_stamp_ns")

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
        self._over_s, self._beyond = 0.0, STEADY

    def __call__(self, duration_s: float) -> Array:
        """Return the difference (6,) [rad/s, m/s], in the axes of I at the node; a negative time ends at the node.

        It is asked for again at nearly the same times, as an offset is estimated, and then the same as before. Where
        the IMU did not measure all along, it is zero.
        """
        if abs(duration_s - self._over_s) >= LEAST_S:
            self._over_s, self._beyond = duration_s, self._over(duration_s)
        return self._beyond

    def _over(self, duration_s: float) -> Array:
        there_ns = self._stamp_ns + round(duration_s * 1e9)
        start_ns, end_ns = min(self._stamp_ns, there_ns), min(max(self._stamp_ns, there_ns), self._imu.latest_ns)
        dt_s = (end_ns - start_ns) * 1e-9
        if dt_s < LEAST_S or start_ns < self._imu.oldest_ns or not self._imu.is_trusted(start_ns, end_ns):
            return STEADY
        R, v, p = self._imu.motion(start_ns, end_ns, self._bias.vector())
        velocity = self._nav.bodyVelocity()
        falling = self._nav.attitude().unrotate(np.array([0.0, 0.0, -self._gravity]))
        if duration_s > 0.0:
            moved = gtsam.Pose3(gtsam.Rot3(R), velocity * dt_s + 0.5 * falling * dt_s**2 + p)
        else:  # from the start of the stretch, whose attitude in the axes of the node is R^T
            at_start = velocity - falling * dt_s - R.T @ v
            moved = gtsam.Pose3(gtsam.Rot3(R.T), -(at_start * dt_s + 0.5 * falling * dt_s**2 + R.T @ p))
        mean = gtsam.Pose3.Logmap(moved) / (dt_s if duration_s > 0.0 else -dt_s)
        beyond: Array = mean - np.concatenate([self._rate, velocity])
        return beyond
