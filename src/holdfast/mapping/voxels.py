"""Voxels and their records: what is kept of the points that fell into one.

The key of a voxel begins with that of its cell, a cube of 2 x 2 x 2 voxels: sorting by voxel sorts by cell, too.
"""

import numpy as np
from numpy.typing import NDArray

from holdfast.mapping.sorted_runs import Records
from holdfast.messages import Array

BITS = 21  # per axis: 200 km at 0.1 m
CELL_SHIFT = 3

VOXEL = np.dtype(
    [
        ("key", "<i8"),
        ("point", "<f8", 3),  # in W [m]: one that was measured, drawn at random
        ("stamp_ns", "<i8"),  # of it
        ("priority", "<f4"),
        ("intensity", "<f4"),
        ("sigma_m", "<f4"),
        ("points", "<u4"),
        ("scans", "<u4"),
    ]
)
VOXEL_SUMS = ("points", "scans")
CELL = np.dtype([("key", "<i8"), ("ended", "<u4"), ("passed", "<u4")])
CELL_SUMS = ("ended", "passed")


def voxel_keys(points: Array, voxel_m: float) -> NDArray[np.int64]:
    """Return the key (N,) of each point's voxel; `>> CELL_SHIFT` gives that of its cell."""
    half = 1 << (BITS - 1)
    x, y, z = np.clip(np.floor(points / voxel_m).astype(np.int64) + half, 0, 2 * half - 1).T
    cell = ((x >> 1) << (2 * (BITS - 1))) | ((y >> 1) << (BITS - 1)) | (z >> 1)
    keys: NDArray[np.int64] = (cell << CELL_SHIFT) | ((x & 1) << 2) | ((y & 1) << 1) | (z & 1)
    return keys


def cell_counts(keys: NDArray[np.int64], field: str) -> Records:
    """Return a record per cell among keys (N,) of cells, with how often it is there in one of its fields."""
    found, counts = np.unique(keys, return_counts=True)
    records = np.zeros(len(found), dtype=CELL)
    records["key"], records[field] = found, counts
    return records
