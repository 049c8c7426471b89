"""The page about two replays holds what differs, and says so where nothing can be compared."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("plotly")

from holdfast.report.comparison import (
    Comparison,
    accuracy_rows,
    comparison_page,
    config_changes,
    count_changes,
    event_changes,
    summary_line,
)
from holdfast.report.page import Text, numbers_of, render, write_page
from holdfast.report.run_record import Errors, RunRecord

sys.path.insert(0, str(Path(__file__).parent))
from chromium import DESKTOP, PHONE, check_page, needs_chromium

TIMES_S = np.arange(0.0, 60.0, 0.1)
TIMING = {"median": 20.0, "p99": 60.0, "max": 900.0}


def held_out(rms_m: float) -> dict[str, Any]:
    errors = {"rms": rms_m, "p95": 2 * rms_m, "max": 3 * rms_m, "count": 50}
    return {"causal": {"all": {"horizontal_m": errors, "vertical_m": errors, "nees_per_dof": 1.0}}, "smoothed": None}


def run(config: dict[str, Any], rms_m: float, lost: int, used: int) -> RunRecord:
    summary = {
        "recording": "drive.mcap",
        "finished": True,
        "datum": None,
        "config": config,
        "counts": {"gnss": {"used": used, "late": 1}},
        "timing": {"recorded_s": 60.0, "wall_s": 2.0, "real_time_factor": 30.0, "imu_us": TIMING, "update_ms": None},
        "held_out": held_out(rms_m),
        "versions": {"holdfast": "1", "gtsam": "4.3"},
        "warnings": [],
    }
    track = np.column_stack([TIMES_S, np.sin(TIMES_S), 0.0 * TIMES_S])
    events = [
        {"stamp_ns": 0, "kind": "health", "sensor": "", "reason": "nominal"},
        *(
            {"stamp_ns": 10**9 * (10 + k), "kind": "gnss_lost", "sensor": "gnss", "reason": "silent"}
            for k in range(lost)
        ),
    ]
    empty = np.zeros(0)
    return RunRecord(
        "drive.mcap", "holdfast replay drive.mcap; holdfast report o", 0, summary, events, TIMES_S, track, track,
        np.zeros((len(TIMES_S), 4)), np.zeros((len(TIMES_S), 3)), empty, {}, empty, empty, np.zeros((0, 6)),
    )  # fmt: skip


def comparison(**change: Any) -> Comparison:
    one = run({"graph": {"lag_s": 3.0, "dual": True}, "extrinsics": [{"child": "gnss", "x": 1.0}]}, 0.02, 1, 100)
    other = run({"graph": {"lag_s": 1.5, "dual": True}, "extrinsics": [{"child": "gnss", "x": 2.0}]}, 0.03, 3, 90)
    apart = {"horizontal [m]": 0.1 + 0.0 * TIMES_S, "yaw [deg]": np.sin(TIMES_S)}
    made = Comparison(("a", "b"), (one, other), TIMES_S, apart, "holdfast compare a b")
    return replace(made, **change)


def triples(changes: Any) -> list[tuple[Any, ...]]:
    return [(change.what, change.first, change.second) for change in changes]


def test_only_the_keys_counts_and_events_that_differ_are_listed() -> None:
    of = comparison()
    assert triples(config_changes(of)) == [("graph.lag_s", 3.0, 1.5), ("extrinsics[gnss].x", 1.0, 2.0)]
    assert triples(count_changes(of)) == [("gnss: used", 100, 90)]
    assert triples(event_changes(of)) == [("gnss lost gnss", 1, 3)]


def test_a_key_that_only_one_has_is_listed() -> None:
    one, other = comparison().runs
    grown = replace(other, summary={**one.summary, "config": {**one.summary["config"], "more": {"key": None}}})
    assert triples(config_changes(comparison(runs=(one, grown)))) == [("more.key", "(not there)", "none")]


def test_settings_are_shown_with_all_digits() -> None:
    """Of two latitudes a metre apart both were shown as 47.5."""
    one, other = comparison().runs
    one, other = (
        replace(run, summary={**run.summary, "config": {"datum": {"latitude_deg": degrees}}})
        for run, degrees in ((one, 47.4801402), (other, 47.4801502))
    )
    table = numbers_of(comparison_page(comparison(runs=(one, other))))["tables"]["config"]
    assert table["rows"] == [["datum.latitude_deg", "47.4801402", "47.4801502"]]


def test_the_lead_says_how_far_the_trajectories_are_apart() -> None:
    expected = "2 keys of the configuration differ; the trajectories are 0.1 m apart horizontally (RMS), 0.1 at most."
    assert summary_line(comparison()) == expected


def test_errors_are_compared_and_the_smaller_one_stands_out() -> None:
    page = comparison_page(comparison())
    table = numbers_of(page)["tables"]["accuracy"]
    assert table["rows"][0] == ["held out, causal, all: horizontal RMS [m]", 0.02, 0.03, 0.01, 50.0]
    accuracy = next(section for section in page.sections if section.title == "Accuracy").blocks[0]
    assert accuracy.marks[0, 1] == "best"  # type: ignore[union-attr]


def test_errors_against_a_reference_are_compared_too() -> None:
    one, other = comparison().runs
    runs = tuple(
        replace(of, errors=Errors("truth", TIMES_S, {"horizontal [m]": scale + 0.0 * TIMES_S}), reference=of.world)
        for of, scale in ((one, 0.1), (other, 0.2))
    )
    of = comparison(runs=runs)
    assert triples(accuracy_rows(of))[-2:] == [
        ("against the reference, horizontal RMS [m]", pytest.approx(0.1), pytest.approx(0.2)),
        ("against the reference, horizontal max [m]", pytest.approx(0.1), pytest.approx(0.2)),
    ]
    assert "errors-over-time" in numbers_of(comparison_page(of))["figures"]


def test_runs_that_are_the_same_say_so() -> None:
    one, _ = comparison().runs
    page = comparison_page(comparison(runs=(one, one)))
    texts = [block.text for section in page.sections for block in section.blocks if isinstance(block, Text)]
    assert texts == ["Both were made with the same configuration.", "No difference.", "No difference."]


def test_names_and_values_of_the_user_are_text_and_no_markup() -> None:
    html = render(comparison_page(comparison(names=("<script>alert(1)</script>", "b"))))
    assert "<script>alert(1)" not in html


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("size", [(1400, 900, False), DESKTOP, PHONE])
def test_the_page_is_drawn_whole(tmp_path: Path, size: tuple[int, int, bool]) -> None:
    write_page(comparison_page(comparison()), tmp_path / "compare.html")
    check_page(tmp_path / "compare.html", tmp_path, size, 3)
