"""Rows of 64-bit words in memory that two processes share: each carries its number and a checksum.

So a reader knows a whole row from one that is just being written, whatever the order in which a processor makes stores
visible.
"""

from typing import Any

import numpy as np

from holdfast.kernel.compiling import entry, inner
from holdfast.kernel.types import INT64, INTS

WIDTH = 11  # words of a sample's row
FACTOR, SEED = np.uint64(0x9E3779B97F4A7C15), np.uint64(0x2545F4914F6CDD1D)


@inner
def checksum(row: Any) -> int:
    """Return a checksum of all words of a row but the last: each is mixed into a product, whose halves are folded."""
    total = SEED
    for k in range(len(row) - 1):
        total = (total ^ np.uint64(row[k])) * FACTOR
        total ^= total >> np.uint64(32)
    return np.int64(total)  # type: ignore[return-value]


@inner
def write_row(
    words: Any, floats: Any, number: int, epoch: int, stamp_ns: int, arrival_ns: int, reading: tuple[float, ...]
) -> None:
    """Write the row of a sample.

    Args:
        words: (rows, `WIDTH`) integers: number, epoch, stamp, arrival, six readings, checksum.
        floats: the same memory as doubles.
        number: of the row, from 0 on.
        epoch: how often all began anew.
        stamp_ns: of the sample.
        arrival_ns: when it came.
        reading: (6,) specific force [m/s^2] and angular velocity [rad/s].
    """
    row, values = words[number % len(words)], floats[number % len(words)]
    row[0], row[1], row[2], row[3] = number, epoch, stamp_ns, arrival_ns
    for k in range(6):
        values[4 + k] = reading[k]
    row[len(row) - 1] = checksum(row)


# --- what Python calls: compiled here, so it comes last


@entry(INT64, INTS)
def find_checksum(row: Any) -> int:
    """Return the checksum of all words of a row but the last."""
    return checksum(row)
