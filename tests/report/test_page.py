"""The page of a report stands alone: nothing is loaded, nothing is lost, what is shown is also written as numbers."""

import json
import re
import resource
from pathlib import Path

import numpy as np
import pytest
from chromium import DESKTOP, PHONE, check_page, needs_chromium
from chromium import Page as BrowserPage

from holdfast.errors import ConfigError
from holdfast.report.figures import (
    Band,
    Line,
    Panel,
    Span,
    counts_over_time,
    histogram,
    over_time,
    picture_map,
    quantiles,
    time_line,
    track_map,
)
from holdfast.report.page import Figure, Page, Provenance, Section, Table, Text, digest, render, shown, write_page

MADE = Provenance("holdfast replay a -c b -o c", {"holdfast": "1.2.3"}, "0123456789ab", "7")
MANY = 60_000


def figures() -> list[Figure]:
    """One of every kind, of as many points as ten minutes at 100 Hz have."""
    time_s = np.arange(MANY) * 0.01
    wave = np.sin(time_s / 20.0)
    spans = [Span("health", 0.0, 300.0, "#009e73", "fine"), Span("gnss", 100.0, 200.0, "#d55e00", "lost")]
    pixels = np.zeros((300, 400, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    scale = {"cmin": 0.0, "cmax": 0.1, "colorscale": "Viridis", "colorbar": {"title": {"text": "[m]"}}}
    counts = (np.logspace(0.0, 3.0, 31), np.arange(30.0))
    plots = {
        "lines": over_time([Panel("a [m]", [Line("a", time_s, wave)]), Panel("b [m]", [Line("b", time_s, -wave)])],
                           [Band(10.0, 20.0, name="without GNSS")]),
        "track": track_map([Line("track", 50.0 * wave, 50.0 * np.cos(time_s / 20.0))], {"start": (0.0, 50.0)}),
        "spans": time_line(["health", "gnss"], spans, {"fine": "#009e73"}, 600.0),
        "counts": counts_over_time({"late": time_s[::500]}, 600.0, "measurements"),
        "histogram": histogram({"IMU": counts}, "time [us]"),
        "quantiles": quantiles({"IMU": {"median": 10.0, "p99": 40.0}}, "time [us]"),
        "map": picture_map(pixels, (-50.0, -30.0), 0.25, scale),
    }  # fmt: skip
    return [Figure(key, f"Title of {key}", plot, "A caption.") for key, plot in plots.items()]


@pytest.fixture(scope="module")
def page() -> Page:
    numbers = Table("errors", "Errors", ("error", "rms [m]"), [["horizontal", 0.0123], ["vertical", None]],
                    marks={(0, 1): "best"})  # fmt: skip
    first = Section("What & where <here>", [Text("Text with <angle> & more."), numbers])
    return Page("Report </script><b>", "Lead.", MADE, [first, Section("Figures", figures())])


@pytest.fixture(scope="module")
def file(page: Page, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_page(page, path)
    return path


def test_nothing_in_the_page_is_loaded_from_elsewhere(file: Path):
    html = file.read_text(encoding="utf-8")
    markup = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    assert "://" not in markup
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=", html)
    assert "default-src 'none'" in html


def test_the_script_of_plotly_is_there_once_and_the_page_is_light(file: Path):
    html = file.read_text(encoding="utf-8")
    assert html.count("plotly.js v") == 1
    assert file.stat().st_size < 15_000_000


def test_figures_have_a_few_thousand_points_at_most(page: Page):
    for figure in figures():
        for trace in figure.plot.data:
            assert len(trace.x) <= 5000, figure.key


def test_text_cannot_become_markup(file: Path):
    html = file.read_text(encoding="utf-8")
    assert "Text with &lt;angle&gt; &amp; more." in html
    assert "<title>Report &lt;/script&gt;&lt;b&gt;</title>" in html


def test_provenance_stands_once_and_beside_what_was_made_otherwise(file: Path):
    html = file.read_text(encoding="utf-8")
    assert html.count("holdfast replay a -c b -o c · seed 7 · config 0123456789ab · holdfast 1.2.3") == 1
    other = Table("other", "Other", ("a",), [[1]], provenance=Provenance("holdfast bench", {"holdfast": "1.2.3"}))
    assert render(Page("", "", MADE, [Section("", [other])])).count("holdfast bench · holdfast 1.2.3") == 1


def test_the_numbers_stand_beside_the_page_as_json(file: Path):
    numbers = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
    assert numbers["tables"]["errors"]["rows"] == [["horizontal", 0.0123], ["vertical", None]]
    assert numbers["provenance"]["seed"] == "7"
    assert set(numbers["figures"]) == {figure.key for figure in figures()}
    lines = numbers["figures"]["lines"]["traces"][0]
    assert max(lines["y"]) == pytest.approx(1.0, abs=1e-6)
    assert len(lines["x"]) == len(lines["y"])


def test_a_key_that_is_used_twice_is_refused():
    table = Table("same", "", ("a",), [[1]])
    with pytest.raises(ConfigError, match="same"):
        render(Page("", "", MADE, [Section("", [table, table])]))


def test_a_page_that_cannot_be_written_is_named_in_the_error(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"none.*report\.html.*cannot be written"):
        write_page(Page("", "", MADE, []), tmp_path / "none" / "report.html")


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (float("nan"), "–"), (float("inf"), "–"), (12, "12"), ("a", "a"), (0.0, "0"), (1234.5, "1234"),
     (12.345, "12.3"), (0.012345, "0.0123"), (99.96, "100"), (-0.5, "-0.500"), (1.2e-7, "1.20e-07")],
)  # fmt: skip
def test_numbers_are_shown_with_three_digits(value, text: str):
    assert shown(value) == text


def test_the_digest_knows_equal_configurations_in_any_order():
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    assert digest({"a": 1, "b": 2}) != digest({"a": 1, "b": 3})


@needs_chromium
@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_a_browser_draws_every_figure_without_errors_or_requests(file: Path, tmp_path: Path, size):
    check_page(file, tmp_path, size, len(figures()))


@needs_chromium
def test_a_wide_table_scrolls_on_a_phone_and_keeps_its_first_column(tmp_path: Path):
    columns = ["quantity", *(f"column {k} [m]" for k in range(12))]
    table = Table("wide", "Wide", columns, [["horizontal", *(1.25 * k for k in range(12))]] * 3)
    file = tmp_path / "report.html"
    write_page(Page("", "", MADE, [Section("", [table])]), file)
    with BrowserPage(file, tmp_path, PHONE) as opened:
        box = "document.querySelector('.scroll')"
        assert opened.value_of(f"{box}.scrollWidth - {box}.clientWidth") > 100
        assert opened.value_of("document.documentElement.scrollWidth") <= PHONE[0]
        opened.value_of(f"{box}.scrollLeft = 100")
        left = "getBoundingClientRect().left"
        for cell in ("th", "td"):
            first, second = (f"document.querySelectorAll('{cell}')[{k}].{left}" for k in (0, 1))
            assert opened.value_of(f"{first} - {box}.{left}") == 0
            assert opened.value_of(f"{second} - {box}.{left}") < 100


@needs_chromium
def test_long_names_beside_a_plot_leave_it_its_room_on_a_phone(tmp_path: Path):
    file = tmp_path / "report.html"
    named = {f"antenna {k}, along x of the IMU (translation_m)": 0.01 * (k + 1) for k in range(9)}
    write_page(Page("", "", MADE, [Section("", [Figure("named", "", quantiles({"ratio": named}, "[1]"))])]), file)
    with BrowserPage(file, tmp_path, PHONE) as opened:
        opened.wait_until_drawn(1)
        assert opened.value_of("document.querySelector('.plot')._fullLayout._size.w") > PHONE[0] / 2


@needs_chromium
def test_what_a_page_asks_for_outside_and_its_errors_would_be_seen(tmp_path: Path):
    file = tmp_path / "bad.html"
    file.write_text("<img src='http://127.0.0.1:9/x.png'><script>nothing.there</script>", encoding="utf-8")
    with BrowserPage(file, tmp_path) as opened:
        assert list(opened.requests.values()) == ["http://127.0.0.1:9/x.png"]
        assert any("nothing is not defined" in error for error in opened.errors)


@needs_chromium
def test_the_policy_of_the_page_lets_nothing_out_that_a_figure_might_ask_for(tmp_path: Path):
    file = tmp_path / "report.html"
    leaking = track_map([Line("a", np.arange(9.0), np.arange(9.0))])
    leaking.add_layout_image(source="http://127.0.0.1:9/tile.png", x=0, y=1, sizex=1, sizey=1, xref="x", yref="y")
    write_page(Page("", "", MADE, [Section("", [Figure("leaking", "", leaking)])]), file)
    with BrowserPage(file, tmp_path) as opened:
        opened.wait_until_drawn(1)
        assert opened.requests == {}
        assert opened.forbidden == ["http://127.0.0.1:9/tile.png"]
        assert "127.0.0.1" in opened.value_of("document.documentElement.dataset.errors")


@needs_chromium
def test_printed_figures_fit_the_paper(file: Path, tmp_path: Path):
    with BrowserPage(file, tmp_path, DESKTOP) as opened:
        opened.wait_until_drawn(len(figures()))
        assert opened.printed().startswith(b"%PDF")
        opened.value_of("window.dispatchEvent(new Event('beforeprint'))")
        widths = "Array.from(document.querySelectorAll('.main-svg')).map((svg) => svg.getBoundingClientRect().width)"
        a4_within_margins_px = (210 - 2 * 14) / 25.4 * 96
        assert max(opened.value_of(widths)) <= a4_within_margins_px
        opened.value_of("window.dispatchEvent(new Event('afterprint'))")
        assert max(opened.value_of(widths)) > a4_within_margins_px


def with_lead(lead: str) -> Page:
    return Page("Page", lead, MADE, [Section("Empty", [Text("nothing")])])


def test_a_name_that_is_no_utf8_is_shown_escaped(tmp_path: Path):
    """Files of an old camera or USB stick: a page about them ended in a traceback."""
    write_page(with_lead("gr\udcf6sse.mcap"), tmp_path / "page.html")
    assert r"gr\udcf6sse.mcap" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_full_disk_leaves_the_earlier_page_as_it_was(tmp_path: Path):
    """It was cut off where the disk ended."""
    write_page(with_lead("earlier"), tmp_path / "page.html")
    before = (tmp_path / "page.html").read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        with pytest.raises(ConfigError, match=r"page.*cannot be written \(File too large\)"):
            write_page(with_lead("later"), tmp_path / "page.html")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / "page.html").read_bytes() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["page.html", "page.json"]
