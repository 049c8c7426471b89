"""Figures are thin, and thinning hides nothing."""

import numpy as np
import pytest

from holdfast.report.figures import (
    MAX_POINTS_PER_LINE,
    Line,
    Panel,
    Span,
    counts_over_time,
    decimated,
    over_time,
    picture_map,
    time_line,
    track_map,
)
from holdfast.report.png import encode_png


def test_a_spike_of_one_sample_survives_thinning():
    time_s = np.arange(100_000) * 0.01
    values = np.zeros(100_000)
    values[54_321], values[12_345] = 5.0, -7.0
    x, y = decimated(time_s, values)
    assert len(x) <= MAX_POINTS_PER_LINE + 4
    assert (np.nanmax(y), np.nanmin(y)) == (5.0, -7.0)
    assert x[np.nanargmax(y)] == pytest.approx(543.21)
    assert (x[0], x[-1]) == (time_s[0], time_s[-1])


@pytest.mark.parametrize("count", [100, 100_000])
def test_a_line_is_broken_where_nothing_was_measured(count: int):
    time_s = np.arange(count) * 0.01
    gone = (time_s > 0.4 * time_s[-1]) & (time_s < 0.6 * time_s[-1])
    x, y = decimated(time_s[~gone], np.ones((~gone).sum()))
    assert np.isnan(y).sum() == 1
    assert x[np.isnan(y)][0] == pytest.approx(0.6 * time_s[-1], rel=0.02)


def test_a_line_with_an_interval_of_nan_keeps_its_other_values():
    values = np.concatenate([np.arange(5000.0), np.full(5000, np.nan), np.arange(5000.0)])
    _, y = decimated(np.arange(15_000.0), values)
    assert np.nanmax(y) == 4999.0
    assert np.isnan(y).sum() >= 1


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_line_of_few_points_stays_as_it_is(count: int):
    x, y = decimated(np.arange(float(count)), np.arange(float(count)))
    assert x.tolist() == y.tolist() == list(range(count))


def test_a_line_keeps_its_colour_and_name_over_all_panels():
    time_s = np.arange(10.0)
    lines = [Line("a", time_s, time_s), Line("b", time_s, time_s)]
    figure = over_time([Panel("one", lines), Panel("two", lines[::-1])])
    colours = {(trace.name, trace.line.color) for trace in figure.data}
    assert len(colours) == 2
    assert [trace.name for trace in figure.data if trace.showlegend] == ["a", "b"]


def test_a_time_line_of_a_thousand_spans_has_few_traces_and_every_span():
    spans = [Span("health", k, k + 0.5, "#009e73" if k % 2 else "#d55e00", f"span {k}") for k in range(1000)]
    figure = time_line(["health"], spans, {"good": "#009e73"}, 1000.0)
    assert len(figure.data) == 3
    begun = sorted(start for trace in figure.data if trace.base is not None for start in trace.base)
    assert begun == list(range(1000))


def test_a_track_is_drawn_to_scale():
    figure = track_map([Line("a", np.arange(9.0), np.arange(9.0))])
    assert (figure.layout.yaxis.scaleanchor, figure.layout.yaxis.scaleratio) == ("x", 1.0)


def test_a_picture_lies_where_its_pixels_are():
    figure = picture_map(np.zeros((20, 40, 3), dtype=np.uint8), (-5.0, 7.0), 0.5)
    image = figure.layout.images[0]
    assert (image.x, image.y) == (-5.0, 17.0)  # its upper left corner
    assert (image.sizex, image.sizey) == (20.0, 10.0)


@pytest.mark.parametrize("channels", [3, 4])
def test_a_png_holds_its_pixels(channels: int, tmp_path):
    image = pytest.importorskip("matplotlib.image")
    pixels = np.random.default_rng(1).integers(0, 256, (17, 23, channels), dtype=np.uint8)
    file = tmp_path / "image.png"
    file.write_bytes(encode_png(pixels))
    np.testing.assert_array_equal(np.rint(image.imread(file) * 255.0).astype(np.uint8), pixels)


def test_what_is_no_image_is_refused():
    with pytest.raises(ValueError, match=r"\(4, 4\)"):
        encode_png(np.zeros((4, 4), dtype=np.uint8))


def test_a_map_shows_the_whole_of_every_track_and_the_names_of_its_marks_stay_inside():
    tracks = [Line("a", np.array([0.0, 10.0]), np.array([0.0, 1.0])), Line("b", np.array([-4.0, np.nan]), np.zeros(2))]
    figure = track_map(tracks, {"start": (-4.0, 0.0), "end": (10.0, 1.0)})
    (west, east), (south, north) = figure.layout.xaxis.range, figure.layout.yaxis.range
    assert west < -4.0
    assert east > 10.0
    assert south < 0.0
    assert north > 1.0
    sides = {trace.name: trace.textposition for trace in figure.data if trace.mode == "markers+text"}
    assert sides == {"start": "top right", "end": "bottom left"}


def test_a_line_on_top_is_hidden_by_no_other():
    lines = [Line("ours", np.arange(9.0), np.arange(9.0), is_on_top=True), Line("theirs", np.arange(9.0), np.ones(9))]
    ours, theirs = over_time([Panel("a [m]", lines)]).data
    assert ours.zorder > (theirs.zorder or 0)


def test_ticks_of_a_logarithmic_axis_are_whole_numbers_not_digits_without_their_power_of_ten():
    time_s = np.arange(1.0, 10.0)
    figure = over_time(
        [Panel("sigma [m]", [Line("a", time_s, 0.01 / time_s)], "log"), Panel("x", [Line("a", time_s, time_s)])]
    )
    assert (figure.layout.yaxis.type, figure.layout.yaxis.tickformat) == ("log", "~g")
    assert figure.layout.yaxis2.type is None


def test_more_counts_than_colours_are_told_apart_by_hatching():
    figure = counts_over_time({f"sensor {k}: late": np.arange(10.0) for k in range(20)}, 10.0, "measurements")
    looks = {(bar.marker.color, bar.marker.pattern.shape) for bar in figure.data}
    assert len(looks) == 20


def test_the_names_of_start_and_end_do_not_cover_each_other_on_a_closed_track():
    track = Line("a", np.array([0.0, 10.0, 0.1]), np.array([0.0, 5.0, 0.1]))
    figure = track_map([track], {"start": (0.0, 0.0), "end": (0.1, 0.1)})
    assert len({trace.textposition for trace in figure.data if trace.text}) == 2
