"""Records sorted by key on disk, each key once: more than memory holds, added in any order.

What is added waits in memory, is sorted, merged and spilled as a run. Runs of like size are merged into one, as in a
log-structured merge tree (O'Neil et al., Acta Informatica 33, 1996), so that each record is rewritten a logarithmic
number of times. Every run is read in blocks: memory is bounded whatever their number of records.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.void]
WAITING_ROWS = 400_000
BLOCK_ROWS = 100_000


class SortedRuns:
    """Records of one dtype with a field `key`, merged by it.

    Args:
        folder: of the runs; whoever made it removes it.
        name: begins the names of the files.
        dtype: of the records.
        sums: the fields that are added up; of the others those of the record with the least `priority` are kept.
        waiting_rows: so many wait in memory.
        block_rows: so many of each run are read at once.

    Raises:
        OSError: the disk is full.
    """

    def __init__(  # noqa: PLR0917 (the last two are for tests)
        self,
        folder: Path,
        name: str,
        dtype: np.dtype[Any],
        sums: Sequence[str],
        waiting_rows: int = WAITING_ROWS,
        block_rows: int = BLOCK_ROWS,
    ) -> None:
        self._folder, self._name, self._dtype, self._sums = folder, name, dtype, tuple(sums)
        self._waiting_rows, self._block_rows = waiting_rows, block_rows
        self._waiting: list[Records] = []
        self._rows = 0
        self._runs: list[tuple[Path, int]] = []  # file and number of records, the largest first
        self._made = 0

    def add(self, records: Records) -> None:
        """Add records in any order."""
        self._waiting.append(records)
        self._rows += len(records)
        if self._rows > self._waiting_rows:
            self._settle()
            if self._rows > self._waiting_rows // 2:
                self._spill()

    def blocks(self) -> Iterator[Records]:
        """Yield all records, each key once, in blocks sorted by key."""
        self._settle()
        if self._rows:
            self._spill()
        yield from self._merged([file for file, _ in self._runs])

    def _settle(self) -> None:
        if len(self._waiting) > 1 or self._rows:
            self._waiting = [merged(np.concatenate(self._waiting), self._sums)]
            self._rows = len(self._waiting[0])

    def _spill(self) -> None:
        self._runs.append(self._write(iter(self._waiting)))
        self._waiting, self._rows = [], 0
        while len(self._runs) > 1 and self._runs[-2][1] <= 2 * self._runs[-1][1]:
            (older, _), (newer, _) = self._runs[-2:]
            self._runs[-2:] = [self._write(self._merged([older, newer]))]
            older.unlink()
            newer.unlink()

    def _write(self, blocks: Iterator[Records]) -> tuple[Path, int]:
        self._made += 1
        file, rows = self._folder / f"{self._name}-{self._made}", 0
        with file.open("wb") as stream:
            for block in blocks:
                block.tofile(stream)
                rows += len(block)
        return file, rows

    def _merged(self, files: Sequence[Path]) -> Iterator[Records]:
        """Yield the records of several runs: each time up to the least key that all heads reach."""
        streams = [read_blocks(file, self._dtype, self._block_rows) for file in files]
        heads: list[Records | None] = [next(stream, None) for stream in streams]
        while any(head is not None for head in heads):
            bound = min(head["key"][-1] for head in heads if head is not None)
            ready = []
            for index, head in enumerate(heads):
                if head is not None:
                    end = int(np.searchsorted(head["key"], bound, side="right"))
                    ready.append(head[:end])
                    heads[index] = head[end:] if end < len(head) else next(streams[index], None)
            yield merged(np.concatenate(ready), self._sums)


def merged(records: Records, sums: Sequence[str]) -> Records:
    """Return records sorted by key, each key once."""
    by_key = records["key"]
    ranked = "priority" in (records.dtype.names or ())
    order = np.lexsort((records["priority"], by_key)) if ranked else np.argsort(by_key, kind="stable")
    first = np.flatnonzero(np.diff(by_key[order], prepend=-1))
    kept: Records = records[order[first]]
    if len(first):
        for name in sums:
            kept[name] = np.add.reduceat(records[name][order], first)
    return kept


def read_blocks(file: Path, dtype: np.dtype[Any], rows: int) -> Iterator[Records]:
    """Yield the records of a file, so many at a time."""
    with file.open("rb") as stream:
        while len(block := np.fromfile(stream, dtype=dtype, count=rows)):
            yield block
