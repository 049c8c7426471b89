"""`make scenarios` prints the tables of docs/results and puts them between its markers."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from holdfast.sim.configuration import configuration
from holdfast.sim.scenario import load_scenario
from holdfast.trial.run import trials_of

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

import scenarios  # noqa: E402

# the lies of `liar`, which has 300 s for them, with shorter pauses between; the jumps, the walk and the swap as long
SOONER_S = ((25, 40), (48, 58), (65, 105), (115, 135), (135, 139), (150, 160), (170, 185))


@pytest.fixture(scope="module")
def runs():
    (found,) = scenarios.run({"quick": 1}, ["holdfast", "paper"], jobs=1)
    return found


def test_each_preset_is_run_on_the_same_simulation(runs):
    assert [(one.scenario, one.preset, len(one.trials)) for one in runs] == [
        ("quick", "holdfast", 1),
        ("quick", "paper", 1),
    ]
    ours, paper = (one.trials[0].verdict for one in runs)
    assert ours.outages[0].span == paper.outages[0].span
    assert ours.scores["fix_horizontal_rms_m"] == pytest.approx(paper.scores["fix_horizontal_rms_m"], rel=0.01)
    assert ours.scores["step_m"] != paper.scores["step_m"]


def test_quick_is_estimated_better_than_its_fixes(runs):
    scores = runs[0].trials[0].verdict.scores
    assert scores["horizontal_rms_m"] < scores["fix_horizontal_rms_m"] < 0.02
    assert scores["vertical_rms_m"] < scores["fix_vertical_rms_m"] < 0.03
    assert scores["step_m"] < 0.002
    assert scores["step_deg"] < 0.02
    assert scores["misled_s"] == 0.0


def test_a_liar_is_not_believed_however_long_it_lies(tmp_path):
    """Fixes that jump, walk away, and stay beside for longer than an estimate without them would be doubted."""
    liar = load_scenario("liar")
    faults = [
        fault.model_copy(update={"start_s": start_s, "end_s": end_s})
        for fault, (start_s, end_s) in zip(liar.faults, SOONER_S, strict=True)
    ]
    sooner = liar.model_copy(update={"duration_s": 195.0, "faults": tuple(faults)})
    scores = trials_of(sooner, 0, tmp_path, [configuration(sooner)])[0].verdict.scores
    by_key = {measure.key: measure for measure in scenarios.MEASURES}
    for key in ("misled_s", "horizontal_rms_m", "step_m"):
        assert by_key[key].is_reached(scores[key], "liar"), (key, scores[key])


def test_a_table_has_a_row_per_measure_and_columns_per_preset(runs):
    lines = list(scenarios.scenario_table(runs))
    rows = [line for line in lines if line.startswith("| ")]
    assert len(rows) == 1 + len(scenarios.MEASURES)
    assert {line.count("|") for line in rows} == {8}
    assert "holdfast: mean | worst | paper: mean | worst" in rows[0]
    overview = [line for line in scenarios.overview_table(runs[:1] * 3) if line.startswith("| ")]
    assert len(overview) == 1 + len(scenarios.MEASURES)


def test_what_misses_its_target_is_bold(runs):
    (measure,) = (measure for measure in scenarios.MEASURES if measure.key == "horizontal_rms_m")
    trial = runs[0].trials[0]
    for score, cell in ((0.009, "9.0 | 9.0"), (0.012, "**12.0** | **12.0**")):
        verdict = replace(trial.verdict, scores=trial.verdict.scores | {measure.key: score})
        one = scenarios.Runs("quick", "holdfast", (replace(trial, verdict=verdict),))
        assert one.cell(measure, " | ") == cell


def test_every_outage_is_told_in_the_details(runs):
    text = "\n".join(scenarios.details(runs))
    assert text.count("outage   12.0 to   16.0 s") == 2
    assert "gnss_lost" in text


def test_the_page_keeps_everything_outside_of_the_markers():
    page = f"before\n{scenarios.BEGIN}\nold\n{scenarios.END}\nafter\n"
    written = scenarios.with_tables(page, "new")
    assert written == f"before\n{scenarios.BEGIN}\n\nnew\n{scenarios.END}\nafter\n"
    assert scenarios.with_tables(written, "new") == written
    with pytest.raises(ValueError, match="must hold the lines"):
        scenarios.with_tables("no markers", "new")


def test_the_committed_page_has_the_markers_and_every_measure():
    page = (ROOT / "docs" / "results" / "simulated-sites.md").read_text(encoding="utf-8")
    inside = page.partition(scenarios.BEGIN)[2].partition(scenarios.END)[0]
    assert [measure.label for measure in scenarios.MEASURES if f"| {measure.label} |" not in inside] == []
