"""What odometries have measured of late, beside the graphs: motions for a start, and a witness of positions."""

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf

import gtsam
import numpy as np

from holdfast.estimator.course import travel_m
from holdfast.integrity.consensus import LEAST, SIGMA
from holdfast.messages import Array
from holdfast.sensors.odometry import OdometryModel, OdometryNoise, TrackPose
from holdfast.sensors.sensor import Position

SHARE = 0.05  # of the way, by which an odometry may differ from positions that vouch for it
TELLING = 0.25  # of the way: positions that are noisier do not tell


class OdometryTracks:
    """The newest poses of each odometry.

    Args:
        models: by name.
    """

    def __init__(self, models: Mapping[str, OdometryModel]) -> None:
        self._noises: Mapping[str, OdometryNoise] = {name: OdometryNoise(model) for name, model in models.items()}
        self._tracks: dict[str, deque[TrackPose]] = {}

    @property
    def series(self) -> Iterator[deque[TrackPose]]:
        """The poses of each odometry that has measured, in the order of arrival."""
        yield from self._tracks.values()

    @property
    def names(self) -> list[str]:
        """The odometries that have measured."""
        return list(self._tracks)

    def weigh_by(self, noises: Mapping[str, OdometryNoise]) -> None:
        """Weigh the motions of odometries from now on by noises that learn."""
        self._noises = noises

    def add(self, pose: TrackPose) -> None:
        """Take in a pose; what is known now of its clock holds for those before, too."""
        track = self._tracks.setdefault(pose.sensor, deque())
        if track and track[-1].early_ns != pose.early_ns:
            self._tracks[pose.sensor] = track = deque(one.dated(pose.early_ns) for one in track)
        track.append(pose)

    def forget(self, name: str) -> None:
        """Forget what an odometry has said."""
        self._tracks.pop(name, None)

    def factors(self, stamps: Sequence[int], without: Collection[str] = ()) -> list[gtsam.NonlinearFactor]:
        """Return relative factors between keys x(0), x(1), ... of some times, from each track but of those without."""
        factors = []
        for name, track in self._tracks.items():
            if name in without:
                continue
            noise, poses = self._noises[name], [_pose_at(track, stamp) for stamp in stamps]
            for k, (before, after) in enumerate(pairwise(poses)):
                if before is not None and after is not None:
                    keys = gtsam.symbol("x", k), gtsam.symbol("x", k + 1)
                    factors.append(noise.learnt_factor(*keys, before.between(after)))
        return factors

    def move_as(self, positions: Sequence[Position], p_I_P: Array, tolerance_m: float, since_ns: int) -> bool:
        """Whether an odometry has moved in the shape of some positions, wherever it sees them.

        Args:
            positions: of one antenna, sorted by stamp.
            p_I_P: (3,) where it is in I [m].
            tolerance_m: so near they must come, all of them, when one is laid upon the other.
            since_ns: one since this time it must have passed.
        """
        return any(_moves_as(track, positions, p_I_P, tolerance_m, since_ns) for track in self._tracks.values())

    def vouched(self, name: str, positions: Sequence[Position], p_I_P: Array, since_ns: int) -> bool | None:
        """Whether an odometry has moved in the shape of positions, from before a time on.

        None until two came since then, and it has passed one.
        `positions` and `p_I_P` as in `move_as`; positions whose noise is too large a share of the way do not tell.
        """
        since = [one for one in positions if one.stamp_ns >= since_ns]
        if len(since) < 2:
            return None
        if not self._tracks.get(name):
            return False
        if since[0].stamp_ns > self._tracks[name][-1].stamp_ns:
            return None
        noise_m, way_m = SIGMA * float(np.sqrt(since[-1].covariance.trace())), travel_m(since)
        tolerance_m = max(noise_m, SHARE * way_m)
        return noise_m < TELLING * way_m and _moves_as(self._tracks[name], positions, p_I_P, tolerance_m, since_ns)


def _moves_as(
    track: deque[TrackPose], positions: Sequence[Position], p_I_P: Array, tolerance_m: float, since_ns: int
) -> bool:
    seen = [(one, _pose_at(track, one.stamp_ns)) for one in positions]
    passed = [(one, T.transformFrom(p_I_P)) for one, T in seen if T is not None]
    if len(passed) < LEAST or all(one.stamp_ns < since_ns for one, _ in passed):
        return False
    return _apart_m([(one.p_W_P, at) for one, at in passed]) < tolerance_m


def _apart_m(pairs: list[tuple[Array, Array]]) -> float:
    """Return the largest distance between pairs of points [m], the second ones moved onto the first."""
    moved = gtsam.Pose3.Align(pairs)
    if moved is None:
        return inf
    return max(float(np.linalg.norm(a - moved.transformFrom(b))) for a, b in pairs)


def _pose_at(track: deque[TrackPose], stamp_ns: int) -> gtsam.Pose3 | None:
    """Return the pose of the IMU on an odometry's track at a time, interpolated; None where it was not there."""
    for before, after in pairwise(track):
        if before.stamp_ns <= stamp_ns <= after.stamp_ns:
            fraction = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
            pose: gtsam.Pose3 = before.T_I0_I.slerp(fraction, after.T_I0_I)
            return pose
    return None
