"""The lidar as a witness against GNSS: a receiver whose fixes walk away drags the odometry's frame through the world.

Fixes that are wrong by a little more each time pass every test of single fixes, because the estimate follows them. But
the frame of the lidar odometry would then have to drift as the fixes walk, and over some seconds that is more than any
odometry drifts: (32) in docs/math.md. How much this one drifts is learnt while GNSS is trusted.
"""

from collections import deque
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.scans import Scan
from holdfast.messages import Array
from holdfast.sensors.lidar import LidarModel

MEMORY_NS = 20_000_000_000
STEP_NS = 1_000_000_000
SIGMA = 5.0  # twenty comparisons a second must not raise an alarm in hours
ESTIMATE_SIGMA_M = 0.01  # of the estimate that the frame is seen through, per axis, whatever it claims
SLIP_M_S = 0.3  # fixes hardly walk so fast: an odometry that is off by more has lost its hold
LEARNT, MIN_LEARNT = 120, 30  # steps
BEST = 0.3  # of the configured noise: no odometry is believed to be better
TYPICAL_MAX = 3.0  # of some dozen norms of three unit Gaussians; the tails are what false alarms are made of
LEARNING_STEPS = 3


class _Sight(NamedTuple):
    """The frame of the odometry in W as one scan saw it, and how far it may have drifted until then."""

    scan: Scan
    T_W_I0: gtsam.Pose3
    translation_variance: float
    rotation_variance: float
    estimate_variance: float


class Contradiction(NamedTuple):
    """What the lidar says against the estimate.

    Attributes:
        T_W_I0: the odometry's frame in W as it was when they agreed.
        distance_m: between where that puts the machine and the estimate.
        sigma_m: of that distance.
        since_ns: until when they agreed.
        is_slip: the lidar has lost its hold, rather than that GNSS lies.
    """

    T_W_I0: gtsam.Pose3
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
        self._doubtful: deque[tuple[int, float]] = deque()  # not learnt yet: a walk may have begun

    def forget(self) -> None:
        """Forget where the frame was: the estimate has jumped, or the odometry has."""
        self._sights.clear()

    def forget_after(self, stamp_ns: int) -> None:
        """Forget where the frame was after a time: the estimate went astray then, and is now put back."""
        while self._sights and self._sights[-1].scan.stamp_ns > stamp_ns:
            self._sights.pop()

    def wants(self, scan: Scan) -> bool:
        """Whether a scan is to be observed: once a second is enough, and costs a marginal."""
        return not self._sights or scan.stamp_ns - self._sights[-1].scan.stamp_ns >= STEP_NS

    def observe(self, scan: Scan, T_W_I: gtsam.Pose3, covariance: Array) -> Contradiction | None:
        """Take in where a scan that is wanted was optimised to, and compare it with what was seen before.

        `covariance` (9, 9) is that of its node.
        """
        last = self._sights[-1] if self._sights else None
        sums = (0.0, 0.0)
        if last is not None:
            motion = last.scan.T_I0_I.between(scan.T_I0_I)
            sigmas = self._lidar.drift(motion, (scan.stamp_ns - last.scan.stamp_ns) * 1e-9)
            sums = last.translation_variance + sigmas[3] ** 2, last.rotation_variance + sigmas[0] ** 2
        variance = max(float(covariance[3:6, 3:6].trace()) / 3.0, ESTIMATE_SIGMA_M**2)
        sight = _Sight(scan, T_W_I * scan.T_I0_I.inverse(), *sums, variance)
        while self._sights and scan.stamp_ns - self._sights[0].scan.stamp_ns > MEMORY_NS:
            self._sights.popleft()
        found = self._compare(sight)
        self._sights.append(sight)
        return found

    def _compare(self, now: _Sight) -> Contradiction | None:
        scale = self._scale()
        worst, worst_ratio = None, SIGMA
        for then in self._sights:
            ratio = self._miss_m(then, now) / self._sigma_m(then, now, scale)
            if ratio > worst_ratio:
                worst, worst_ratio = then, ratio
        if worst is None or len(self._ratios) + len(self._doubtful) < MIN_LEARNT:
            self._learn(now)
            return None
        since_ns = worst.scan.stamp_ns
        while self._doubtful and self._doubtful[-1][0] > since_ns:
            self._doubtful.pop()  # what was seen since the two parted was no drift
        distance = self._miss_m(worst, now)
        return Contradiction(
            worst.T_W_I0,
            distance,
            distance / worst_ratio,
            since_ns,
            distance > SLIP_M_S * (now.scan.stamp_ns - since_ns) * 1e-9,
        )

    def _scale(self) -> float:
        """Return how much worse than configured the odometry is, as learnt: at first from all that was seen."""
        if len(self._ratios) >= MIN_LEARNT:
            return max(BEST, max(self._ratios) / TYPICAL_MAX)
        seen = [*self._ratios, *(ratio for _, ratio in self._doubtful)]
        return max(BEST, max(seen) / TYPICAL_MAX) if seen else 1.0

    def _learn(self, now: _Sight) -> None:
        """Keep what is seen now, and learn from what was seen so long ago that a walk would have been found since."""
        if len(self._sights) >= LEARNING_STEPS:
            then = self._sights[-LEARNING_STEPS]
            self._doubtful.append((now.scan.stamp_ns, self._miss_m(then, now) / self._sigma_m(then, now, 1.0)))
        while self._doubtful and now.scan.stamp_ns - self._doubtful[0][0] > MEMORY_NS:
            self._ratios.append(self._doubtful.popleft()[1])

    def _miss_m(self, then: _Sight, now: _Sight) -> float:
        """Return how far the machine of now lies from where the frame of then puts it [m]."""
        place = now.scan.T_I0_I.translation()
        return float(np.linalg.norm(now.T_W_I0.transformFrom(place) - then.T_W_I0.transformFrom(place)))

    def _sigma_m(self, then: _Sight, now: _Sight, scale: float) -> float:
        """Return the standard deviation of the miss per axis, what the odometry adds to it scaled."""
        moved = float(np.linalg.norm(now.scan.T_I0_I.translation() - then.scan.T_I0_I.translation()))
        turned, shifted = self._lidar.pose_variances()
        of_lidar = now.translation_variance - then.translation_variance + 2.0 * shifted
        of_lidar += (now.rotation_variance - then.rotation_variance + turned) * moved**2
        return float(np.sqrt(scale**2 * of_lidar + now.estimate_variance + then.estimate_variance))
