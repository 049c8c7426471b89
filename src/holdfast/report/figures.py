"""Figures of plotly from plain arrays: lines over time, tracks on a metric map, spans, quantiles, maps from above.

Every figure is made of at most a few thousand points: of a line each stretch keeps its least and greatest value, so
that no spike is lost. Colours are those of Okabe and Ito: distinguishable with any colour vision.

Importing it needs plotly: the extra `report`.
"""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.report.png import encode_png

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#7a5195", "#5f6b7a")
GREY, INK, RULE = "#9aa5b1", "#1d2630", "#e6e9ee"
MAX_POINTS_PER_LINE = 2000  # about as many as there are pixels
HATCHES = ("", "/", "x", ".")  # of bars, once the colours are used up
PIXELS = 700  # of the longer side of a map
TIME = "time [s]"
MARGIN_FRACTION = 0.04  # of the longer side of a map
GAP_STEPS = 5.0  # a line is broken where points are so many usual steps apart

Axis = Literal["linear", "log"]
TICKS: dict[Axis, int] = {"linear": 0, "log": 3}  # of a panel at most, powers of ten apart or more; 0: as many as fit


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Values over time, or positions from above.

    Attributes:
        x: (N,) time [s], or east [m].
        y: (N,) values, or north [m].
        colour: None for the next one.
        dash: of the stroke, in plotly's words.
        points: draw points, no stroke.
        is_on_top: other lines do not hide it.
        is_framed: a map is made large enough for it.
    """

    name: str
    x: Array
    y: Array
    colour: str | None = None
    dash: str = "solid"
    width: float = 1.5
    points: bool = False
    is_on_top: bool = False
    is_framed: bool = True


@dataclass(frozen=True, slots=True)
class Band:
    """A stretch of time that is coloured in the background."""

    start_s: float
    end_s: float
    colour: str = "#d55e00"
    name: str = ""


@dataclass(frozen=True, slots=True)
class Panel:
    """One of several plots over the same time.

    Attributes:
        label: of the vertical axis, with its unit.
        limit: half of the vertical axis' range about zero; None fits the lines.
    """

    label: str
    lines: Sequence[Line]
    axis: Axis = "linear"
    limit: float | None = None


@dataclass(frozen=True, slots=True)
class Span:
    """An interval in a row of a time line, with its tooltip."""

    row: str
    start_s: float
    end_s: float
    colour: str
    text: str


def over_time(panels: Sequence[Panel], bands: Sequence[Band] = (), label: str = TIME) -> go.Figure:
    """Return plots one below the other over one axis of time; lines of one name have one colour and legend entry."""
    figure = go.Figure(layout=_layout(120 + 190 * len(panels)) | _meta(over_time=label == TIME))
    colours = _colours([line for panel in panels for line in panel.lines])
    height, named = 1.0 / len(panels), set()
    for k, panel in enumerate(panels):
        suffix = "" if k == 0 else str(k + 1)
        top = 1.0 - k * height
        domain = [top - height + 0.03 * (len(panels) > 1), top]
        limits = {} if panel.limit is None else {"range": [-panel.limit, panel.limit]}
        axis = _axis(panel.label, panel.axis) | {"domain": domain, "anchor": "x", "nticks": TICKS[panel.axis]} | limits
        figure.update_layout({f"yaxis{suffix}": axis})
        for line in panel.lines:
            points = decimated(line.x, line.y)
            figure.add_trace(_trace(line, points, colours[line.name], line.name not in named, f"y{suffix}"))
            named.add(line.name)
    figure.update_layout(xaxis=_axis(label) | {"anchor": f"y{len(panels) if len(panels) > 1 else ''}"})
    _add_bands(figure, bands)
    return figure


def track_map(
    tracks: Sequence[Line],
    marks: Mapping[str, tuple[float, float]] | None = None,
    moving: tuple[Array, Array, Array] | None = None,
) -> go.Figure:
    """Return tracks from above on a metric grid, east to the right, equal scales.

    Args:
        tracks: strokes and points, one of them framed at least.
        marks: named positions, east and north [m].
        moving: times [s], east and north [m], each (N,), of what is marked at the time that a reader picks.
    """
    shown = np.concatenate([np.column_stack([track.x, track.y]) for track in tracks if track.is_framed])
    low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
    size_m = max(*(high - low), 1.0)
    figure = go.Figure(layout=_layout(560) | _meta(track=None if moving is None else _thin_track(*moving)))
    colours = _colours(tracks)
    for track in tracks:
        kept = _one_per_pixel(track, size_m) if track.points else _stride(len(track.x))
        figure.add_trace(_trace(track, (track.x[kept], track.y[kept]), colours[track.name], True))
    _square(figure)
    margin = MARGIN_FRACTION * size_m
    figure.update_layout(
        xaxis_range=[low[0] - margin, high[0] + margin], yaxis_range=[low[1] - margin, high[1] + margin]
    )
    for k, (name, (east, north)) in enumerate((marks or {}).items()):
        side = "right" if east < (low[0] + high[0]) / 2.0 else "left"  # its text stays within the axes
        above = "top" if k % 2 == 0 else "bottom"  # a track may end where it began
        figure.add_scatter(
            x=[east], y=[north], mode="markers+text", text=[name], textposition=f"{above} {side}", name=name,
            marker={"size": 9, "color": INK, "symbol": "circle-open", "line": {"width": 2}}, showlegend=False,
        )  # fmt: skip
    return figure


def time_line(rows: Sequence[str], spans: Sequence[Span], legend: Mapping[str, str], end_s: float) -> go.Figure:
    """Return spans in rows, the first row on top.

    Args:
        rows: names, in order.
        spans: what is drawn in them.
        legend: what a colour means, by name -> colour.
        end_s: of the axis of time [s].
    """
    figure = go.Figure(layout=_layout(130 + 34 * len(rows)) | _meta(over_time=True))
    for colour in dict.fromkeys(span.colour for span in spans):  # few traces are drawn fast, however many spans
        chosen = [span for span in spans if span.colour == colour]
        figure.add_bar(
            x=[span.end_s - span.start_s for span in chosen], base=[span.start_s for span in chosen],
            y=[span.row for span in chosen], hovertext=[span.text for span in chosen], orientation="h",
            showlegend=False,
            marker={"color": colour, "line": {"width": 0}}, width=0.7, hoverinfo="text", textposition="none", name="",
        )  # fmt: skip
    for name, colour in legend.items():
        figure.add_bar(x=[None], y=[rows[0]], orientation="h", name=name, marker={"color": colour})
    figure.update_layout(
        barmode="overlay",
        xaxis=_axis(TIME) | {"range": [0.0, end_s]},
        yaxis=_axis("") | {"categoryorder": "array", "categoryarray": list(reversed(rows)), "showgrid": False},
    )
    return figure


def counts_over_time(times_s: Mapping[str, Array], end_s: float, label: str, bins: int = 120) -> go.Figure:
    """Return how often named things happened over time, stacked."""
    figure = go.Figure(layout=_layout(320) | _meta(over_time=True))
    edges = np.linspace(0.0, max(end_s, 1e-9), bins + 1)
    for k, (name, times) in enumerate(times_s.items()):
        figure.add_bar(
            x=(edges[:-1] + edges[1:]) / 2.0, y=np.histogram(times, edges)[0], name=name,
            width=float(edges[1] - edges[0]),
            marker={"color": COLOURS[k % len(COLOURS)], "line": {"width": 0}, "pattern": _pattern(k // len(COLOURS))},
        )  # fmt: skip
    figure.update_layout(barmode="stack", xaxis=_axis(TIME), yaxis=_axis(label))
    return figure


def counted_areas(times_s: Array, counts: Mapping[str, Array], label: str) -> go.Figure:
    """Return rates (N,) of named things over time, stacked."""
    figure = go.Figure(layout=_layout(380))
    for k, (name, values) in enumerate(counts.items()):
        figure.add_scatter(
            x=times_s, y=values, name=name, mode="lines", stackgroup="all",
            line={"color": COLOURS[k % len(COLOURS)], "width": 0.5},
        )  # fmt: skip
    figure.update_layout(xaxis=_axis("time [s]"), yaxis=_axis(label))
    return figure


def curves(
    lines: Sequence[Line], label_x: str, label_y: str, horizontal: Axis = "linear", vertical: Axis = "linear"
) -> go.Figure:
    """Return few values of y over x, each of them marked."""
    figure = go.Figure(layout=_layout(380))
    colours = _colours(lines)
    for line in lines:
        trace = _trace(line, (line.x, line.y), colours[line.name], True)
        figure.add_trace(trace.update(mode="lines+markers"))
    figure.update_layout(xaxis=_axis(label_x, horizontal), yaxis=_axis(label_y, vertical))
    return figure


def histogram(counts: Mapping[str, tuple[Array, Array]], label: str) -> go.Figure:
    """Return distributions over a logarithmic axis, by name -> (edges (N + 1,), counts (N,)), as fractions."""
    figure = go.Figure(layout=_layout(340))
    for k, (name, (edges, count)) in enumerate(counts.items()):
        percent = 100.0 * count / max(count.sum(), 1.0)
        x = np.repeat(edges, 2)
        y = np.concatenate([[0.0], np.repeat(percent, 2), [0.0]])
        figure.add_scatter(x=x, y=y, name=name, fill="tozeroy", line={"color": COLOURS[k % len(COLOURS)], "width": 1})
    figure.update_layout(xaxis=_axis(label, "log"), yaxis=_axis("fraction [%]"))
    return figure


def quantiles(values: Mapping[str, Mapping[str, float]], label: str) -> go.Figure:
    """Return named quantiles (median, p99, ...) side by side, one line per name, over a logarithmic axis."""
    figure = go.Figure(layout=_layout(340))
    for k, (name, of) in enumerate(values.items()):
        colour = COLOURS[k % len(COLOURS)]
        figure.add_scatter(
            x=list(of.values()), y=list(of), name=name, mode="lines+markers", line={"color": colour, "width": 1.5}
        )
    figure.update_layout(xaxis=_axis(label, "log"), yaxis=_axis("") | {"autorange": "reversed"})
    return figure


def picture_map(
    image: NDArray[np.uint8],
    corner: tuple[float, float],
    pixel_m: float,
    scale: Mapping[str, Any] | None = None,
    height_px: int = 560,
) -> go.Figure:
    """Return an image from above on a metric grid.

    Args:
        image: (H, W, 3 or 4) pixels, the northern row first.
        corner: east and north [m] of the south-western corner.
        pixel_m: side of a pixel.
        scale: plotly's `marker` of a colour scale that stands beside it: cmin, cmax, colorscale, colorbar.
        height_px: of the figure.
    """
    height_m, width_m = image.shape[0] * pixel_m, image.shape[1] * pixel_m
    east, north = corner
    figure = go.Figure(layout=_layout(height_px))
    source = "data:image/png;base64," + b64encode(encode_png(image)).decode()
    figure.add_layout_image(
        source=source, xref="x", yref="y", x=east, y=north + height_m, sizex=width_m, sizey=height_m,
        sizing="stretch", layer="below",
    )  # fmt: skip
    corners = {"x": [east, east + width_m], "y": [north, north + height_m]}
    marker = {"opacity": 0.0} | ({} if scale is None else {"color": [0.0, 0.0], "showscale": True} | dict(scale))
    figure.add_scatter(**corners, mode="markers", marker=marker, hoverinfo="skip", showlegend=False, name="extent")
    _square(figure)
    return figure


def decimated(x: Array, y: Array, limit: int = MAX_POINTS_PER_LINE) -> tuple[Array, Array]:
    """Thin a line to about `limit` points: each stretch keeps its least and its greatest value.

    The line is broken, by a value that is NaN, where x makes a step of more than `GAP_STEPS` times the usual one.
    """
    steps = np.diff(x)
    gaps = np.flatnonzero(steps > GAP_STEPS * np.median(steps)) + 1 if len(steps) else np.zeros(0, dtype=np.intp)
    if len(gaps) > limit // 4:
        gaps = gaps[:0]  # what comes at no steady rate has no gaps
    if len(x) > limit:
        edges = np.linspace(0, len(x), limit // 2 + 1).astype(np.intp)
        stretches = pairwise(edges.tolist())
        kept = {i for a, b in stretches if a < b for i in _extremes(y, a, b)} | {0, len(x) - 1}
        index = np.array(sorted(kept | {int(gap) for gap in gaps} | {int(gap) - 1 for gap in gaps}), dtype=np.intp)
        gaps = np.searchsorted(index, gaps)
        x, y = x[index], y[index]
    return np.insert(x, gaps, x[gaps] if len(gaps) else 0.0), np.insert(y, gaps, np.nan)


def _stride(count: int) -> slice:
    """Return every n-th of so many points: strokes so short hide nothing."""
    return slice(None, None, -(-count // (2 * MAX_POINTS_PER_LINE)) or 1)


def _one_per_pixel(points: Line, size_m: float) -> NDArray[np.intp]:
    """Return which points of a map are kept: the first in each pixel, and not too many of those."""
    pixels = np.column_stack([points.x, points.y]) // (size_m / PIXELS)
    _, first = np.unique(pixels, axis=0, return_index=True)
    kept: NDArray[np.intp] = np.sort(first)[_stride(len(first))]
    return kept


def _thin_track(times_s: Array, east: Array, north: Array) -> dict[str, list[float]]:
    kept = _stride(2 * len(times_s))
    named = {"t": times_s, "x": east, "y": north}
    return {name: np.round(values[kept], 3).tolist() for name, values in named.items()}


def _extremes(y: Array, start: int, end: int) -> tuple[int, int]:
    piece = y[start:end]
    if np.isnan(piece).all():
        return start, start
    return start + int(np.nanargmin(piece)), start + int(np.nanargmax(piece))


def _trace(line: Line, points: tuple[Array, Array], colour: str, has_legend: bool, axis: str = "y") -> go.Scatter:
    x, y = points
    looks: dict[str, Any] = {"mode": "lines", "line": {"color": colour, "width": line.width, "dash": line.dash}}
    if line.points:
        looks = {"mode": "markers", "marker": {"color": colour, "size": 4}}
    return go.Scatter(
        x=x.astype(np.float32), y=y.astype(np.float32), name=line.name, legendgroup=line.name, showlegend=has_legend,
        yaxis=axis, zorder=int(line.is_on_top), **looks,
    )  # fmt: skip


def _colours(lines: Sequence[Line]) -> dict[str, str]:
    colours = {line.name: line.colour for line in lines if line.colour}
    for line in lines:
        if line.name not in colours:
            colours[line.name] = next((c for c in COLOURS if c not in colours.values()), GREY)
    return colours


def _add_bands(figure: go.Figure, bands: Sequence[Band]) -> None:
    for band in bands:
        figure.add_shape(
            type="rect", xref="x", yref="paper", x0=band.start_s, x1=band.end_s, y0=0.0, y1=1.0, layer="below",
            fillcolor=band.colour, opacity=0.13, line={"width": 0},
        )  # fmt: skip
    for name, colour in {band.name: band.colour for band in bands if band.name}.items():
        figure.add_scatter(
            x=[None], y=[None], mode="markers", name=name,
            marker={"size": 12, "symbol": "square", "color": colour, "opacity": 0.3},
        )  # fmt: skip


def _pattern(times: int) -> dict[str, Any]:
    """Return the hatching that tells bars of one colour apart, of which so many have been drawn."""
    return {"shape": HATCHES[times % len(HATCHES)], "fgcolor": "#ffffff", "size": 5, "solidity": 0.4}


def _square(figure: go.Figure) -> None:
    figure.update_layout(
        xaxis=_axis("east [m]") | {"constrain": "domain"},
        yaxis=_axis("north [m]") | {"scaleanchor": "x", "scaleratio": 1.0},
    )


def _axis(label: str, kind: Axis = "linear") -> dict[str, Any]:
    # without a format the ticks between powers of ten are digits, whatever the power
    return ({"type": "log", "tickformat": "~g"} if kind == "log" else {}) | {
        "title": {"text": label, "standoff": 8},
        "gridcolor": RULE,
        "zerolinecolor": GREY,
        "linecolor": GREY,
        "automargin": True,
        "exponentformat": "power",
    }


def _meta(*, over_time: bool = False, track: dict[str, list[float]] | None = None) -> dict[str, Any]:
    """Return what the script of the page has to know: whether x is the time of the run, or where it was when."""
    return {"meta": {"over_time": over_time} | ({} if track is None else {"track": track})}


def _layout(height_px: int) -> dict[str, Any]:
    return {
        "height": height_px,
        "margin": {"l": 8, "r": 8, "t": 8, "b": 8},
        "template": "none",
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "font": {"family": "system-ui, DejaVu Sans, sans-serif", "size": 12, "color": INK},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0.0},
        "hovermode": "closest",
    }
