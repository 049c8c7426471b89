"""Spans of time: gaps, the longest span in which a condition holds, and settling times."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array


class Span(NamedTuple):
    """A span of time, from its start to before its end."""

    start_s: float
    end_s: float

    def holds(self, times_s: Array) -> NDArray[np.bool_]:
        """Return which of the times (N,) are within it."""
        inside: NDArray[np.bool_] = (times_s >= self.start_s) & (times_s < self.end_s)
        return inside


def gaps(times_s: Array, longer_than_s: float, whole: Span) -> list[Span]:
    """Return the spans of the whole, longer than `longer_than_s`, without any of the sorted times (N,)."""
    inside = times_s[(times_s >= whole.start_s) & (times_s <= whole.end_s)]
    edges = np.concatenate([[whole.start_s], inside, [whole.end_s]])
    return [Span(float(edges[k]), float(edges[k + 1])) for k in np.flatnonzero(np.diff(edges) > longer_than_s)]


def longest_s(times_s: Array, true: NDArray[np.bool_]) -> float:
    """Return the longest span in which a condition (N,) was true, from its first time to the first one after it [s]."""
    if not true.any():
        return 0.0
    change = np.diff(np.concatenate([[0], true.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    return float((times_s[np.minimum(ends, len(times_s) - 1)] - times_s[starts]).max())


def settling_s(times_s: Array, values: Array, limit: float, hold_s: float) -> float:
    """Return the time from the first of the times until the values (N,) have come below the limit to stay for `hold_s`.

    Infinite if they never do; a span that the end of the times cuts short counts as held.
    """
    above = np.flatnonzero(values >= limit)
    starts = np.concatenate([[-1], above]) + 1  # of the spans below the limit
    ends = np.concatenate([above, [len(values)]])
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if start < end and (end == len(values) or times_s[end] - times_s[start] >= hold_s):
            return float(times_s[start] - times_s[0])
    return np.inf
