"""Records on disk: the same as if all had been sorted in memory, with few of them in memory."""

from pathlib import Path

import numpy as np
import pytest

from holdfast.mapping.sorted_runs import SortedRuns, merged
from holdfast.mapping.voxels import CELL, CELL_SUMS, VOXEL, VOXEL_SUMS


def voxels(count: int, keys: int, rng: np.random.Generator) -> np.ndarray:
    records = np.zeros(count, dtype=VOXEL)
    records["key"], records["priority"] = rng.integers(0, keys, count), rng.random(count)
    records["point"], records["points"], records["scans"] = rng.random((count, 3)), rng.integers(1, 9, count), 1
    return records


@pytest.mark.parametrize("keys", [50, 2_000, 1_000_000])
def test_runs_on_disk_merge_as_if_sorted_in_memory(tmp_path: Path, keys: int):
    rng = np.random.default_rng(0)
    parts = [voxels(700, keys, rng) for _ in range(30)]
    runs = SortedRuns(tmp_path, "voxels", VOXEL, VOXEL_SUMS, waiting_rows=1000, block_rows=64)
    for part in parts:
        runs.add(part)
    blocks = list(runs.blocks())
    found = np.concatenate(blocks)
    assert np.array_equal(found, merged(np.concatenate(parts), VOXEL_SUMS))
    assert (np.diff(found["key"]) > 0).all()
    # each block holds at most a head of each run, and runs are few: their sizes at least double
    assert max(map(len, blocks)) <= 64 * 8


def test_few_files_are_kept_however_much_is_added(tmp_path: Path):
    rng = np.random.default_rng(0)
    runs = SortedRuns(tmp_path, "voxels", VOXEL, VOXEL_SUMS, waiting_rows=1000, block_rows=256)
    for _ in range(200):
        runs.add(voxels(700, 10_000_000, rng))
        assert len(list(tmp_path.iterdir())) <= 9  # 2^9 spills would make ten


def test_the_record_of_least_priority_stands_for_its_voxel():
    records = np.zeros(3, dtype=VOXEL)
    records["key"], records["priority"], records["stamp_ns"], records["points"] = (
        7,
        [0.5, 0.1, 0.9],
        [1, 2, 3],
        [2, 3, 4],
    )
    (kept,) = merged(records, VOXEL_SUMS)
    assert (kept["stamp_ns"], kept["points"]) == (2, 9)


def test_nothing_added_gives_nothing(tmp_path: Path):
    assert list(SortedRuns(tmp_path, "cells", CELL, CELL_SUMS).blocks()) == []
