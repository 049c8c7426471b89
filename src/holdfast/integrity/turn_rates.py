"""How fast an odometry says that the machine turns, beside the gyroscope: whether its clock is seconds off.

It turns as fast however it is mounted, and wherever it is.
"""

from math import radians

import gtsam
import numpy as np

from holdfast.graph.smoother import Smoother
from holdfast.integrity.far_delay import FarDelay, Seen
from holdfast.messages import Array
from holdfast.sensors.odometry import TrackPose

STEP_NS, MAX_STEP_NS = 350_000_000, 1_500_000_000  # over which a rate is a mean
BESIDE_RAD_S = radians(2.0)  # by which rates that are late are beside the gyroscope's at least, in the mean


class TurnRates:
    """Those of one odometry."""

    def __init__(self) -> None:
        self._delay = FarDelay(BESIDE_RAD_S, is_angle=False)
        self._before: TrackPose | None = None

    def clear(self) -> None:
        """Forget them: their stamps mean something else now."""
        self._delay.clear()
        self._before = None

    def delay_s(self, smoother: Smoother, pose: TrackPose) -> float | None:
        """Take in a pose by its own clock; return by how much that is ahead [s], if it is far off."""
        before, imu = self._before, smoother.imu
        if before is None or pose.begins_anew:
            self._before = pose
            return None
        start_ns, end_ns = before.claimed_ns, pose.claimed_ns
        if 0 < (time_ns := end_ns - start_ns) < STEP_NS:
            return None
        self._before = pose
        if not 0 < time_ns <= MAX_STEP_NS or not imu.is_trusted(start_ns, end_ns):
            return None
        by_odometry = before.T_I0_I.rotation().between(pose.T_I0_I.rotation()).matrix()
        by_gyroscope = imu.motion(start_ns, end_ns, smoother.newest.bias.vector()).R
        time_s = time_ns * 1e-9
        rates = _angle_rad(by_odometry) / time_s, _angle_rad(by_gyroscope) / time_s
        self._delay.note(Seen(start_ns + time_ns // 2, rates[0], 0.0, rates[1]))
        return self._delay.delay_s()


def _angle_rad(R: Array) -> float:
    return float(np.linalg.norm(gtsam.Rot3.Logmap(gtsam.Rot3(R))))
