"""What odometries have measured of late, beside the graphs: motions for a start, and a witness of positions."""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, pairwise

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.sensors.odometry import OdometryModel, OdometryNoise, TrackPose
from holdfast.sensors.sensor import Position

LEAST_SIGMAS = 5.0  # of positions, that lie between two of them
ALIKE = 0.05  # of the way: a turn into which an estimate bends it is not in the distance that an odometry measures


class OdometryTracks:
    """The newest poses of each odometry.

    Args:
        models: by name.
    """

    def __init__(self, models: Mapping[str, OdometryModel]) -> None:
        self._models = models
        self._tracks: dict[str, deque[TrackPose]] = {}

    @property
    def series(self) -> Iterator[deque[TrackPose]]:
        """The poses of each odometry that has measured, in the order of arrival."""
        yield from self._tracks.values()

    @property
    def names(self) -> list[str]:
        """The odometries that have measured."""
        return list(self._tracks)

    def add(self, pose: TrackPose) -> None:
        """Take in a pose."""
        self._tracks.setdefault(pose.sensor, deque()).append(pose)

    def forget(self, name: str) -> None:
        """Forget what an odometry has said."""
        self._tracks.pop(name, None)

    def factors(self, stamps: Sequence[int]) -> list[gtsam.NonlinearFactor]:
        """Return relative factors between keys x(0), x(1), ... of some times, from each track."""
        factors = []
        for name, track in self._tracks.items():
            noise, poses = OdometryNoise(self._models[name]), [_pose_at(track, stamp) for stamp in stamps]
            for k, (before, after) in enumerate(pairwise(poses)):
                if before is not None and after is not None:
                    keys = gtsam.symbol("x", k), gtsam.symbol("x", k + 1)
                    factors.append(noise.relative_factor(*keys, before.between(after)))
        return factors

    def move_as(self, positions: Sequence[Position], p_I_P: Array) -> bool:
        """Whether an odometry has moved in the shape of some positions, wherever it sees them.

        Args:
            positions: of one antenna, sorted by stamp.
            p_I_P: (3,) where it is in I [m].
        """
        chosen = [positions[k] for k in (0, len(positions) // 2, -1)]
        for track in self._tracks.values():
            poses = [_pose_at(track, one.stamp_ns) for one in chosen]
            seen = [(one, T.transformFrom(p_I_P)) for one, T in zip(chosen, poses, strict=True) if T is not None]
            if len(seen) == len(chosen) and all(_are_alike(*then, *now) for then, now in combinations(seen, 2)):
                return True
        return False


def _are_alike(then: Position, p_I0_then: Array, now: Position, p_I0_now: Array) -> bool:
    """Whether an antenna has gone as far by an odometry as by its positions, and far enough to tell."""
    gone_m = float(np.linalg.norm(p_I0_now - p_I0_then))
    noise_m = float(np.sqrt(np.trace(then.covariance + now.covariance)))
    apart_m = abs(float(np.linalg.norm(now.p_W_P - then.p_W_P)) - gone_m)
    return gone_m > LEAST_SIGMAS * noise_m and apart_m < ALIKE * gone_m


def _pose_at(track: deque[TrackPose], stamp_ns: int) -> gtsam.Pose3 | None:
    """Return the pose of the IMU on an odometry's track at a time, interpolated; None where it was not there."""
    for before, after in pairwise(track):
        if before.stamp_ns <= stamp_ns <= after.stamp_ns:
            fraction = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
            pose: gtsam.Pose3 = before.T_I0_I.slerp(fraction, after.T_I0_I)
            return pose
    return None
