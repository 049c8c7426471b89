"""How the poses of an odometry become factors of one smoother, in one of three ways.

anchored: each pose is joined to the track of its odometry, whose frame in W is a variable that drifts slowly. Poses
    hold each other over minutes, and say nothing of where they are: (29) in docs/math.md. The variable is the pose on
    the track where an epoch begins, so that no long lever acts on it.
relative: each pose is joined to the one before (paper, IV-A.4a).
frozen: the track stays where it was when the chain was frozen, at the loss of GNSS (paper, Eq. 10).
"""

from copy import copy
from math import radians, sqrt
from typing import Literal, NamedTuple

import gtsam
import numpy as np

from holdfast.events import Outcome
from holdfast.geometry.motions import size_of
from holdfast.graph.smoother import FREE, Smoother
from holdfast.messages import Array
from holdfast.sensors.odometry import STILL_M_S, OdometryNoise, TrackPose, is_possible, with_excess
from holdfast.sensors.odometry_calibration import OdometryCalibration
from holdfast.sensors.sensor import State

EPOCH_NS, EPOCH_M, EPOCH_RAD = 1_000_000_000, 0.4, 0.1  # within which the track does not drift
STUCK_SIGMA, STUCK_M, STUCK_RAD = 5.0, 0.05, radians(1.0)  # of the motion beside which an odometry says nothing new
AS_FAST = 2.0  # times as fast as it came there, at most
STOPS_M_S, STOPS_M_S2 = 1.0, 10.0  # no machine stops faster than that, but for the noise of poses

Mode = Literal["anchored", "relative", "frozen"]


def believed_calibration(smoother: Smoother, odometry: str, calibration: OdometryCalibration) -> Array:
    """Return what is believed (8,) of how and where an odometry is mounted, of its scale and its clock."""
    return calibration.joined(smoother.parameters.belief(one.name(odometry), one)[0] for one in calibration.parameters)


class Joined(NamedTuple):
    """What became of a pose, and by how many sigmas (6,) its odometry has jumped before it, if it has."""

    outcome: Outcome
    jump: Array | None = None


class _Epoch(NamedTuple):
    first: TrackPose
    key: int


class OdometryTrack:
    """The poses of one odometry in one smoother; a pose may come late, a jump of the odometry begins a new frame."""

    def __init__(self, noise: OdometryNoise, max_interval_ns: int, mode: Mode) -> None:
        self._noise = noise
        self._max_interval_ns = max_interval_ns
        self._mode = mode
        self._newest: TrackPose | None = None
        self._since: TrackPose | None = None  # the first of those that are the newest in every digit
        self._speeds = 0.0, 0.0  # at which the odometry came there [m/s, rad/s]
        self._is_stuck = False
        self._epochs: list[_Epoch] = []
        self._T_W_I0: gtsam.Pose3 | None = None  # where the frame is frozen
        self._slack = np.zeros((6, 6))  # what the odometry has claimed since then not to know

    def copy(self, mode: Mode) -> "OdometryTrack":
        """Return a track for a clone of the smoother, which goes on in its own way."""
        other = copy(self)
        other._epochs, other._mode = list(self._epochs), mode
        return other

    def begin_anew(self) -> "OdometryTrack":
        """Return an empty track of the same odometry."""
        return OdometryTrack(self._noise, self._max_interval_ns, self._mode)

    @property
    def newest(self) -> TrackPose | None:
        """The newest pose."""
        return self._newest

    def freeze(self, smoother: Smoother) -> None:
        """Hold the frame where the newest pose sees it: T_W_I(t_j) T_I0_I(t_j)^-1, of Eq. (10) with the extrinsics."""
        if self._newest is not None and self._newest.stamp_ns >= smoother.oldest_ns:
            self._T_W_I0, self._slack = _frame_seen_by(smoother, self._newest), np.zeros((6, 6))

    def add(self, smoother: Smoother, key: int, pose: TrackPose) -> Joined:
        """Join the node of a pose, which exists under `key`, to what was before."""
        before = self._newest
        motion, jump = None, None
        if self._repeats(smoother, pose):
            return Joined(Outcome.FROZEN)
        if before is None or before.claimed_ns < pose.claimed_ns:
            self._newest = pose
        if before is not None and before.claimed_ns < pose.claimed_ns and pose.begins_anew:
            before, self._epochs, self._T_W_I0 = None, [], None
        if before is not None and before.claimed_ns < pose.claimed_ns:
            motion = before.T_I0_I.between(pose.T_I0_I)
            self._slack = _carried(self._slack, motion, pose.excess)
            jump = self._jump(smoother, before, pose, motion)
            if not is_possible(motion, (pose.claimed_ns - before.claimed_ns) * 1e-9):
                self._epochs, self._T_W_I0 = [], None
                return Joined(Outcome.OUT_OF_RANGE, jump)
            if jump is not None:
                self._epochs, self._T_W_I0, motion = [], None, None
        if self._mode == "relative":
            return Joined(self._add_relative(smoother, key, before, pose, motion), jump)
        if self._mode == "frozen":
            return Joined(self._add_frozen(smoother, key, pose), jump)
        return Joined(self._add_anchored(smoother, key, pose), jump)

    def _repeats(self, smoother: Smoother, pose: TrackPose) -> bool:
        """Whether an odometry is stuck: a pose is the one before in every digit, though the machine cannot stand."""
        since = self._since
        if since is None or not pose.repeats(since):
            if since is not None and since.claimed_ns < pose.claimed_ns:
                duration_s = (pose.claimed_ns - since.claimed_ns) * 1e-9
                moved_m, turned_rad = size_of(since.T_I0_I.between(pose.T_I0_I))
                self._speeds = moved_m / duration_s, turned_rad / duration_s
            self._since, self._is_stuck = pose, False
        elif not self._is_stuck and self._is_comparable(smoother, since, pose):
            self._is_stuck = self._has_moved(smoother, since, pose)
        elif not self._is_stuck:
            self._is_stuck = self._speeds[0] > STOPS_M_S + STOPS_M_S2 * (pose.claimed_ns - since.claimed_ns) * 1e-9
        return self._is_stuck

    def _has_moved(self, smoother: Smoother, since: TrackPose, pose: TrackPose) -> bool:
        """Whether the machine has moved since a pose, about as fast as the odometry came there.

        One that stands says the same pose, too, however wrong the estimate is.
        """
        duration_s = (pose.stamp_ns - since.stamp_ns) * 1e-9
        motion = smoother.nav(since.stamp_ns).pose().between(smoother.nav(pose.stamp_ns).pose())
        moved_m, turned_rad = size_of(motion)
        known_m = sqrt(_of_prediction(smoother.state_at(pose.stamp_ns), duration_s).trace())
        turned = gtsam.Rot3.Logmap(motion.rotation())
        known_rad = sqrt(smoother.turning_covariance(turned, duration_s).trace())
        most_m, most_rad = (AS_FAST * speed * duration_s for speed in self._speeds)
        has_moved = STUCK_M + STUCK_SIGMA * known_m < moved_m < most_m
        return has_moved or STUCK_RAD + STUCK_SIGMA * known_rad < turned_rad < most_rad

    def _is_comparable(self, smoother: Smoother, before: TrackPose, pose: TrackPose) -> bool:
        """Whether the IMU has measured all along between two poses, and the graph still knows the first."""
        is_known = before.early_ns == pose.early_ns and smoother.oldest_ns <= before.stamp_ns < pose.stamp_ns
        return is_known and smoother.imu.is_trusted(before.stamp_ns, pose.stamp_ns)

    def _jump(self, smoother: Smoother, before: TrackPose, pose: TrackPose, motion: gtsam.Pose3) -> Array | None:
        """Return by how much the IMU contradicts the odometry; None if it does not, or has not measured all along."""
        if not self._is_comparable(smoother, before, pose):
            return None
        calibration = self._noise.calibration
        motion = calibration.motion(motion, believed_calibration(smoother, pose.sensor, calibration))
        predicted = smoother.nav(before.stamp_ns).pose().between(smoother.nav(pose.stamp_ns).pose())
        if self._noise.jump(motion, predicted, pose.excess) is None:  # as a rule
            return None
        unknown = _of_prediction(smoother.state_at(pose.stamp_ns), (pose.stamp_ns - before.stamp_ns) * 1e-9)
        return self._noise.jump(motion, predicted, with_excess(pose.excess, unknown))

    def _add_relative(
        self, smoother: Smoother, key: int, before: TrackPose | None, pose: TrackPose, motion: gtsam.Pose3 | None
    ) -> Outcome:
        if before is None or motion is None or pose.claimed_ns - before.claimed_ns > self._max_interval_ns:
            return Outcome.NO_PREDECESSOR
        previous_key = smoother.node(before.stamp_ns)
        if previous_key is None:
            return Outcome.NO_PREDECESSOR
        smoother.enter(pose, self._noise.relative_factor(previous_key, key, motion, pose.excess))
        return Outcome.USED

    def _add_frozen(self, smoother: Smoother, key: int, pose: TrackPose) -> Outcome:
        if self._T_W_I0 is None:
            self._T_W_I0, self._slack = _frame_seen_by(smoother, pose), np.zeros((6, 6))
            return Outcome.NO_PREDECESSOR
        smoother.enter(pose, self._noise.pseudo_global_factor(key, self._T_W_I0 * pose.T_I0_I, self._slack))
        return Outcome.USED

    def _add_anchored(self, smoother: Smoother, key: int, pose: TrackPose) -> Outcome:
        while self._epochs and not smoother.has_frame(self._epochs[0].key):  # they leave in the order of time
            del self._epochs[0]
        at = next((epoch for epoch in reversed(self._epochs) if epoch.first.claimed_ns <= pose.claimed_ns), None)
        is_newest = bool(self._epochs) and at is self._epochs[-1]
        if not self._epochs or (is_newest and at is not None and _is_over(at, pose)):
            at = self._begin_epoch(smoother, at, pose)
        elif at is None:
            return Outcome.NO_PREDECESSOR  # from before a jump
        smoother.keep_frame(at.key, pose.stamp_ns)
        motion, state = at.first.T_I0_I.between(pose.T_I0_I), smoother.mean_at(pose.stamp_ns)
        calibration_keys, offset_s = self._calibration(smoother, pose)
        known_s = pose.early_ns * 1e-9
        factor = self._noise.anchored_factor(
            at.key,
            key,
            motion,
            calibration_keys,
            angular_velocity=state.angular_velocity,
            beyond=state.twist_beyond(offset_s - known_s),
            known_s=known_s,
        )
        smoother.enter(pose, factor)
        return Outcome.USED

    def _calibration(self, smoother: Smoother, pose: TrackPose) -> tuple[tuple[int, ...], float]:
        """Return the keys of what is estimated of the odometry, none if nothing is, and the offset of its clock [s]."""
        calibration = self._noise.calibration
        found = [smoother.parameter(one.name(pose.sensor), one, pose.stamp_ns) for one in calibration.parameters]
        belief = calibration.joined(value for _, value, _ in found)
        return tuple(key for key, _, _ in found), float(belief[-1])

    def _begin_epoch(self, smoother: Smoother, before: _Epoch | None, pose: TrackPose) -> _Epoch:
        here = smoother.nav(pose.stamp_ns).pose()
        key = smoother.insert_frame(here, pose.stamp_ns)
        if before is None:
            free = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([FREE, FREE, STILL_M_S], 3))
            smoother.add(gtsam.PriorFactorNavState(key, gtsam.NavState(here, np.zeros(3)), free))
        else:
            motion = before.first.T_I0_I.between(pose.T_I0_I)
            duration_s = (pose.claimed_ns - before.first.claimed_ns) * 1e-9
            calibration_keys, _ = self._calibration(smoother, pose)
            up = here.rotation().unrotate(np.array([0.0, 0.0, 1.0]))
            drift = self._noise.drift_factor(before.key, key, motion, duration_s, up, calibration_keys, pose.excess)
            smoother.add(drift)
        self._epochs.append(_Epoch(pose, key))
        return self._epochs[-1]


def _carried(slack: Array, motion: gtsam.Pose3, excess: Array | None) -> Array:
    """Return a covariance (6, 6) in the tangent of I after a motion, and what the odometry claims of that added."""
    if excess is None and not slack.any():
        return slack
    adjoint = motion.inverse().AdjointMap()
    return with_excess(excess, adjoint @ slack @ adjoint.T)


def _of_prediction(state: State, duration_s: float) -> Array:
    """Return the covariance (6, 6) of how I moves over a short time, as its velocity and attitude are known."""
    by_state = np.hstack([gtsam.SO3.Hat(state.nav.bodyVelocity()), np.zeros((3, 3)), np.eye(3)]) * duration_s
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = by_state @ state.covariance @ by_state.T
    return covariance


def _frame_seen_by(smoother: Smoother, pose: TrackPose) -> gtsam.Pose3:
    """Return the pose of the odometry's frame in W as one of its poses sees it."""
    return smoother.nav(pose.stamp_ns).pose() * pose.T_I0_I.inverse()


def _is_over(epoch: _Epoch, pose: TrackPose) -> bool:
    """Whether the machine has moved on so far since an epoch began that the odometry may have drifted, or claims to.

    A pose that claims so begins an epoch of its own, so that what it claims stands between it and the pose before.
    """
    if pose.excess is not None:
        return True
    moved_m, turned_rad = size_of(epoch.first.T_I0_I.between(pose.T_I0_I))
    return pose.claimed_ns - epoch.first.claimed_ns >= EPOCH_NS or moved_m > EPOCH_M or turned_rad > EPOCH_RAD
