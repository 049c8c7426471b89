"""Finds rows by their stamps."""

from typing import Any

from holdfast.kernel.compiling import inner


@inner
def first_after(rows: Any, low: int, high: int, stamp_ns: int) -> int:
    """Return the first row in [low, high), sorted by stamp, that is later than a time; `high` if there is none."""
    while low < high:
        middle = (low + high) // 2
        if rows[middle].stamp_ns > stamp_ns:
            high = middle
        else:
            low = middle + 1
    return low
