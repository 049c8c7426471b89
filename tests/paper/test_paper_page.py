"""The report of the paper: every table and figure from the results, and nothing hidden where ours loses."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.evaluation.absolute import Statistics
from holdfast.evaluation.mapping import Closeness, MapOptions, View
from holdfast.paper.maps import MapScore, cast_scans, coloured
from holdfast.paper.page import paper_page, write_report
from holdfast.paper.results import Growth, Latency, OutageScore, Results, Run
from holdfast.paper.study import TASKS
from holdfast.paper.systems import ENGINE, SYSTEMS
from holdfast.paper.tables import QUANTITIES
from holdfast.report.page import Figure, Row, Table, Text, numbers_of, write_page

sys.path.append(str(Path(__file__).parents[1] / "report"))
from chromium import DESKTOP, PHONE, check_page, needs_chromium

TIMES = {"count": 100.0, "mean": 12.0, "std": 3.0, "median": 11.0, "p90": 15.0, "p99": 20.0, "max": 50.0}
CLOSENESS = Closeness(points=1000, area_m2=500.0, median_m=0.01, p95_m=0.04, rms_m=0.02, fraction_within=0.97)


def statistics(value: float) -> Statistics:
    return Statistics(mean=value / 2, std=value / 3, rms=value, median=value / 2, p95=2 * value, max=3 * value, count=9)


def run(study: str, scenario: str, system: str, seed: int = 0, **more) -> Run:
    size = 0.01 * (1 + list(SYSTEMS).index(system))  # ours is the best, the others follow
    given = {
        "errors": {quantity.key: statistics(size) for quantity in QUANTITIES} | {"all/horizontal_m": statistics(size)},
        "scores": {"horizontal_rms_m": size, "step_m": 0.001, "nees_position": 1.0},
        "corrections_m": None if system == "lidar" else statistics(size / 10),
        "update_ms": TIMES,
        "outages": (OutageScore(20.0, 30.0, size, size, 0.1, 0.05, 1.0, 0.5),),
        "growth": (Growth(1.0, size, size, 0.1), Growth(5.0, 3 * size, 2 * size, 0.2)),
        "events": ((20.5, "gnss_lost", "", "no antenna is trusted"), (30.5, "gnss_regained", "", "5 fixes agree")),
    }
    return Run(study=study, scenario=scenario, seed=seed, system=system, **(given | more))


def curves(system: str) -> dict[str, np.ndarray]:
    time_s = np.linspace(0.0, 60.0, 600)
    wave = 0.01 * np.sin(time_s)
    names = ("x_m", "y_m", "z_m", "true_x_m", "true_y_m", "true_z_m", "east_m", "north_m", "up_m", "heading_deg",
             "nees_attitude", "nees_position", "nees_velocity", "step_m", "step_deg")  # fmt: skip
    found = {"time_s": time_s} | dict.fromkeys(names, wave + 0.02)
    found |= {"rtk_time_s": time_s[::5], "rtk_m": wave[::5] + 0.02, "nis": wave[::5] + 1.0}
    if system != "lidar":
        found |= {"correction_time_s": time_s[::5], "correction_m": np.abs(wave[::5])}
    if system in ("holdfast", "paper"):
        found |= {"base_m": wave, "base_yaw_rate_rad_s": wave}
        found |= {"outcome_time_s": np.arange(60.0), "outcome:gnss:used": np.full(60, 20.0)}
    return found


def results() -> Results:
    runs = [run("accuracy", task, system, seed) for seed in (0, 1) for task in TASKS for system in SYSTEMS]
    runs += [run("ablation", task, "holdfast", variation="no-lidar") for task in TASKS]
    runs += [run("growth", "tunnel", system) for system in SYSTEMS]
    for system in ("holdfast", "msf"):
        runs += [run("sensitivity", "construction", system)]
        runs += [run("sensitivity", "construction", system, sensor="gnss", delay_s=delay) for delay in (0.1, 0.3)]
        runs += [run("sensitivity", "construction", system, sensor="lidar", clock_s=0.05)]
    quantiles = tuple((q, 10.0 + 30.0 * q) for q in (0.0, 0.5, 0.9, 1.0))
    return Results(
        command="holdfast paper -o out --seeds 2",
        quick=False,
        seeds=2,
        machine={"processor": "some", "cores": 2},
        versions={"holdfast": "1.2.3"},
        scenarios={task: f"name: {task}" for task in TASKS},
        tunings={"msf": {"a": 1.0}, "tsif": {"b": 2.0}},
        runs=tuple(runs),
        latency=tuple(
            Latency(s, None if s == "lidar" else TIMES, TIMES, TIMES, TIMES, quantiles) for s in (*SYSTEMS, ENGINE)
        ),
        latency_scenario="navigation, seed 0, 30 s",
        curves={f"{task}-0-{system}": curves(system) for task in TASKS for system in SYSTEMS},
    )


def maps() -> tuple[MapScore, ...]:
    errors = np.full((40, 60), 0.02)
    errors[:10] = np.nan
    view = View(errors, (-5.0, -3.0), 0.5)
    return tuple(MapScore(task, s, "", 100, 1, {"all": CLOSENESS}, view) for task in TASKS for s in ("truth", *SYSTEMS))


def blocks(of: Results, made: tuple[MapScore, ...] | None = None) -> dict[str, Table | Figure]:
    found = [block for section in paper_page(of, made).sections for block in section.blocks]
    flat = [one for block in found for one in (block.figures if isinstance(block, Row) else [block])]
    return {block.key: block for block in flat if isinstance(block, Table | Figure)}


def test_every_table_and_figure_of_the_paper_is_there_and_what_it_lacks():
    keys = set(blocks(results(), maps()))
    assert {"table-1-construction", "table-1-navigation", "table-2", "figure-3-error", "figure-3-z", "figure-4",
            "figure-6", "figure-6-table", "maps"} <= keys  # fmt: skip
    assert {"nees-navigation", "steps-construction", "chassis-navigation", "gate-navigation", "ablation-construction",
            "growth", "sensitivity-delay-gnss", "sensitivity-clock-lidar", "switches-construction"} <= keys  # fmt: skip
    assert {f"map-{task}-{system}" for task in TASKS for system in ("truth", *SYSTEMS)} <= keys


def test_where_ours_loses_its_cell_stands_out():
    whole = results()
    key = "outage/vertical_m"

    def better(one: Run) -> Run:
        is_msf = one.study == "accuracy" and one.scenario == "navigation" and one.system == "msf"
        return replace(one, errors=dict(one.errors) | {key: statistics(0.001)}) if is_msf else one

    found = blocks(replace(whole, runs=tuple(better(one) for one in whole.runs)))
    table = found["table-1-navigation"]
    row = [quantity.key for quantity in QUANTITIES].index(key)
    ours, msf = (2 + list(SYSTEMS).index(name) for name in ("holdfast", "msf"))
    assert table.marks[row, ours] == "missed"
    assert table.marks[row, msf] == "best"
    assert set(found["table-1-construction"].marks.values()) == {"best"}


def worse(of: Results, **changed: float) -> Results:
    """Return results in which ours has another RMS, of every quantity of one task."""

    def one(run: Run) -> Run:
        if run.study != "accuracy" or run.system != "holdfast" or run.scenario not in changed:
            return run
        return replace(run, errors={key: statistics(changed[run.scenario]) for key in run.errors})

    return replace(of, runs=tuple(one(run) for run in of.runs))


def notes(of: Results, made: tuple[MapScore, ...] | None = None) -> str:
    sections = paper_page(of, made).sections
    return "\n".join(block.text for section in sections for block in section.blocks if isinstance(block, Text))


def test_where_ours_loses_words_name_the_row_the_rival_and_both_values():
    assert "In construction no baseline does better than ours in any row." in notes(results())
    text = notes(worse(results(), navigation=0.045))  # MSF has 30 mm, TSIF 40, the lidar alone 50
    assert "In construction no baseline does better" in text
    assert f"In navigation ours loses {len(QUANTITIES)} of {len(QUANTITIES)} rows to a baseline" in text
    assert "GNSS lost: vertical (MSF 30.0, TSIF 40.0, ours 45.0 mm);" in text
    assert "Lidar odometry alone" not in text
    assert f"In {len(QUANTITIES)} of {2 * len(QUANTITIES)} rows" in paper_page(worse(results(), navigation=0.045)).lead


def test_ours_without_a_verdict_is_no_victory():
    whole = results()
    silent = tuple(
        replace(run, failure="never started") if run.scenario == "navigation" and run.system == "holdfast" else run
        for run in whole.runs
    )
    page = replace(whole, runs=silent)
    assert "In navigation ours has no verdict, and so loses to every baseline that has one." in notes(page)
    assert f"In {len(QUANTITIES)} of {2 * len(QUANTITIES)} rows" in paper_page(page).lead


def test_a_loss_within_the_std_of_the_seeds_is_marked_as_such():
    whole = results()

    def varied(run: Run) -> Run:
        is_ours = run.study == "accuracy" and run.scenario == "navigation" and run.system == "holdfast"
        errors = {key: statistics(0.025 + 0.02 * run.seed) for key in run.errors}  # 35 +- 10 mm; MSF has 30
        return replace(run, errors=errors) if is_ours else run

    text = notes(replace(whole, runs=tuple(varied(run) for run in whole.runs)))
    assert "GNSS lost: vertical (MSF 30.0, ours 35.0 mm, which is less than the std over the seeds)" in text


def test_slower_answers_inconsistency_and_worse_maps_are_put_into_words():
    whole = results()
    latency = tuple(
        replace(one, imu_cpu_us=TIMES | {"mean": 9.0}) if one.system == "msf" else one for one in whole.latency
    )
    inconsistent = tuple(
        replace(run, corrections_m=statistics(0.1)) if run.system == "holdfast" and run.corrections_m else run
        for run in whole.runs
    )
    poor = replace(CLOSENESS, fraction_within=0.9)
    made = tuple(replace(one, closeness={"all": poor}) if one.system == "holdfast" else one for one in maps())
    text = notes(replace(whole, latency=latency, runs=inconsistent), made)
    faster = "On samples without an update MSF answers sooner than Holdfast"
    assert f"{faster}: after 9.0 us of CPU time, ours after 12.0 us." in text
    assert f"{faster}, optimiser in its own process: after 9.0 us" in text
    assert "updates too" not in text  # on average of all samples they are equal
    assert "Ours does not reach its target: 50.00 mm mean" in text
    assert "MSF is nearer to its optimised states: 1.50 mm mean, ours 50.00 mm." in text
    assert "In construction the map of MSF is better: 97.00 % within 5 cm, ours 90.00 %." in text
    assert "In navigation our map does not reach its target: 90.00 % within 5 cm, the true poses 97.00." in text
    for silence in ("answers sooner", "reach its target", "is better", "is nearer"):
        assert silence not in notes(whole, maps())


def test_the_tables_hold_the_mean_over_the_seeds_in_the_unit_that_they_tell():
    table = blocks(results())["table-1-construction"]
    row = next(row for row in table.rows if row[0] == "GNSS good: horizontal")
    assert row[1:3] == ["mm", "10.0 ± 0.0"]
    latency = blocks(results())["table-2"]
    assert latency.rows[0][1] == TIMES["mean"]
    rows = {row[0]: dict(zip(latency.columns, row, strict=True)) for row in latency.rows}
    assert rows["Lidar odometry alone"]["mean [us]"] is None  # it has no IMU path
    assert rows["Holdfast, optimiser in its own process"]["mean [us]"] == TIMES["mean"]
    assert rows["MSF"]["paper [us]"] == "32.9 ± 18.7"


def test_a_run_without_a_verdict_is_listed(tmp_path: Path):
    whole = results()
    failed = replace(whole.runs[0], failure="ValueError: what went wrong", seed=7)
    write_report(replace(whole, runs=(*whole.runs, failed)), tmp_path)
    assert "ValueError: what went wrong" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("failed", [("navigation",), TASKS], ids=["one task", "both tasks"])
def test_a_task_in_which_every_system_failed_costs_the_page_nothing_but_its_figures(failed, tmp_path: Path):
    whole = results()
    runs = tuple(replace(run, failure="never started") if run.scenario in failed else run for run in whole.runs)
    curves = {name: of for name, of in whole.curves.items() if not name.startswith(failed)}
    write_report(replace(whole, runs=runs, curves=curves), tmp_path)
    numbers = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    for task in TASKS:
        assert (f"track-{task}" in numbers["figures"]) == (task not in failed)
        assert f"table-1-{task}" in numbers["tables"]
    assert "never started" in (tmp_path / "report.html").read_text(encoding="utf-8")
    rows = len(QUANTITIES) * (len(TASKS) - len(failed))
    assert f"In {rows} of {2 * len(QUANTITIES)} rows" in numbers["lead"]


def test_a_system_without_a_map_is_listed(tmp_path: Path):
    from holdfast.report.page import render

    failed = replace(maps()[1], failure="the trajectory covers none of the 9 scans", closeness={}, view=None)
    html = render(paper_page(results(), (*maps()[:1], failed)))
    assert "No map of construction with the poses of Holdfast: the trajectory covers none" in html


def test_results_of_a_quick_look_say_that_they_are():
    assert "shortened" in paper_page(replace(results(), quick=True)).lead
    assert "shortened" not in paper_page(results()).lead


def test_the_report_is_light_and_its_numbers_are_json(tmp_path: Path):
    write_report(results(), tmp_path)
    assert (tmp_path / "report.html").stat().st_size < 15_000_000
    numbers = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert numbers == json.loads(json.dumps(numbers_of(paper_page(results()))))
    assert numbers["provenance"]["seed"] == "0 to 1"


@needs_chromium
@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_a_browser_draws_every_figure_of_the_report(tmp_path: Path, size):
    page = paper_page(results(), maps())
    write_page(page, tmp_path / "report.html")
    figures = len(numbers_of(page)["figures"])
    assert figures > 25
    check_page(tmp_path / "report.html", tmp_path, size, figures)


def test_pixels_are_green_on_the_surface_red_far_from_it_and_clear_where_nothing_is():
    pixels = coloured(np.array([[0.0, 0.5, np.nan]]))
    on_it, far, nothing = pixels[0]
    assert on_it[1] > on_it[0]
    assert far[0] > far[1]
    assert (on_it[3], far[3], nothing[3]) == (255, 255, 0)


def test_scans_for_a_map_are_those_that_would_be_recorded(tmp_path: Path):
    from holdfast.lidar_odometry.sweep import decode_sweep
    from holdfast.recording.raw import RawBag
    from holdfast.sim.recorder import write_recording
    from holdfast.sim.scenario import load_scenario
    from holdfast.sim.simulation import simulate

    simulation = simulate(load_scenario("quick", {"duration_s": 1.2}), 3)
    write_recording(simulation, tmp_path / "scans.mcap", True, None)
    with RawBag(tmp_path / "scans.mcap") as bag:
        channel = next(channel for channel in bag.channels if channel.type.endswith("PointCloud2"))
        codec = channel.codec()
        sweeps = [decode_sweep(codec.deserialize(raw)) for _, of, raw in bag.messages() if of == channel]
    cast = cast_scans(simulation, 1, MapOptions(max_points_per_scan=10**6, max_range_m=1e3))
    assert len(sweeps) > 2
    for ours, recorded in zip(cast, sweeps, strict=False):
        np.testing.assert_array_equal(ours.points, recorded.points.astype(np.float32))
        # the recording has the clock of the lidar, which may be a little off the true time
        assert abs(ours.stamp_ns - recorded.stamp_ns) < 1_000_000
