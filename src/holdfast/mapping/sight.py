"""What moved: cells that rays saw through.

Of the rays that reach a cell, some end in it and some pass. A wall lets none pass; where a lorry stood for a minute of
an hour, nearly all do. A ray that only grazes a surface passes through its cells, too, before it ends: of cells of side
c, within c d / h of the end at a distance d, where the lidar is h above the surface. So the last part of each ray does
not count, c + c d / `BESIDE_M`; nor do the rays of a scan that has a point in the cell.
"""

import numpy as np
from numpy.typing import NDArray

from holdfast.mapping.sorted_runs import Records
from holdfast.mapping.voxels import CELL_SHIFT, cell_counts, voxel_keys
from holdfast.messages import Array

RAYS = 3000  # of a scan, drawn at random
PERIOD_NS = 500_000_000  # of the scans whose rays are followed
BESIDE_M = 2.0  # larger thins more of what moved close above the ground, and of the ground itself
MIN_RAYS = 5  # that reached a cell, before it is judged


def ray_cells(moved_points: Array, lidar: Array, voxel_m: float, rng: np.random.Generator) -> list[Records]:
    """Return the cells in which rays of a scan ended, and those through which they passed, with their numbers.

    Args:
        moved_points: (N, 3) in W [m].
        lidar: (N, 3) where each ray began [m].
        voxel_m: side of a voxel, half that of a cell.
        rng: draws the rays.
    """
    every = np.unique(voxel_keys(moved_points, voxel_m) >> CELL_SHIFT)
    drawn = rng.permutation(len(moved_points))[:RAYS]
    ended = voxel_keys(moved_points[drawn], voxel_m) >> CELL_SHIFT
    passed = _passed(moved_points[drawn], lidar[drawn], voxel_m)
    return [cell_counts(ended, "ended"), cell_counts(passed[~np.isin(passed, every)], "passed")]


def is_seen_through(cells: Records, keep_above: float) -> NDArray[np.bool_]:
    """Return which of N cells are empty for most of the time: fewer of the rays end there than `keep_above` of all."""
    ended, reached = cells["ended"], cells["ended"] + cells["passed"]
    seen: NDArray[np.bool_] = (reached >= MIN_RAYS) & (ended < keep_above * reached)
    return seen


def _passed(points: Array, origins: Array, voxel_m: float) -> NDArray[np.int64]:
    """Return the cells through which rays pass, once for each ray; a corner that is cut may be missed."""
    cell_m = 2.0 * voxel_m
    rays = points - origins
    length = np.linalg.norm(rays, axis=1)
    free = length - cell_m - length * cell_m / BESIDE_M
    steps = np.maximum(free / cell_m, 0.0).astype(np.int64)
    ray = np.repeat(np.arange(len(rays)), steps)
    number = np.arange(len(ray)) - np.repeat(np.cumsum(steps) - steps, steps)
    along = (number + 0.5) * cell_m / length[ray]
    keys = voxel_keys(origins[ray] + along[:, None] * rays[ray], voxel_m) >> CELL_SHIFT
    again = np.zeros(len(keys), dtype=np.bool_)
    again[1:] = (keys[1:] == keys[:-1]) & (ray[1:] == ray[:-1])
    once: NDArray[np.int64] = keys[~again]
    return once
