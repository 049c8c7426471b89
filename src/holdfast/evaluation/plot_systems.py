"""One figure of several systems: tracks from above, horizontal errors over time, box plots of errors over segments."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.evaluation.plot import REFERENCE, STYLE, TEXT, broken_at_gaps, check_plot, thinned
from holdfast.evaluation.side_by_side import System
from holdfast.whole_file import whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, then dashes
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#7a5195")
DASHES = ("-", "--", ":", "-.")
LOG_FROM = 30.0  # ratio of the largest to the smallest RMS beyond which errors need a logarithmic axis


def plot_systems(systems: Sequence[System], path: Path, title: str) -> None:
    """Draw the systems into a PNG, SVG or PDF.

    Raises:
        ConfigError: as `check_plot`, or the file cannot be written.
    """
    check_plot(path)
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 7.0), dpi=130, layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.15))
        _draw_tracks(figure.add_subplot(grid[:, 0]), systems)
        _draw_errors(figure.add_subplot(grid[0, 1]), systems)
        _draw_boxes(figure.add_subplot(grid[1, 1]), systems)
        _add_legend(figure)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
        with whole(path) as part:
            figure.savefig(part, metadata={"Date": None} if path.suffix.lower() == ".svg" else None)


def _look(index: int) -> tuple[str, str]:
    """Return colour and dash of a system."""
    return COLOURS[index % len(COLOURS)], DASHES[index // len(COLOURS) % len(DASHES)]


def _draw_tracks(axes: "Axes", systems: Sequence[System]) -> None:
    reference = systems[0].accuracy.pairs.reference.positions
    thin = thinned(len(reference))
    axes.plot(*reference[thin, :2].T, color=REFERENCE, linewidth=3.5, label="reference", solid_capstyle="round")
    for index, system in enumerate(systems):
        colour, dash = _look(index)
        positions = system.accuracy.pairs.estimate.positions
        axes.plot(*positions[thin, :2].T, color=colour, linestyle=dash, linewidth=1.2, label=system.name)
    axes.plot(*reference[0, :2], marker="o", color=TEXT, markersize=5, linestyle="none", label="start")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.set_title("seen from above")


def _draw_errors(axes: "Axes", systems: Sequence[System]) -> None:
    for index, system in enumerate(systems):
        colour, dash = _look(index)
        values = np.maximum(system.accuracy.errors["horizontal_m"], 1e-4)
        line = broken_at_gaps(system.accuracy.pairs.since_start_s(), values)
        axes.plot(*line, color=colour, linestyle=dash, linewidth=1.0)
    rms = [system.accuracy.scores["all"].ape["horizontal_m"].rms for system in systems]
    if max(rms) > LOG_FROM * min(rms):
        axes.set_yscale("log")
    axes.set_xlabel("time since the start of the reference [s]")
    axes.set_ylabel("horizontal error [m]")
    axes.margins(x=0.01)


def _draw_boxes(axes: "Axes", systems: Sequence[System]) -> None:
    """Draw a box per system and length: quartiles, whiskers at 5 and 95 %, no outliers."""
    lengths = [length for length in systems[0].segments if any(len(one.segments[length]) for one in systems)]
    width = 0.8 / len(systems)
    for index, system in enumerate(systems):
        colour, _ = _look(index)
        drawn = [(k, system.segments[length]) for k, length in enumerate(lengths) if len(system.segments[length])]
        if drawn:
            axes.boxplot(
                [errors for _, errors in drawn],
                positions=[k + (index - 0.5 * (len(systems) - 1)) * width for k, _ in drawn],
                widths=0.85 * width, whis=(5, 95), showfliers=False, patch_artist=True, manage_ticks=False,
                boxprops={"facecolor": colour, "alpha": 0.55, "edgecolor": colour},
                medianprops={"color": TEXT}, whiskerprops={"color": colour}, capprops={"color": colour},
            )  # fmt: skip
    medians = [
        float(np.median(one.segments[length])) for one in systems for length in lengths if len(one.segments[length])
    ]
    if medians and min(medians) > 0.0 and max(medians) > LOG_FROM * min(medians):
        axes.set_yscale("log")
    axes.set_xticks(range(len(lengths)), [f"{length:g}" for length in lengths])
    axes.set_xlabel("length of the segment [m]")
    axes.set_ylabel("translation error [m]")
    axes.set_title(
        "relative error over segments: quartiles, 5 to 95 %" if lengths else "the track is too short for segments"
    )


def _add_legend(figure: "Figure") -> None:
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=min(len(names), 5), frameon=False)
