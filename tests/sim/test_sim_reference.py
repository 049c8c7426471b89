"""The page about simulation is the model, the shipped scenarios and the kinds of faults; its example runs."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from holdfast.config.reference import reference_tables, with_tables
from holdfast.sim.faults import FAULTS, affected_kinds
from holdfast.sim.reference import COMMAND
from holdfast.sim.scenario import Scenario, load_scenario, shipped
from holdfast.sim.simulation import simulate

PAGE = Path(__file__).parents[2] / "docs" / "simulation.md"
TEXT = PAGE.read_text(encoding="utf-8")


def rows(first_head: str) -> dict[str, list[str]]:
    """Return the rows of the table whose head begins with a word, by the code in their first cell."""
    table = re.search(rf"^\| {first_head} \|.*\n\|[-|]+\n((?:\|.*\n)+)", TEXT, re.MULTILINE)
    assert table is not None
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table[1].splitlines()]
    return {first.strip("`"): rest for first, *rest in cells}


def test_the_committed_reference_is_up_to_date():
    assert with_tables(TEXT, Scenario, COMMAND) == TEXT, f"docs/simulation.md is stale: run `{COMMAND}`"


def test_the_command_named_in_a_failure_writes_the_page_anew(tmp_path: Path):
    stale = tmp_path / "page.md"
    stale.write_text(re.sub(r"\| `duration_s`.*\n", "", TEXT), encoding="utf-8")
    python, *arguments = COMMAND.split()
    assert python == "python"
    subprocess.run([sys.executable, *arguments[:-1], str(stale)], check=True)
    assert stale.read_text(encoding="utf-8") == TEXT


def test_a_section_that_contains_itself_stands_once():
    assert reference_tables(Scenario).count("\n### `activities[]`, `activities[].of[]`\n") == 1
    assert reference_tables(Scenario).count("\n| `slew_to_deg` |") == 1


def test_a_section_in_many_places_stands_under_one_pattern():
    tables = reference_tables(Scenario)
    assert "\n### `sensors.<gnss>.rtk_fixed`, `sensors.<gnss>.rtk_float`, `sensors.<gnss>.single`\n" in tables
    assert "<pose>, <prism>, <scanner>, <twist>}.transport`\n" in tables
    assert tables.count("\n| `loss_ratio` |") == 1


def test_entries_of_a_list_that_are_several_words_stand_in_brackets():
    assert "| `drive_to_m` | list of (2 numbers) |" in reference_tables(Scenario)


def test_terms_of_a_docstring_are_a_list():
    assert "\n- degraded: the fix falls to float or single" in reference_tables(Scenario)


def test_every_shipped_scenario_has_a_row_with_its_machine_its_site_and_its_length():
    on_page = rows("Name")
    assert sorted(on_page) == shipped("scenarios")
    for name, (_, where, length, _) in on_page.items():
        scenario = load_scenario(name)
        assert where == f"`{scenario.machine}`, `{scenario.site}`", name
        assert length.startswith(f"{scenario.duration_s:g} s, "), name


def test_the_distance_on_the_page_is_driven():
    assert rows("Name")["quick"][2] == f"20 s, {simulate(load_scenario('quick'), 1).motion.distance_m:.0f} m"


def test_every_shipped_machine_has_a_row():
    assert sorted(rows("Machine")) == shipped("machines")


def test_every_kind_of_fault_has_a_row_with_its_sensors():
    assert {kind: tuple(row[0].split(", ")) for kind, row in rows("Kind").items()} == {
        fault: affected_kinds(fault) for fault in FAULTS
    }


@pytest.mark.parametrize("quality", ["fixed", "float", "single"])
def test_the_sigmas_on_the_page_are_those_of_the_model(quality: str):
    gnss = load_scenario("quick").sensors["gnss"]
    fix = getattr(gnss, {"fixed": "rtk_fixed", "float": "rtk_float"}.get(quality, quality))
    total, white, constants, _ = rows("Quality")[quality]
    both = np.hypot(
        [fix.white_horizontal_m, fix.white_vertical_m], [fix.slow_horizontal_m, fix.slow_vertical_m]
    ).tolist()
    assert metres(total) == pytest.approx(both, rel=0.025)
    assert metres(white) == [fix.white_horizontal_m, fix.white_vertical_m]
    assert constants == f"{fix.time_constant_s:g} s, {fix.distance_constant_m:g} m"


def metres(cell: str) -> list[float]:
    """Return the lengths of a cell such as `8 mm, 0.3 m` [m]."""
    return [float(number) / (1000 if unit == "mm" else 1) for number, unit in re.findall(r"([\d.]+) (mm|m)\b", cell)]


def test_the_example_on_the_page_is_simulated(tmp_path: Path):
    example = re.search(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    assert example is not None
    path = tmp_path / "mine.yaml"
    path.write_text(example[1], encoding="utf-8")
    simulation = simulate(load_scenario(str(path)), 1)
    assert "base_imu" not in simulation.delivered
    assert simulation.scenario.sensors["scanner"].range_noise_m == 0.03
    fixes = simulation.delivered["gnss"].readings
    assert not ((fixes.times_s > 25.0) & (fixes.times_s < 40.0)).any()
    faulty_s = fixes.times_s[fixes.values["faulty"]]
    assert [faulty_s.min(), faulty_s.max()] == pytest.approx([50.0, 53.0], abs=0.06)
    assert simulation.motion.distance_m > 20.0
