"""A map under construction, and the finished one: both are files, read and written in blocks."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import RecordingError
from holdfast.evaluation.association import check_trajectory
from holdfast.evaluation.mapping import move_points
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.mapping.claims import PoseCovariances
from holdfast.mapping.options import SiteMapOptions
from holdfast.mapping.sight import PERIOD_NS, is_seen_through, ray_cells
from holdfast.mapping.sorted_runs import BLOCK_ROWS, Records, SortedRuns, merged, read_blocks
from holdfast.mapping.voxels import CELL, CELL_SHIFT, CELL_SUMS, VOXEL, VOXEL_SUMS, voxel_keys
from holdfast.messages import Array
from holdfast.state import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class SiteMap:
    """A finished map.

    Attributes:
        file: of records of `VOXEL`, sorted by key.
        points: in it, one per voxel.
        thinned: points that were left out because rays saw through their cells.
        scans: that were used.
        left_out: scans that the trajectory does not cover, or only with a gap.
        undeskewed: scans whose points have no times.
        low, high: (3,) the bounds of the points in W [m].
        has_intensity, has_sigma: whether these are known.
    """

    file: Path
    points: int
    thinned: int
    scans: int
    left_out: int
    undeskewed: int
    low: Array
    high: Array
    has_intensity: bool
    has_sigma: bool

    def blocks(self) -> Iterator[Records]:
        """Yield the records, so many at a time."""
        return read_blocks(self.file, VOXEL, BLOCK_ROWS)

    def sample(self, points: int) -> Records:
        """Return every n-th record, at most so many."""
        step, offset, taken = max(1, -(-self.points // points)), 0, []
        for block in self.blocks():
            taken.append(block[offset::step].copy())
            offset = (offset - len(block)) % step
        return np.concatenate(taken)


class MapBuilder:
    """Scans in, a map out.

    Args:
        folder: of the files; whoever made it removes it.
        trajectory: of I in W.
        T_I_L: (4, 4) pose of the lidar in I.
        options: how the map is made.
        covariances: of the trajectory, if they are known.
        offset_ns: is added to the stamps of the scans.

    Raises:
        RecordingError: the trajectory cannot be used.
    """

    def __init__(  # noqa: PLR0917 (the last two are often left out)
        self,
        folder: Path,
        trajectory: Trajectory,
        T_I_L: Array,
        options: SiteMapOptions,
        covariances: PoseCovariances | None = None,
        offset_ns: int = 0,
    ) -> None:
        check_trajectory(trajectory, "trajectory")
        self._folder, self._trajectory, self._T_I_L, self._options = folder, trajectory, T_I_L, options
        self._covariances, self._offset_ns = covariances, offset_ns
        self._voxels = SortedRuns(folder, "voxels", VOXEL, VOXEL_SUMS)
        self._cells = SortedRuns(folder, "cells", CELL, CELL_SUMS)
        self._rng = np.random.default_rng(0)
        self._followed_ns: int | None = None
        self.scans, self.left_out, self.undeskewed = 0, 0, 0
        self._has_intensity = False

    def add(self, sweep: Sweep) -> None:
        """Move the points of a scan to the pose of the lidar at their own times, and put them into their voxels."""
        rows = self._rows_of(sweep.points)
        points, stamp_ns = sweep.points[rows], sweep.stamp_ns + self._offset_ns
        offsets_s = np.zeros(len(rows)) if sweep.offsets_s is None else sweep.offsets_s[rows]
        stamps_ns = stamp_ns + np.rint(offsets_s * 1e9).astype(np.int64)
        moved = move_points(points, stamps_ns, self._trajectory, self._T_I_L, self._options.max_gap_s)
        if moved is None:
            self.left_out += 1
            return
        self.scans += 1
        self.undeskewed += sweep.offsets_s is None
        found = np.zeros(len(points), dtype=VOXEL)
        found["key"], found["point"] = voxel_keys(moved.points, self._options.voxel_m), moved.points
        found["stamp_ns"], found["points"] = stamps_ns, 1
        found["priority"] = self._rng.random(len(points), dtype=np.float32)
        if sweep.intensities is not None:
            found["intensity"], self._has_intensity = sweep.intensities[rows], True
        if self._covariances is not None:
            found["sigma_m"] = self._covariances.sigmas(stamp_ns, moved.points - moved.imu)
        of_scan = merged(found, VOXEL_SUMS)
        of_scan["scans"] = 1
        self._voxels.add(of_scan)
        if self._options.keep_above > 0.0 and self._is_followed(stamp_ns):
            for cells in ray_cells(moved.points, moved.lidar, self._options.voxel_m, self._rng):
                self._cells.add(cells)

    def finish(self) -> SiteMap:
        """Thin what moved, and return the map; no scan can be added any more.

        Raises:
            RecordingError: there is none, because the trajectory covers no scan.
        """
        if not self.scans:
            none = f"the trajectory covers none of the {self.left_out} scans"
            raise RecordingError(f"{none}, so there is no map (is it of this recording?)")
        file, points, met = self._folder / "map", 0, 0
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        with file.open("wb") as stream:
            for block, cells in _side_by_side(self._voxels.blocks(), self._cells.blocks()):
                kept = block[~is_seen_through(cells, self._options.keep_above)]
                met, points = met + len(block), points + len(kept)
                if len(kept):
                    low, high = np.minimum(low, kept["point"].min(axis=0)), np.maximum(high, kept["point"].max(axis=0))
                kept.tofile(stream)
        if not points:
            raise RecordingError("rays passed through every voxel, so the map is empty (--keep-above 0 keeps all)")
        known = self._has_intensity, self._covariances is not None
        return SiteMap(file, points, met - points, self.scans, self.left_out, self.undeskewed, low, high, *known)

    def _rows_of(self, points: Array) -> NDArray[np.intp]:
        near = np.flatnonzero(np.einsum("nd,nd->n", points, points) <= self._options.max_range_m**2)
        return near[:: max(1, -(-len(near) // self._options.max_points_per_scan))]

    def _is_followed(self, stamp_ns: int) -> bool:
        if self._followed_ns is not None and stamp_ns < self._followed_ns + PERIOD_NS:
            return False
        self._followed_ns = stamp_ns
        return True


def _side_by_side(voxels: Iterator[Records], cells: Iterator[Records]) -> Iterator[tuple[Records, Records]]:
    """Yield blocks of voxels, each with the record of its cell; zeros where no ray was followed through it."""
    ahead = np.zeros(0, dtype=CELL)
    for block in voxels:
        wanted = block["key"] >> CELL_SHIFT
        while not len(ahead) or ahead["key"][-1] < wanted[-1]:
            more = next(cells, None)
            if more is None:
                break
            ahead = np.concatenate([ahead[ahead["key"] >= wanted[0]], more])
        found = np.zeros(len(block), dtype=CELL)
        at = np.searchsorted(ahead["key"], wanted)
        inside = at < len(ahead)
        inside[inside] = ahead["key"][at[inside]] == wanted[inside]
        found[inside] = ahead[at[inside]]
        yield block, found
