"""The drift monitor of an odometry against GNSS: a receiver whose fixes walk away drags the odometry's frame through W.

Fixes that are wrong by a little more each time pass every test of single fixes, because the estimate follows them. But
the frame of the odometry would then have to drift as the fixes walk, and over some seconds that is more than any
odometry drifts: (32) in docs/math.md. How much this one drifts is learnt while GNSS is trusted.
"""

from collections import deque
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.integrity.consensus import WALK_M_S
from holdfast.messages import Array
from holdfast.sensors.odometry import OdometryNoise, TrackPose
from holdfast.sensors.odometry_calibration import NOMINAL

MEMORY_NS = 20_000_000_000
STEP_NS = 1_000_000_000
FRESH_NS = 3 * STEP_NS  # an older observation says nothing of now
SIGMA = 5.0  # twenty comparisons a second must not raise an alarm in hours
VOUCHING_SIGMA = 2.5  # below it an odometry says that the estimate is right
ESTIMATE_SIGMA_M = 0.01  # of the estimate through which the frame is observed, per axis, whatever it claims
LEARNT, MIN_LEARNT = 120, 30  # steps
BEST = 0.3  # of the configured noise: no odometry is taken for better
TYPICAL_MAX = 3.0  # of some dozen norms of three unit Gaussians; the tails are what false alarms are made of
LEARNING_STEPS = 3


class _Observation(NamedTuple):
    """A pose of the odometry and where the machine was estimated then, and how far it may have drifted until then."""

    pose: TrackPose
    T_W_I: gtsam.Pose3
    translation_variance: float
    rotation_variance: float
    estimate_variance: float
    attitude_variance: float


AGREED_SCALE = 3.0  # of its configured drift


class Contradiction(NamedTuple):
    """What the odometry says against the estimate.

    Attributes:
        T_W_I: where the odometry sees the machine now, from where they agreed.
        distance_m: between where that puts the machine and the estimate.
        sigma_m: of that distance.
        since_ns: until when they agreed.
        is_slip: the odometry has lost its hold, rather than that GNSS is wrong.
        moved_m: how far the machine has moved since then, by the one that says more.
    """

    T_W_I: gtsam.Pose3
    distance_m: float
    sigma_m: float
    since_ns: int
    is_slip: bool
    moved_m: float


class DriftMonitor:
    """Follows how the frame of one odometry moves in W while GNSS is trusted."""

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise = noise
        self._observations: deque[_Observation] = deque()
        self._ratios: deque[float] = deque(maxlen=LEARNT)
        self._doubtful: deque[tuple[int, float]] = deque()  # not learnt yet: a walk may have begun
        self._worst_ratio = 0.0  # of residual and sigma, in the newest comparison
        self._calibration = NOMINAL

    def forget_frame(self) -> None:
        """Forget where the frame was, because the estimate or the odometry has jumped; what was learnt remains."""
        self._observations.clear()

    def forget_after(self, stamp_ns: int) -> None:
        """Forget where the frame was after a time: the estimate went astray then, and is now put back."""
        while self._observations and self._observations[-1].pose.stamp_ns > stamp_ns:
            self._observations.pop()

    def is_due(self, pose: TrackPose) -> bool:
        """Whether a pose is to be observed: once a second is enough, and costs a marginal."""
        return not self._observations or pose.stamp_ns - self._observations[-1].pose.stamp_ns >= STEP_NS

    def vouches(self, since_ns: int, now_ns: int) -> bool:
        """Whether the odometry, which is known well enough, agrees with the estimate now as it did at a time before."""
        observed = [one.pose.stamp_ns for one in self._observations]
        if not self._is_learnt() or not observed or self._worst_ratio > VOUCHING_SIGMA:
            return False
        return observed[0] <= since_ns and now_ns - observed[-1] <= FRESH_NS

    @property
    def has_agreed(self) -> bool:
        """Whether the odometry has moved as GNSS did for long enough to tell later who of them has begun to err."""
        return bool(self._observations) and self._is_learnt() and self._scale() <= AGREED_SCALE

    def observe(
        self, pose: TrackPose, T_W_I: gtsam.Pose3, covariance: Array, calibration: Array = NOMINAL
    ) -> Contradiction | None:
        """Take in where a pose that is due was optimised to, and compare it with what was observed before.

        `covariance` (9, 9) is that of its node, `calibration` (8,) what is believed of the odometry.
        """
        self._calibration = calibration
        last = self._observations[-1] if self._observations else None
        sums = (0.0, 0.0)
        if last is not None:
            motion = last.pose.T_I0_I.between(pose.T_I0_I)
            sigmas = self._noise.drift(motion, (pose.stamp_ns - last.pose.stamp_ns) * 1e-9)
            sums = last.translation_variance + sigmas[3] ** 2, last.rotation_variance + sigmas[0] ** 2
        variance = max(float(covariance[3:6, 3:6].trace()) / 3.0, ESTIMATE_SIGMA_M**2)
        attitude_variance = float(covariance[:3, :3].trace()) / 3.0
        observation = _Observation(pose, T_W_I, *sums, variance, attitude_variance)
        while self._observations and pose.stamp_ns - self._observations[0].pose.stamp_ns > MEMORY_NS:
            self._observations.popleft()
        found = self._compare(observation)
        self._observations.append(observation)
        return found

    def _compare(self, now: _Observation) -> Contradiction | None:
        scale = self._scale()
        ratios = [self._residual_m(then, now) / self._sigma_m(then, now, scale) for then in self._observations]
        self._worst_ratio = max(ratios, default=0.0)
        worst = self._observations[ratios.index(self._worst_ratio)] if self._worst_ratio > SIGMA else None
        if worst is None or not self._is_learnt():
            self._learn(now)
            return None
        since_ns = worst.pose.stamp_ns
        while self._doubtful and self._doubtful[-1][0] > since_ns:
            self._doubtful.pop()  # what was seen since the two parted was no drift
        distance = self._residual_m(worst, now)
        # an odometry that is off by more than fixes walk has lost its hold
        is_slip = distance > WALK_M_S * (now.pose.stamp_ns - since_ns) * 1e-9
        moved = max(_distance_m(worst.T_W_I, now.T_W_I), _distance_m(worst.pose.T_I0_I, now.pose.T_I0_I))
        seen, sigma = self._seen_from(worst, now), distance / self._worst_ratio
        return Contradiction(seen, distance, sigma, since_ns, is_slip, moved)

    def _is_learnt(self) -> bool:
        """Whether enough was seen of the odometry for an alarm, and to vouch."""
        return len(self._ratios) + len(self._doubtful) >= MIN_LEARNT

    def _scale(self) -> float:
        """Return how much worse than configured the odometry is, as learnt: at first from all that was seen."""
        if len(self._ratios) >= MIN_LEARNT:
            return max(BEST, max(self._ratios) / TYPICAL_MAX)
        seen = [*self._ratios, *(ratio for _, ratio in self._doubtful)]
        return max(BEST, max(seen) / TYPICAL_MAX) if seen else 1.0

    def _learn(self, now: _Observation) -> None:
        """Keep what is seen now, and learn from what was seen so long ago that a walk would have been found since."""
        if len(self._observations) >= LEARNING_STEPS:
            then = self._observations[-LEARNING_STEPS]
            ratio = self._residual_m(then, now) / self._sigma_m(then, now, 1.0)
            of_translation, of_rotation = self._variances(then, now)
            if of_rotation > of_translation:  # at speed: that it turns well does not say that it measures ways well
                ratio = max(ratio, TYPICAL_MAX)
            self._doubtful.append((now.pose.stamp_ns, ratio))
        while self._doubtful and now.pose.stamp_ns - self._doubtful[0][0] > MEMORY_NS:
            self._ratios.append(self._doubtful.popleft()[1])

    def _sigma_m(self, then: _Observation, now: _Observation, scale: float) -> float:
        """Return the standard deviation of the residual per axis, what the odometry adds to it scaled."""
        of_translation, of_rotation = self._variances(then, now)
        moved = _distance_m(then.pose.T_I0_I, now.pose.T_I0_I)
        of_estimate = now.estimate_variance + then.estimate_variance + then.attitude_variance * moved**2
        return float(np.sqrt(scale**2 * (of_translation + of_rotation) + of_estimate))

    def _variances(self, then: _Observation, now: _Observation) -> tuple[float, float]:
        """Return what translation and rotation of the odometry, as configured, add to the residual per axis [m^2]."""
        moved = _distance_m(then.pose.T_I0_I, now.pose.T_I0_I)
        rotation_variance, translation_variance = self._noise.pose_variances()
        of_translation = now.translation_variance - then.translation_variance + 2.0 * translation_variance
        return of_translation, (now.rotation_variance - then.rotation_variance + rotation_variance) * moved**2

    def _residual_m(self, then: _Observation, now: _Observation) -> float:
        """Return how far the machine of now lies from where the odometry has carried that of then [m]."""
        return _distance_m(self._seen_from(then, now), now.T_W_I)

    def _seen_from(self, then: _Observation, now: _Observation) -> gtsam.Pose3:
        """Return the pose of the machine now as the odometry has carried it on from that of then."""
        motion = then.pose.T_I0_I.between(now.pose.T_I0_I)
        return then.T_W_I.compose(self._noise.calibration.motion(motion, self._calibration))


def _distance_m(a: gtsam.Pose3, b: gtsam.Pose3) -> float:
    return float(np.linalg.norm(b.translation() - a.translation()))
