"""One figure of a verdict: both tracks from above, and the errors over time with the intervals coloured."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.errors import ConfigError
from holdfast.evaluation.accuracy import WHOLE, Accuracy
from holdfast.extras import needing
from holdfast.messages import Array
from holdfast.whole_file import whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf")

# Okabe and Ito's palette: distinguishable with any colour vision
REFERENCE = "#9a9a9a"
_ESTIMATE = "#0072b2"
_INTERVALS = ("#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#f0e442")
GRID = "#e6e6e6"
TEXT = "#333333"
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": REFERENCE,
    "axes.labelcolor": TEXT,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "xtick.color": TEXT,
    "ytick.color": TEXT,
    "text.color": TEXT,
    "svg.hashsalt": "holdfast",  # the same verdict gives the same file
}
_MAX_POINTS = 20_000  # more points than pixels only make the file large


def check_plot(path: Path) -> None:
    """Find out before the work is done whether a figure can be drawn into this file.

    Raises:
        ConfigError: the suffix is not one that is offered, or matplotlib is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"--plot {path}: the name must end in one of {', '.join(SUFFIXES)}")
    with needing("--plot", "plot"):
        import matplotlib as mpl  # noqa: F401


def plot_accuracy(accuracy: Accuracy, path: Path, title: str) -> None:
    """Draw the verdict into a PNG, SVG or PDF.

    Raises:
        ConfigError: as `check_plot`, or the file cannot be written.
    """
    check_plot(path)
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 7.0), dpi=130, layout="constrained")
        _draw(figure, accuracy, title)
        with whole(path) as part:
            figure.savefig(part, metadata={"Date": None} if path.suffix.lower() == ".svg" else None)


def _draw(figure: "Figure", accuracy: Accuracy, title: str) -> None:
    rows = [("east_m", "east [m]"), ("north_m", "north [m]"), ("up_m", "up [m]")]
    if accuracy.pairs.oriented:
        rows.append(("yaw_deg", "yaw [deg]"))
    colours = dict(zip(_named(accuracy), _INTERVALS * len(accuracy.scores), strict=False))
    grid = figure.add_gridspec(len(rows), 2, width_ratios=(1.0, 1.15))
    _draw_tracks(figure.add_subplot(grid[:, 0]), accuracy, colours)
    top = figure.add_subplot(grid[0, 1])
    below = [figure.add_subplot(grid[index, 1], sharex=top) for index in range(1, len(rows))]
    for axes, (name, label) in zip([top, *below], rows, strict=True):
        _draw_error(axes, accuracy, name, label, colours)
        axes.tick_params(labelbottom=axes is below[-1])
    top.set_title("error, estimate − reference")
    below[-1].set_xlabel("time since the reference's first pose [s]")
    figure.align_ylabels()
    figure.legend(loc="outside lower left", ncols=5, frameon=False, fontsize=8.5)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")


def _named(accuracy: Accuracy) -> Iterable[str]:
    return [name for name in accuracy.scores if name != WHOLE]


def _draw_tracks(axes: "Axes", accuracy: Accuracy, colours: dict[str, str]) -> None:
    pairs, time_s = accuracy.pairs, accuracy.pairs.since_start_s()
    thin = thinned(len(time_s))
    reference, estimate = pairs.reference.positions[thin], pairs.estimate.positions[thin]
    axes.plot(*reference[:, :2].T, color=REFERENCE, linewidth=3.5, label="reference", solid_capstyle="round")
    axes.plot(*estimate[:, :2].T, color=_ESTIMATE, linewidth=1.2, label="estimate")
    axes.plot(*reference[0, :2], marker="o", color=TEXT, markersize=5, linestyle="none", label="start")
    for name, colour in colours.items():
        score = accuracy.scores[name]
        inside = (time_s[thin] >= score.start_s) & (time_s[thin] <= score.end_s)
        axes.plot(*estimate[inside, :2].T, color=colour, linewidth=2.2, label=f"{name}, {_end(accuracy, name)}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.set_title("seen from above")


def _end(accuracy: Accuracy, name: str) -> str:
    end = accuracy.scores[name].end
    percent = "" if end.percent is None else f" ({end.percent:.2f} % of {end.driven_m:.0f} m)"
    return f"ends {end.translation_m:.2f} m off{percent}"


def _draw_error(axes: "Axes", accuracy: Accuracy, name: str, label: str, colours: dict[str, str]) -> None:
    time_s, values = accuracy.pairs.since_start_s(), accuracy.errors[name]
    for interval, colour in colours.items():
        score = accuracy.scores[interval]
        axes.axvspan(score.start_s, score.end_s, color=colour, alpha=0.22, linewidth=0.0)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.8)
    axes.plot(*broken_at_gaps(time_s, values), color=_ESTIMATE, linewidth=1.0)
    axes.set_ylabel(label)
    axes.margins(x=0.01)
    rms = accuracy.scores[WHOLE].ape[name].rms
    axes.set_title(f"rms {rms:.3g} {label.split('[')[1].rstrip(']')}", loc="right", fontsize=8.5, pad=3.0)


def thinned(count: int) -> slice:
    """Return which of so many points are drawn."""
    return slice(None, None, max(1, count // _MAX_POINTS))


def broken_at_gaps(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Thin a line and break it where pairs are missing."""
    time_s, values = time_s[thinned(len(time_s))], values[thinned(len(values))]
    step_s = np.diff(time_s)
    gaps = np.flatnonzero(step_s > 5.0 * np.median(step_s)) + 1
    return np.insert(time_s, gaps, np.nan), np.insert(values, gaps, np.nan)
