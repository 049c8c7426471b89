import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.errors import ConfigError
from holdfast.evaluation.accuracy import Interval, Metrics, evaluate
from holdfast.evaluation.association import Association
from holdfast.evaluation.plot import broken_at_gaps, check_plot, plot_accuracy

BEGINNINGS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.mark.parametrize("suffix", BEGINNINGS)
def test_a_figure_is_drawn_in_every_format_with_and_without_orientation(wander, disturbed, tmp_path, suffix):
    reference = wander(count=100)
    for position_only in (False, True):
        metrics = Metrics(
            intervals=(Interval("tunnel", 2.0, 4.0),), association=Association(position_only=position_only)
        )
        path = tmp_path / f"figure{position_only}{suffix}"
        plot_accuracy(evaluate(disturbed(reference), reference, metrics=metrics), path, "title")
        assert path.read_bytes().startswith(BEGINNINGS[suffix])
    assert (tmp_path / f"figureTrue{suffix}").read_bytes() != (tmp_path / f"figureFalse{suffix}").read_bytes()


def test_more_intervals_than_colours_are_drawn(wander, tmp_path):
    intervals = tuple(Interval(f"i{k}", float(k), k + 0.5) for k in range(9))
    plot_accuracy(evaluate(wander(), wander(), metrics=Metrics(intervals=intervals)), tmp_path / "f.svg", "title")
    assert all(f"i{k}, ends" in (tmp_path / "f.svg").read_text() for k in range(9))


def test_the_same_verdict_gives_the_same_svg(wander, tmp_path):
    verdict = evaluate(wander(count=50), wander(count=50))
    for name in ("a.svg", "b.svg"):
        plot_accuracy(verdict, tmp_path / name, "title")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_no_line_is_drawn_over_a_gap():
    time_s, values = broken_at_gaps(np.array([0.0, 0.1, 0.2, 9.0, 9.1]), np.arange(5.0))
    assert np.isnan(time_s[3]) and np.isnan(values[3])
    assert len(time_s) == 6


def test_a_missing_matplotlib_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ConfigError, match=r"needs matplotlib: pip install -e '\.\[plot\]'"):
        check_plot(Path("figure.png"))


def test_an_unknown_suffix_is_refused_with_those_that_are_offered():
    with pytest.raises(ConfigError, match=r"\.png, \.svg, \.pdf"):
        check_plot(Path("figure.gif"))


def test_a_figure_in_no_folder_is_refused_in_one_line(wander, tmp_path):
    verdict = evaluate(wander(count=50), replace(wander(count=50)))
    with pytest.raises(ConfigError, match=r"nowhere/figure\.png: cannot be written"):
        plot_accuracy(verdict, tmp_path / "nowhere" / "figure.png", "title")
