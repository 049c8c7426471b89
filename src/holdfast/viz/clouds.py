"""Scans in Rerun: the current one in the frame of its lidar, and where they have hit, as a map about the machine.

For the map each point is placed by the transforms at its own time, so that a cabin that slews does not smear it.
"""

from collections import deque
from typing import Any

import gtsam
import numpy as np
import rerun as rr

from holdfast.lidar_odometry.sweep import Sweep, decode_sweep
from holdfast.messages import Array
from holdfast.recording.decode import UndecodableError

CURRENT_POINTS, MAP_POINTS = 6000, 1500
MAP_S = 60.0  # for so long points stay in the map
KEPT = 100  # transforms of each frame: 5 s at 20 Hz
PIECES = 16  # of a scan, each placed by one transform
NEAR_M, FAR_M = 1.0, 60.0
RADIUS = rr.Radius.ui_points(1.5)
COLOUR, MAP_COLOUR = (240, 200, 90), (140, 150, 165)


class Clouds:
    """Draws scans, given the transforms of their frames."""

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}
        self._poses: dict[str, deque[tuple[int, gtsam.Pose3]]] = {}

    def add_transform(self, parent: str, child: str, stamp_ns: int, row: Array) -> None:
        """Take in where a frame is in its parent: (7,) position [m], quaternion x, y, z, w."""
        self._parents[child] = parent
        x, y, z, w = row[3:]
        pose = gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), row[:3])
        self._poses.setdefault(child, deque(maxlen=KEPT)).append((stamp_ns, pose))

    def draw(self, recording: rr.RecordingStream, entity: str, message: Any) -> str | None:
        """Draw a sensor_msgs/PointCloud2 at the time that is set; return the entity of its map, if there is one.

        Args:
            recording: where to draw.
            entity: of the scan, below the frame of its lidar.
            message: the scan.
        """
        try:
            sweep = decode_sweep(message).beyond(NEAR_M, FAR_M)
        except UndecodableError:
            return None
        recording.log(entity, rr.Points3D(_thinned(sweep, CURRENT_POINTS).points, colors=[COLOUR], radii=RADIUS))
        thin = _thinned(sweep, MAP_POINTS)
        root = self._root(sweep.frame_id)
        if root == sweep.frame_id or not len(thin.points):
            return None
        map_entity = f"/{root}/local_map/{sweep.frame_id}"
        recording.log(map_entity, rr.Points3D(self._placed(thin), colors=[MAP_COLOUR], radii=RADIUS))
        return map_entity

    def _placed(self, sweep: Sweep) -> Array:
        """Return the points (N, 3) in the root frame, each where the lidar was at its time."""
        offsets_s = np.zeros(len(sweep.points)) if sweep.offsets_s is None else sweep.offsets_s
        order = np.argsort(offsets_s, kind="stable")
        placed = np.empty_like(sweep.points)
        for piece in np.array_split(order, PIECES):
            if len(piece):
                at_ns = sweep.stamp_ns + round(float(offsets_s[piece].mean()) * 1e9)
                T = self._pose(sweep.frame_id, at_ns)
                placed[piece] = sweep.points[piece] @ T[:3, :3].T + T[:3, 3]
        return placed

    def _root(self, frame: str) -> str:
        seen = {frame}
        while (parent := self._parents.get(frame)) is not None and parent not in seen:
            frame = parent
            seen.add(frame)
        return frame

    def _pose(self, frame: str, at_ns: int) -> Array:
        """Return where a frame was (4, 4) in its root."""
        T, root = np.eye(4), self._root(frame)
        while frame != root:
            T = _at(self._poses[frame], at_ns).matrix() @ T
            frame = self._parents[frame]
        return T


def _at(poses: deque[tuple[int, gtsam.Pose3]], at_ns: int) -> gtsam.Pose3:
    """Return the pose at a time: between two by interpolation, beyond the ends the nearest."""
    after = next((k for k, (stamp_ns, _) in enumerate(poses) if stamp_ns >= at_ns), None)
    if after is None:
        return poses[-1][1]
    if after == 0:
        return poses[0][1]
    (before_ns, before), (after_ns, later) = poses[after - 1], poses[after]
    share = (at_ns - before_ns) / max(after_ns - before_ns, 1)
    return before.compose(gtsam.Pose3.Expmap(share * gtsam.Pose3.Logmap(before.between(later))))


def _thinned(sweep: Sweep, most: int) -> Sweep:
    """Return at most so many points of a sweep, evenly over its time."""
    chosen = np.zeros(len(sweep.points), np.bool_)
    chosen[:: max(1, -(-len(chosen) // most))] = True
    return sweep.taken(chosen)
