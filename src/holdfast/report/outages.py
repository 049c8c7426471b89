"""Where a run was without GNSS, for every section of its report."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.report.figures import Band
from holdfast.report.run_record import RunRecord
from holdfast.report.timeline import Interval, lost_intervals

LOST = "#d55e00"


def outages(run: RunRecord) -> list[Interval]:
    """Return when no receiver was trusted."""
    return lost_intervals(run.events, run.start_ns, run.end_s)


def outage_bands(run: RunRecord) -> list[Band]:
    """Return them as bands behind plots."""
    return [Band(interval.start_s, interval.end_s, LOST, "without GNSS") for interval in outages(run)]


def within(times_s: Array, intervals: Sequence[Interval]) -> NDArray[np.bool_]:
    """Return which times (N,) are within one of the intervals."""
    found = np.zeros(len(times_s), dtype=np.bool_)
    for interval in intervals:
        found |= (times_s >= interval.start_s) & (times_s < interval.end_s)
    return found
