"""The lidar as a witness against GNSS: a receiver whose fixes walk away drags the odometry's frame through the world.

Fixes that are wrong by a little more each time pass every test of single fixes, because the estimate follows them. But
the frame of the lidar odometry would then have to drift as the fixes walk, and over some seconds that is more than any
odometry drifts: (32) in docs/math.md. How much this one drifts is learnt while GNSS is trusted.
"""

from collections import deque
from statistics import median
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.scans import Scan
from holdfast.sensors.lidar import LidarModel

MEMORY_NS = 20_000_000_000
STEP_NS = 1_000_000_000
SIGMA = 4.5
ESTIMATE_SIGMA_M = 0.012  # of the estimate that the frame is seen through, per axis
SLIP_RATIO = 0.1  # of the way: an odometry that is off by more has lost its hold; fixes hardly walk so fast
MIN_WAY_M = 2.0  # on a shorter way nothing slips
LEARNT, MIN_LEARNT = 60, 10  # steps
TYPICAL_RATIO = 1.54  # median of the norm of three unit Gaussians
LEARNING_STEPS = 3


class _Sight(NamedTuple):
    """The frame of the odometry in W as one scan saw it, and how far it may have drifted until then."""

    scan: Scan
    T_W_I0: gtsam.Pose3
    way_m: float
    translation_variance: float
    rotation_variance: float


class Contradiction(NamedTuple):
    """What the lidar says against the estimate.

    Attributes:
        correction: from the estimate to where the lidar sees the machine, in W.
        distance_m: between the two.
        sigma_m: of that distance.
        since_ns: until when they agreed.
        is_slip: the lidar has lost its hold, rather than that GNSS lies.
    """

    correction: gtsam.Pose3
    distance_m: float
    sigma_m: float
    since_ns: int
    is_slip: bool


class LidarWitness:
    """Watches how the frame of the odometry moves in W while GNSS is trusted."""

    def __init__(self, lidar: LidarModel) -> None:
        self._lidar = lidar
        self._sights: deque[_Sight] = deque()
        self._ratios: deque[float] = deque(maxlen=LEARNT)

    def forget(self) -> None:
        """Forget where the frame was: the estimate has jumped, or the odometry has."""
        self._sights.clear()

    def forget_after(self, stamp_ns: int) -> None:
        """Forget where the frame was after a time: the estimate went astray then, and is now put back."""
        while self._sights and self._sights[-1].scan.stamp_ns > stamp_ns:
            self._sights.pop()

    def observe(self, scan: Scan, T_W_I: gtsam.Pose3) -> Contradiction | None:
        """Take in where a scan's node was optimised to; once a second it is compared with what was seen before."""
        last = self._sights[-1] if self._sights else None
        if last is not None and scan.stamp_ns - last.scan.stamp_ns < STEP_NS:
            return None
        sums = (0.0, 0.0, 0.0)
        if last is not None:
            motion = last.scan.T_I0_I.between(scan.T_I0_I)
            sigmas = self._lidar.drift(motion, (scan.stamp_ns - last.scan.stamp_ns) * 1e-9)
            way = last.way_m + float(np.linalg.norm(motion.translation()))
            sums = way, last.translation_variance + sigmas[3] ** 2, last.rotation_variance + sigmas[0] ** 2
        sight = _Sight(scan, T_W_I * scan.T_I0_I.inverse(), *sums)
        while self._sights and scan.stamp_ns - self._sights[0].scan.stamp_ns > MEMORY_NS:
            self._sights.popleft()
        found = self._compare(sight)
        self._sights.append(sight)
        return found

    def _compare(self, now: _Sight) -> Contradiction | None:
        worst, worst_ratio = None, 0.0
        for index, then in enumerate(self._sights):
            ratio = self._ratio(then, now)
            if index == len(self._sights) - LEARNING_STEPS:
                self._ratios.append(ratio)
            if ratio > worst_ratio:
                worst, worst_ratio = then, ratio
        if worst is None or len(self._ratios) < MIN_LEARNT:
            return None
        if worst_ratio <= SIGMA * max(1.0, median(self._ratios) / TYPICAL_RATIO):
            return None
        distance, way = self._miss_m(worst, now), now.way_m - worst.way_m
        return Contradiction(
            worst.T_W_I0 * now.T_W_I0.inverse(),
            distance,
            distance / worst_ratio,
            worst.scan.stamp_ns,
            way > MIN_WAY_M and distance > SLIP_RATIO * way,
        )

    def _miss_m(self, then: _Sight, now: _Sight) -> float:
        """Return how far the machine of now lies from where the frame of then puts it [m]."""
        place = now.scan.T_I0_I.translation()
        return float(np.linalg.norm(now.T_W_I0.transformFrom(place) - then.T_W_I0.transformFrom(place)))

    def _ratio(self, then: _Sight, now: _Sight) -> float:
        """Return the miss over its standard deviation per axis."""
        moved = float(np.linalg.norm(now.scan.T_I0_I.translation() - then.scan.T_I0_I.translation()))
        variance = now.translation_variance - then.translation_variance
        variance += (now.rotation_variance - then.rotation_variance) * moved**2 + 2.0 * ESTIMATE_SIGMA_M**2
        return self._miss_m(then, now) / float(np.sqrt(variance))
