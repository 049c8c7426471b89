"""Merging several streams by arrival, and the account of messages that were skipped."""

from collections.abc import Callable, Iterator, Sequence
from heapq import heapify, heappop, heapreplace
from typing import TypeVar

from holdfast.printable import quoted

RowT = TypeVar("RowT", bound=tuple[int, object, object])


def merge_by_arrival(
    parts: Sequence[tuple[int, Callable[[], Iterator[RowT]]]],
) -> Iterator[RowT]:
    """Merge parts by their rows' first field; memory holds one row of each part that has begun.

    A part is opened only when the merge reaches its start, so that the thousands of chunks of a long recording are not
    all in memory. A row that arrived before its predecessor in the same part follows it at once.

    Args:
        parts: (start [ns], function that opens the part); no row of a part arrives before its start.
    """
    heap: list[tuple[int, int, RowT | None, Iterator[RowT] | None]]
    heap = [(start_ns, number, None, None) for number, (start_ns, _) in enumerate(parts)]
    heapify(heap)
    while heap:
        arrival_ns, number, row, rows = heap[0]
        if rows is None:
            rows = parts[number][1]()
        if row is not None:
            yield row
        row = next(rows, None)
        if row is None:
            heappop(heap)
        else:
            heapreplace(heap, (max(arrival_ns, row[0]), number, row, rows))


class SkippedMessages:
    """Counts messages that could not be decoded, by topic."""

    def __init__(self) -> None:
        self._skipped: dict[str, tuple[int, int, str]] = {}

    def add(self, topic: str, arrival_ns: int, error: Exception) -> None:
        """Count one message."""
        count, first_ns, reason = self._skipped.get(topic, (0, arrival_ns, quoted(error) or type(error).__name__))
        self._skipped[topic] = (count + 1, first_ns, reason)

    def lines(self, file: str) -> list[str]:
        """Return one sentence per topic."""
        return [
            f"{file}: {count} message{'s' if count > 1 else ''} of {topic} could not be decoded and "
            f"{'were' if count > 1 else 'was'} skipped, the first at {first_ns} ns: {reason}"
            for topic, (count, first_ns, reason) in sorted(self._skipped.items())
        ]
