"""Stretches of time: without something, the longest one of a kind, and how long until a value has settled."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array


class Span(NamedTuple):
    """A stretch of time, from its start to before its end [s]."""

    start_s: float
    end_s: float

    def holds(self, times_s: Array) -> NDArray[np.bool_]:
        """Tell which of the times (N,) lie in it."""
        inside: NDArray[np.bool_] = (times_s >= self.start_s) & (times_s < self.end_s)
        return inside


def gaps(times_s: Array, longer_than_s: float, whole: Span) -> list[Span]:
    """Return the stretches of the whole, longer than asked for, in which none of the sorted times (N,) lies."""
    inside = times_s[(times_s >= whole.start_s) & (times_s <= whole.end_s)]
    edges = np.concatenate([[whole.start_s], inside, [whole.end_s]])
    return [Span(float(edges[k]), float(edges[k + 1])) for k in np.flatnonzero(np.diff(edges) > longer_than_s)]


def longest_s(times_s: Array, true: NDArray[np.bool_]) -> float:
    """Return how long something (N,) was true at a stretch, from the first such time to the first one after it [s]."""
    if not true.any():
        return 0.0
    change = np.diff(np.concatenate([[0], true.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    return float((times_s[np.minimum(ends, len(times_s) - 1)] - times_s[starts]).max())


def settling_s(times_s: Array, values: Array, limit: float, hold_s: float) -> float:
    """Return the time from the first of the times until the values (N,) have come below the limit to stay for `hold_s`.

    Infinite if they never do; a stretch that the end of the times cuts short counts as held.
    """
    above = np.flatnonzero(values >= limit)
    starts = np.concatenate([[-1], above]) + 1  # of the stretches below the limit
    ends = np.concatenate([above, [len(values)]])
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if start < end and (end == len(values) or times_s[end] - times_s[start] >= hold_s):
            return float(times_s[start] - times_s[0])
    return np.inf
