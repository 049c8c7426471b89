"""Whether an odometry is trusted: one that goes on lying is lost, and regained when it moves as the estimate does.

A lidar in a tunnel says that the machine stands, one on a ferry that it turns. A jump or a slip begins the frame of an
odometry anew, and is over. One that slips again, or whose motions the IMU contradicts one after another, would hold the
estimate at every pose, and be believed by itself. Once it is lost, nothing of it enters; it is watched once a second.
"""

from collections import deque
from itertools import pairwise
from math import radians
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.geometry.motions import size_of
from holdfast.integrity.mount_finding import found_mount
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.odometry import TrackPose
from holdfast.sensors.odometry_calibration import FOUND_RAD, OdometryCalibration, apart_rad

JUMPS_IN_A_ROW, ONE_WAY = 4, 0.7  # so many of which the sum is so much of their sizes
SLIPS_NS, LYING = 5_000_000_000, 0.25  # a second slip in this time is no slip, if by so much of the way
STEP_NS = 1_000_000_000
MAX_STEP_NS = 3 * STEP_NS
AGREES_NS = 5_000_000_000  # for so long it must have moved as the estimate
AGREES_M, AGREES_RAD = 0.3, radians(5.0)  # over that time, or
AGREES = 0.1  # of the way
MOVED_M, MOVED_RAD = 1.0, radians(15.0)  # either: at standstill any odometry agrees
SIGMA = 3.0  # of the estimate
REMEMBERED, SEARCHED = 60, 30  # poses
FEWEST_STEPS, MOST_AGREE = 8, 0.8  # of those in which a mount is looked for
REFITTED = 2  # times


class Watched(NamedTuple):
    """A pose of the odometry, where the machine was estimated then, and the covariance (9, 9) of that."""

    pose: TrackPose
    T_W_I: gtsam.Pose3
    covariance: Array


class OdometryTrust:
    """The trust in one odometry.

    Args:
        calibration: of the odometry.

    Attributes:
        is_lost: whether it is not trusted.
        lies_since_ns: since when it seems to lie, by the last motion that the IMU could judge; None: it does not.
        watched: the pose that is compared next, when fixes have come beside it; of use only while it is not.
        mount: the rotation vector (3,) by which the odometry is mounted otherwise than configured, if it was found with
            that the odometry has moved as the estimate; in the axes of its sensor [rad].
    """

    def __init__(self, calibration: OdometryCalibration) -> None:
        self.is_lost = False
        self._calibration = calibration
        self._jumps: list[tuple[int, Array]] = []  # in a row
        self.lies_since_ns: int | None = None
        self._slipped_ns = NEVER_NS
        self.watched: TrackPose | None = None
        self._seen: deque[Watched] = deque(maxlen=REMEMBERED)  # all of which agree
        self._known: deque[Watched] = deque(maxlen=SEARCHED)  # the newest in a row, whether they agree or not
        self.mount: Array | None = None

    def note_motion(self, stamp_ns: int, jump: Array | None) -> None:
        """Note a motion, and by how many sigmas (6,) the IMU contradicts it.

        Noise and outliers take back with one motion what they added with another; a lie goes on in its direction.
        """
        if jump is None:
            self._jumps.clear()
            self.lies_since_ns = None
            return
        self._jumps = [*self._jumps[1 - JUMPS_IN_A_ROW :], (stamp_ns, jump)]
        sigmas = np.array([of_one for _, of_one in self._jumps])
        is_one_way = np.linalg.norm(sigmas.sum(axis=0)) > ONE_WAY * np.linalg.norm(sigmas, axis=1).sum()
        if len(self._jumps) < JUMPS_IN_A_ROW or not is_one_way:
            self.lies_since_ns = None
        elif self.lies_since_ns is None:
            self.lies_since_ns = self._jumps[0][0]

    def note_slip(self, stamp_ns: int, distance_m: float, moved_m: float) -> bool:
        """Note a slip over a way; say whether it is not the first of late, so that the odometry lies.

        One that slips by a share of the way is worth more than none, as where the IMU is silent.
        """
        if distance_m < LYING * moved_m:
            return False
        before, self._slipped_ns = self._slipped_ns, stamp_ns
        return stamp_ns - before < SLIPS_NS

    def lose(self) -> None:
        """Trust it no more."""
        self.is_lost, self.watched, self._slipped_ns = True, None, NEVER_NS
        self._jumps.clear()
        self.lies_since_ns = None
        self._seen.clear()
        self._known.clear()
        self.mount = None

    def is_due(self, pose: TrackPose) -> bool:
        """Whether a pose is to be watched: one a second."""
        return self.watched is None or pose.stamp_ns - self.watched.stamp_ns >= STEP_NS

    def watch(self, pose: TrackPose, seen: Watched | None, calibration: Array, *, is_led: bool) -> bool:
        """Take in where the machine was at the pose that was watched before, and watch another, which is due.

        Args:
            pose: to be watched from now on.
            seen: what the estimate says of the one before; None if it says nothing any more.
            calibration: (8,) what is believed of the odometry.
            is_led: fixes lead the estimate: where it knows little now, it will soon know more.

        Returns:
            Whether the odometry has moved as the estimate for long enough to be trusted again.
        """
        self.watched = pose
        is_known = seen is not None and not (is_led and self._knows_little(seen))
        if seen is None or not is_known or not self._agrees(seen, calibration):
            self._seen.clear()
        if seen is None or not is_known:
            self._known.clear()
        else:
            self._seen.append(seen)
            self._known.append(seen)
        if self._has_agreed():
            self.is_lost = False
        elif is_led and self._calibration.is_mount_estimated:
            self.mount = self._find_mount(calibration)
            self.is_lost = self.mount is None
        return not self.is_lost

    def _find_mount(self, calibration: Array) -> Array | None:
        """Return how the odometry is mounted, if not as estimated, and if it has moved as the estimate by that."""
        steps = [pair for pair in pairwise(self._known) if pair[1].pose.stamp_ns - pair[0].pose.stamp_ns <= MAX_STEP_NS]
        agreeing = steps
        for _ in range(REFITTED):  # without outliers
            if len(agreeing) < max(FEWEST_STEPS, MOST_AGREE * len(steps)):
                return None
            delta = found_mount(*zip(*(self._motions_of_sensor(*step) for step in agreeing), strict=True))
            if delta is None or apart_rad(delta, calibration[:3]) < FOUND_RAD:
                return None
            mounted = np.concatenate([delta, calibration[3:]])
            agreeing = [step for step in steps if self._moved_alike(*step, mounted)]
        if len(agreeing) < MOST_AGREE * len(steps) or not self._moved_alike(agreeing[0][0], agreeing[-1][1], mounted):
            return None
        return delta

    def _motions_of_sensor(self, then: Watched, now: Watched) -> tuple[gtsam.Pose3, gtsam.Pose3]:
        """Return how the sensor, as it is configured, has moved by the estimate, and by its own poses."""
        by_estimate, by_poses = then.T_W_I.between(now.T_W_I), then.pose.T_I0_I.between(now.pose.T_I0_I)
        return self._calibration.of_sensor(by_estimate), self._calibration.of_sensor(by_poses)

    def _knows_little(self, now: Watched) -> bool:
        """Whether the estimate knows less of the motion since the pose before than by what an odometry may differ."""
        if not self._seen:
            return False
        then = self._seen[-1]
        moved_m = float(np.linalg.norm(now.T_W_I.translation() - then.T_W_I.translation()))
        return _sigma_m(then, now, moved_m) > max(AGREES_M, AGREES * moved_m)

    def _has_agreed(self) -> bool:
        """Whether the run of poses that agree is long enough, and the machine has moved meanwhile."""
        if not self._seen or self._seen[-1].pose.stamp_ns - self._seen[0].pose.stamp_ns < AGREES_NS:
            return False
        moved = (size_of(self._seen[0].T_W_I.between(one.T_W_I)) for one in self._seen)
        return any(moved_m >= MOVED_M or turned_rad >= MOVED_RAD for moved_m, turned_rad in moved)

    def _agrees(self, now: Watched, calibration: Array) -> bool:
        """Whether the odometry has moved as the estimate since the first pose of a run, and since the one before."""
        if not self._seen:
            return True
        is_near = now.pose.stamp_ns - self._seen[-1].pose.stamp_ns <= MAX_STEP_NS
        return is_near and all(self._moved_alike(then, now, calibration) for then in (self._seen[0], self._seen[-1]))

    def _moved_alike(self, then: Watched, now: Watched, calibration: Array) -> bool:
        motion = self._calibration.motion(then.pose.T_I0_I.between(now.pose.T_I0_I), calibration)
        apart = now.T_W_I.between(then.T_W_I.compose(motion))
        by_estimate_m = float(np.linalg.norm(now.T_W_I.translation() - then.T_W_I.translation()))
        moved_m = max(float(np.linalg.norm(motion.translation())), by_estimate_m)
        attitude_rad = np.sqrt(now.covariance.diagonal()[:3].mean())
        reach_m = max(AGREES_M, AGREES * moved_m) + SIGMA * _sigma_m(then, now, moved_m)
        apart_m, turned_rad = size_of(apart)
        return bool(apart_m <= reach_m and turned_rad <= AGREES_RAD + SIGMA * attitude_rad)


def _sigma_m(then: Watched, now: Watched, moved_m: float) -> float:
    """Return what the estimate knows of the motion from then to now, which is so long [m]."""
    dt_s, variances = (now.pose.stamp_ns - then.pose.stamp_ns) * 1e-9, now.covariance.diagonal()
    return float(np.sqrt(variances[6:9].mean() * dt_s**2 + variances[:3].mean() * moved_m**2))
