"""Submaps: the scans of a few seconds about a keyframe, deskewed with the trajectory and thinned, in I at that time."""

from collections.abc import Iterable

import numpy as np
import small_gicp
from numpy.typing import NDArray

from holdfast.evaluation import quaternions
from holdfast.evaluation.mapping import move_points
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.loops.candidates import Keyframe
from holdfast.messages import Array
from holdfast.state import Trajectory

HALF_NS = 1_000_000_000  # before and after the keyframe
VOXEL_M = 0.25
MAX_RANGE_M = 40.0  # an error of attitude within the submap moves farther points too much
MAX_GAP_S = 0.5
NEIGHBOURS = 10
MAX_POINTS = 12_000  # of a sweep; a denser one is thinned evenly
MIN_POINTS = 500


class Submaps:
    """The submaps of some keyframes, gathered from sweeps in the order of time.

    Args:
        keyframes: in any order.
        trajectory: of I in W, by which points are deskewed.
        T_I_L: (4, 4) pose of the lidar.
    """

    def __init__(self, keyframes: Iterable[Keyframe], trajectory: Trajectory, T_I_L: Array) -> None:
        self._keyframes = sorted({one.time_ns: one for one in keyframes}.values(), key=lambda one: one.time_ns)
        self._trajectory, self._T_I_L = trajectory, T_I_L
        self._points: dict[int, list[NDArray[np.float32]]] = {}

    @property
    def spans_ns(self) -> list[tuple[int, int]]:
        """The times whose sweeps are wanted, merged and in order."""
        spans: list[tuple[int, int]] = []
        for one in self._keyframes:
            begin, end = one.time_ns - HALF_NS, one.time_ns + HALF_NS
            if spans and begin <= spans[-1][1]:
                spans[-1] = spans[-1][0], end
            else:
                spans.append((begin, end))
        return spans

    def add(self, sweep: Sweep) -> None:
        """Take in a sweep whose stamps are those of the trajectory."""
        near = [one for one in self._keyframes if abs(sweep.stamp_ns - one.time_ns) <= HALF_NS]
        if not near:
            return
        sweep = _within(sweep)
        offsets_s = np.zeros(len(sweep.points)) if sweep.offsets_s is None else sweep.offsets_s
        stamps_ns = sweep.stamp_ns + np.rint(offsets_s * 1e9).astype(np.int64)
        moved = move_points(sweep.points, stamps_ns, self._trajectory, self._T_I_L, MAX_GAP_S)
        if moved is None:
            return
        for one in near:
            local = quaternions.rotate(
                quaternions.conjugate(np.broadcast_to(one.quaternion, (len(moved.points), 4))),
                moved.points - one.position,
            )
            thin = small_gicp.voxelgrid_sampling(local, VOXEL_M).points()[:, :3]
            self._points.setdefault(one.time_ns, []).append(thin.astype(np.float32))

    def cloud(self, keyframe: Keyframe) -> small_gicp.PointCloud | None:
        """Return the submap with a plane around each point; None if the scans do not reach it."""
        pieces = self._points.get(keyframe.time_ns)
        if not pieces:
            return None
        points = np.concatenate(pieces).astype(np.float64)
        if len(points) < MIN_POINTS:
            return None
        return small_gicp.preprocess_points(points, VOXEL_M, NEIGHBOURS, 1)[0]


def _within(sweep: Sweep) -> Sweep:
    near = np.flatnonzero(np.einsum("ni,ni->n", sweep.points, sweep.points) <= MAX_RANGE_M**2)
    near = near[:: max(1, -(-len(near) // MAX_POINTS))]
    offsets_s = None if sweep.offsets_s is None else sweep.offsets_s[near]
    return Sweep(sweep.stamp_ns, sweep.frame_id, sweep.points[near], offsets_s)
