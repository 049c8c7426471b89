"""The picture of the README: errors of all systems over both tasks, through the outage; Figs. 3 and 4 in one."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.messages import Array
from holdfast.paper.page_figures import COLOUR
from holdfast.paper.results import Results
from holdfast.paper.study import TASKS
from holdfast.paper.systems import SYSTEMS
from holdfast.paper.tables import OURS
from holdfast.report.figures import GREY, INK, RULE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = "outage.png"
BINS = 120  # of equal length per task: few enough to distinguish five lines
LEAST_MM = 1.0
OUTAGE = "#d55e00"


def draw_picture(results: Results, folder: Path) -> Path:
    """Draw OUT/outage.png, and return its path.

    Its ground is white: a page may be light or dark about it.

    Raises:
        ConfigError: matplotlib is not installed, there is nothing to draw, or the file cannot be written.
    """
    with needing(PICTURE, "plot"):
        from matplotlib.figure import Figure
    if not results.curves:
        raise ConfigError(f"{PICTURE}: no system has a verdict")
    figure = Figure(figsize=(10.0, 4.3), layout="constrained")
    tops: list[Axes] = list(figure.subplots(1, len(TASKS), sharey=True))
    for axes, scenario in zip(tops, TASKS, strict=True):
        _draw(axes, results, scenario)
    tops[0].set_ylabel("error of position [mm]")
    named = {str(line.get_label()): line for axes in tops for line in axes.get_lines()}
    titles = [system.title for system in SYSTEMS.values() if system.title in named]
    figure.legend(
        [named[title] for title in titles], titles, loc="outside upper left", ncols=len(titles), frameon=False
    )
    file = folder / PICTURE
    try:
        figure.savefig(file, dpi=130, facecolor="white")
    except OSError as error:
        raise ConfigError(f"{file}: cannot be written ({error.strerror or error})") from None
    return file


def rms_in_bins(times_s: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """Return the middles of bins of equal length (B,) [s] and the RMS of values (N,) in each; empty ones are left out.

    Lines that touch zero would dive on a logarithmic axis; their RMS over a second or two does not.
    """
    edges = np.linspace(times_s[0], times_s[-1], bins + 1)
    rows = np.clip(np.searchsorted(edges, times_s, side="right") - 1, 0, bins - 1)
    counts = np.bincount(rows, minlength=bins)
    squares = np.bincount(rows, weights=values**2, minlength=bins)
    middles, known = (edges[:-1] + edges[1:]) / 2.0, counts > 0
    return middles[known], np.sqrt(squares[known] / counts[known])


def _draw(axes: "Axes", results: Results, scenario: str) -> None:
    found = {name: results.curves.get(f"{scenario}-0-{name}") for name in SYSTEMS}
    for name, of in reversed(found.items()):  # ours is drawn above the others
        if of is not None:
            error_mm = 1e3 * np.sqrt(of["east_m"] ** 2 + of["north_m"] ** 2 + of["up_m"] ** 2)
            at_s, rms_mm = rms_in_bins(of["time_s"], np.maximum(error_mm, LEAST_MM), BINS)
            width = 2.4 if name == OURS else 1.3
            axes.plot(at_s, rms_mm, color=COLOUR[name], lw=width, label=SYSTEMS[name].title)
    runs = [run for run in results.of("accuracy", scenario, OURS) if run.seed == 0]
    for one in runs[0].outages if runs else ():
        axes.axvspan(one.start_s, one.end_s, color=OUTAGE, alpha=0.12, lw=0)
        axes.text(
            0.5 * (one.start_s + one.end_s), 0.98, "no good fix", ha="center", va="top", fontsize=9, color=OUTAGE,
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
    axes.set_yscale("log")
    short = ", shortened" if results.quick else ""
    axes.set_title(f"{scenario}, seed 0{short}", loc="left", fontsize=11, color=INK)
    axes.set_xlabel("time [s]")
    axes.margins(x=0.01)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.grid(color=RULE, lw=0.7)
    axes.set_axisbelow(True)
