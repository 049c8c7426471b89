"""Finds loop closures in a recording: for a stretch of the smoothed track, from the scans of its bag."""

from collections import Counter
from collections.abc import Callable, Mapping

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import DriftingConfig
from holdfast.lidar_odometry.reader import SweepReader
from holdfast.loops.candidates import Keyframe, Pair, candidates, keyframes_of
from holdfast.loops.submaps import Submaps
from holdfast.loops.verification import Target, verified
from holdfast.messages import Array
from holdfast.recording.raw import RawBag
from holdfast.sensors.odometry_calibration import mounted
from holdfast.smoothing.block import Track
from holdfast.smoothing.closures import Closure, Found, Stretch
from holdfast.state import Trajectory

ARRIVAL_NS = 5_000_000_000  # by which a scan may arrive after its stamp, or its stamp lie in the future
MIN_RANGE_M = 3.0  # nearer is the machine itself


class LoopCloser:
    """Registers the scans of a bag where the track returns; called with a stretch it tells the closures.

    Args:
        bag: the recording.
        topic: of the clouds.
        config: of the estimator.
        stamp: maps a time of the estimator [ns] to a stamp of the recording.
        progress: is told what is being done, once a registration.
    """

    def __init__(
        self,
        bag: RawBag,
        topic: str,
        config: Config,
        stamp: Callable[[int], int] = lambda time_ns: time_ns,
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self._bag, self._topic, self._config = bag, topic, config
        self._stamp, self._progress = stamp, progress

    def __call__(self, stretch: Stretch) -> Found:
        """Return the closures within a stretch of the track, and how many candidates were refused and why."""
        track, nodes = stretch.track, stretch.covariances
        rows = np.searchsorted(track.times_ns, nodes.times_ns)
        rows = np.minimum(rows, len(track.times_ns) - 1)
        keyframes = keyframes_of(nodes.times_ns, track.positions[rows], track.quaternions[rows], nodes.values)
        # a keyframe is at a sample of the IMU: a node may lie between two, and is as near as its sample
        pairs = candidates(keyframes, stretch.after_ns)
        counts: Counter[str] = Counter()
        if not pairs:
            return Found([], counts)
        submaps = self._gather(pairs, track, stretch.calibrations)
        return Found(self._register(pairs, submaps, nodes.values, counts), counts)

    def _gather(self, pairs: list[Pair], track: Track, calibrations: Mapping[str, Array]) -> Submaps | None:
        """Read the scans about the keyframes; None if there are none, or in a frame that nothing joins to I."""
        stamps = np.array([self._stamp(time_ns) for time_ns in track.times_ns.tolist()], dtype=np.int64)
        trajectory = Trajectory(stamps, track.positions, track.quaternions)
        keyframes = {one.time_ns: one._replace(time_ns=self._stamp(one.time_ns)) for pair in pairs for one in pair}
        submaps: Submaps | None = None
        spans = Submaps(keyframes.values(), trajectory, np.eye(4)).spans_ns
        for begin_ns, end_ns in spans:
            reader = SweepReader(self._bag, self._topic, MIN_RANGE_M)
            rows = self._bag.messages({self._topic}, end_ns + ARRIVAL_NS, begin_ns - ARRIVAL_NS)
            for arrival_ns, channel, raw in rows:
                sweep = reader.take(arrival_ns, channel, raw)
                if sweep is None:
                    continue
                if submaps is None:
                    mount = self._mount(sweep.frame_id, calibrations)
                    if mount is None:
                        return None
                    submaps = Submaps(keyframes.values(), trajectory, mount)
                if sweep.stamp_ns > end_ns:
                    break
                if sweep.stamp_ns >= begin_ns:
                    submaps.add(sweep)
        return submaps

    def _mount(self, frame: str, calibrations: Mapping[str, Array]) -> Array | None:
        """Return T_I_L (4, 4), turned by what the optimum knows of the mounting; None if nothing joins it to I."""
        if not self._config.reaches(frame):
            return None
        T_I_L: Array = self._config.T_I(frame)
        for name in self._config.sensors_of(DriftingConfig):
            if self._config.frame_of(name) == frame and name in calibrations:
                T_I_L = T_I_L @ mounted(calibrations[name]).matrix()
        return T_I_L

    def _register(
        self, pairs: list[Pair], submaps: Submaps | None, covariances: Array, counts: Counter[str]
    ) -> list[Closure]:
        targets: dict[int, Target | None] = {}
        closures: list[Closure] = []
        last_use = {one.time_ns: number for number, pair in enumerate(pairs) for one in pair}
        for number, pair in enumerate(pairs):
            found = [self._target(submaps, targets, one) for one in pair]
            self._progress()
            if found[0] is None or found[1] is None:
                counts["no scans"] += 1
            else:
                earlier, later = (_pose(one) for one in pair)
                predicted = earlier.between(later)
                doubt = _doubt(covariances[pair.earlier.row], covariances[pair.later.row], predicted)
                match = verified(found[0], found[1], predicted, doubt)
                counts[match.refusal or "accepted"] += 1
                if not match.refusal:
                    closures.append(Closure(pair.earlier.time_ns, pair.later.time_ns, match.T, match.covariance))
            for time_ns in [time_ns for time_ns in targets if last_use[time_ns] <= number]:
                del targets[time_ns]
        return closures

    def _target(self, submaps: Submaps | None, targets: dict[int, Target | None], keyframe: Keyframe) -> Target | None:
        if keyframe.time_ns not in targets:
            import small_gicp

            at = keyframe._replace(time_ns=self._stamp(keyframe.time_ns))
            cloud = None if submaps is None else submaps.cloud(at)
            targets[keyframe.time_ns] = None if cloud is None else Target(cloud, small_gicp.KdTree(cloud))
        return targets[keyframe.time_ns]


def _pose(one: Keyframe) -> gtsam.Pose3:
    x, y, z, w = one.quaternion
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), one.position)


def _doubt(earlier: Array, later: Array, predicted: gtsam.Pose3) -> Array:
    """Return the covariance (6, 6) of a predicted relative pose, its ends taken as independent: an upper bound."""
    adjoint = predicted.inverse().AdjointMap()
    doubt: Array = adjoint @ earlier[:6, :6] @ adjoint.T + later[:6, :6]
    return doubt
