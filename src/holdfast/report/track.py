"""The figure of one replay judged by held-out fixes: the track from above, and the error over time."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.extras import needing
from holdfast.messages import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRACK, HELD, LOST = "#1f4e8c", "#2a9d5c", "#d1495b"


@dataclass(frozen=True, slots=True, eq=False)
class JudgedTrack:
    """What the figure shows; times are seconds since the start of the track.

    Attributes:
        time_s: (N,) of the causal track.
        positions: (N, 2) east, north [m].
        sigma_m: (N,) horizontal standard deviation that the estimator reports, sqrt(trace).
        fix_time_s: (M,) of the held-out fixes.
        fixes: (M, 2) east, north [m].
        errors_m: (M,) horizontal.
        in_outage: (M,) bool.
    """

    time_s: Array
    positions: Array
    sigma_m: Array
    fix_time_s: Array
    fixes: Array
    errors_m: Array
    in_outage: "np.ndarray[tuple[int], np.dtype[np.bool_]]"


def draw_track(track: JudgedTrack, path: Path, title: str, outages_s: Sequence[tuple[float, float]]) -> None:
    """Draw the figure into a PNG, SVG or PDF file.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    with needing("the figure", "plot"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    above, over_time = figure.subplots(1, 2, width_ratios=[1.0, 1.25])
    figure.suptitle(title, fontsize=12, x=0.01, ha="left", fontweight="bold")
    _draw_above(above, track, outages_s)
    _draw_over_time(over_time, track, outages_s)
    figure.savefig(path, dpi=140)


def _draw_above(axes: "Axes", track: JudgedTrack, outages_s: Sequence[tuple[float, float]]) -> None:
    axes.plot(*track.positions.T, color=TRACK, lw=1.4, label="estimate, as it was published")
    for k, (start, end) in enumerate(outages_s):
        lost = (track.time_s >= start) & (track.time_s < end)
        label = "estimate without GNSS" if k == 0 else None
        axes.plot(*track.positions[lost].T, color=LOST, lw=2.6, label=label)
    axes.scatter(track.fixes[:, 0], track.fixes[:, 1], s=7, color=HELD, zorder=3, lw=0, label="held-out fixes")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8, frameon=False)
    _tidy(axes)


def _draw_over_time(axes: "Axes", track: JudgedTrack, outages_s: Sequence[tuple[float, float]]) -> None:
    for start, end in outages_s:
        axes.axvspan(start, end, color=LOST, alpha=0.12, lw=0)
        axes.text(0.5 * (start + end), 0.97, "no GNSS", ha="center", va="top", fontsize=8, color=LOST,
                  transform=axes.get_xaxis_transform())  # fmt: skip
    axes.semilogy(track.time_s, np.maximum(track.sigma_m, 1e-3), color="#9aa5b1", lw=1.0, label="sigma it reports")
    for mask, colour, label in ((~track.in_outage, HELD, "error at held-out fixes"), (track.in_outage, LOST, None)):
        axes.scatter(
            track.fix_time_s[mask], np.maximum(track.errors_m[mask], 1e-3), s=9, lw=0, color=colour, label=label
        )
    axes.set_xlabel("time since the start of the estimate [s]")
    axes.set_ylabel("horizontal [m]")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8, frameon=False)
    _tidy(axes)


def _tidy(axes: "Axes") -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e6e9ee", lw=0.7)
    axes.set_axisbelow(True)
