"""Learns whether gyroscope or odometry is wrong about the heading, with measured headings as the third witness.

No residual is of an estimate that the same numbers have led: raw headings, the gyroscope alone and the odometry alone
are compared over spans of seconds. The estimate only stands between them, and cancels.
"""

from collections import deque
from collections.abc import Callable, Sequence
from math import exp, remainder, tau
from statistics import fmean
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.smoother import Smoother
from holdfast.integrity.learnt_snapshot import LearntYaw
from holdfast.integrity.yaw_scales import Turned, YawScales
from holdfast.messages import Array
from holdfast.sensors.odometry import OdometryNoise, TrackPose

SPANS = 10, 20, 60  # steps, each of about a second: shorter ones show the noise of poses and headings
MEMORY_S = 600.0
SLOW_SHARE, SLOW_S = 0.5, 60.0  # of the error of a heading
LEAST_RAD = 1e-4  # of a heading
WITNESS_NS = 250_000_000  # how near in time a witness must be


class Witness(NamedTuple):
    """By how much headings are beyond the estimate [rad], and the variances of their white and slow error [rad^2]."""

    beyond_rad: float
    white: float
    slow: float

    @classmethod
    def of(cls, beyond_rad: Sequence[float], claimed: Sequence[float]) -> "Witness | None":
        """Return what headings of the same half second say together, given their variances; None if there are none."""
        if not beyond_rad:
            return None
        variance = fmean(claimed)
        return cls(fmean(beyond_rad), (1.0 - SLOW_SHARE) * variance / len(claimed), SLOW_SHARE * variance)


HeadingWitness = Callable[[Smoother, int], Witness | None]
"""Tells what headings say of the estimate of a smoother near a time [ns]."""


class _Place(NamedTuple):
    """Where the machine heads, as three see it, beyond the estimate; angles and variances are sums since the first."""

    R_W_I: gtsam.Rot3  # estimated
    by_gyroscope_rad: float
    by_odometry_rad: float
    gyroscope_variance: float
    drift_variance: float
    turned_rad: Array
    time_s: float
    witness: Witness | None


class YawLearning:
    """What one odometry, the gyroscope and the headings say of each other: (72), (73) in docs/math.md.

    Args:
        noise: of the odometry.
        carried: what was learnt before.
    """

    def __init__(self, noise: OdometryNoise, carried: LearntYaw | None = None) -> None:
        self._noise = noise
        self._scales = YawScales(carried, noise.scale)
        self._places: deque[_Place] = deque(maxlen=max(SPANS) + 1)

    @property
    def gyroscope_scale(self) -> float:
        """How many times larger the gyroscope's noise is than configured, about the vertical."""
        return self._scales.values[0]

    @property
    def odometry_scale(self) -> float:
        """How many times faster the odometry drifts than configured, about the vertical."""
        return self._scales.values[1]

    def learnt(self) -> LearntYaw | None:
        """Return what is believed of the scales, of the odometry that of its configuration."""
        return self._scales.learnt(self._noise.scale)

    def begin_anew(self) -> None:
        """Nothing before is to be compared with what comes."""
        self._places.clear()

    def learn(
        self,
        smoother: Smoother,
        first: TrackPose,
        last: TrackPose,
        motion: gtsam.Pose3,
        *,
        measured_R: Array,
        witness: Witness | None,
    ) -> None:
        """Take in a step between two poses that have nodes.

        Args:
            smoother: whose estimate stands between the witnesses.
            first: pose at its start.
            last: pose at its end, the `first` of the next step.
            motion: from first to last by the odometry.
            measured_R: (3, 3) rotation from first to last by the gyroscope.
            witness: a heading near the last pose, None where there is none.
        """
        now = smoother.nav(last.stamp_ns).attitude()
        if not self._places:
            then = smoother.nav(first.stamp_ns).attitude()
            self._places.append(_Place(then, 0.0, 0.0, 0.0, 0.0, np.zeros(3), 0.0, None))
        before, duration_s = self._places[-1], (last.claimed_ns - first.claimed_ns) * 1e-9
        estimated = now.between(before.R_W_I)  # back
        up = before.R_W_I.unrotate(np.array([0.0, 0.0, 1.0]))
        turned = gtsam.Rot3(measured_R)
        by_gyroscope = float(up @ gtsam.Rot3.Logmap(turned * estimated))
        by_odometry = float(up @ gtsam.Rot3.Logmap(motion.rotation() * estimated))
        rotation_rad = float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation())))
        here = _Place(
            now,
            before.by_gyroscope_rad + by_gyroscope,
            before.by_odometry_rad + by_odometry,
            before.gyroscope_variance + smoother.imu_noise.rotation_variance(rotation_rad, duration_s),
            before.drift_variance + float(self._noise.drift(motion, duration_s)[0]) ** 2,
            before.turned_rad + gtsam.Rot3.Logmap(turned),
            before.time_s + duration_s,
            witness,
        )
        self._places.append(here)
        for span in SPANS:
            if len(self._places) > span:
                since = self._places[-1 - span]
                turned_rad, time_s = here.turned_rad - since.turned_rad, here.time_s - since.time_s
                self._compare(since, here, float(up @ smoother.turning_covariance(turned_rad, time_s) @ up), 1.0 / span)
        self._scales.forget(duration_s / MEMORY_S)

    def _compare(self, then: _Place, here: _Place, constant: float, weight: float) -> None:
        time_s = here.time_s - then.time_s
        of_poses = self._noise.learnt.rotation_noise**2 * 2.0 * self._noise.pose_variances()[0]
        gyroscope = Turned(here.gyroscope_variance - then.gyroscope_variance, constant)
        odometry = Turned(here.drift_variance - then.drift_variance, of_poses)
        by_gyroscope = here.by_gyroscope_rad - then.by_gyroscope_rad
        by_odometry = here.by_odometry_rad - then.by_odometry_rad
        if here.witness is None or then.witness is None:
            self._scales.learn_from_two(by_odometry - by_gyroscope, gyroscope, odometry, weight)
            return
        white = here.witness.white + then.witness.white
        slow = (here.witness.slow + then.witness.slow) * (1.0 - exp(-time_s / SLOW_S))
        headings = Turned(white + slow, LEAST_RAD**2)
        seen = remainder(here.witness.beyond_rad - then.witness.beyond_rad, tau)
        beyond = seen - by_gyroscope, seen - by_odometry
        self._scales.learn_from_three(beyond, gyroscope, odometry, headings, weight)
