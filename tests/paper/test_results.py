"""Results come back as they were written, and the tables show them."""

import json
from dataclasses import replace
from math import inf, isnan, nan

import numpy as np
import pytest

from holdfast.errors import ConfigError
from holdfast.evaluation.absolute import Statistics
from holdfast.paper.results import Growth, Latency, OutageScore, Results, Run, load, save
from holdfast.paper.tables import (
    QUANTITIES,
    cell,
    consistency_table,
    failures,
    faster_baselines,
    lost_cells,
    table_one,
    table_two,
)

HORIZONTAL = next(quantity for quantity in QUANTITIES if quantity.key == "good/horizontal_m")
TIMES = {"count": 9.0, "mean": 41.0, "std": 15.0, "median": 40.0, "p90": 50.0, "p99": 90.0, "max": 100.0}


def statistics(rms):
    return Statistics(mean=rms / 2, std=rms / 2, rms=rms, median=rms / 2, p95=2 * rms, max=3 * rms, count=100)


def run(system, seed=0, rms=0.01, scenario="construction", **more):
    return Run(
        study="accuracy",
        scenario=scenario,
        seed=seed,
        system=system,
        scores={"step_m": 1e-4, "settled_s": inf, "regained_s": nan},
        errors={"good/horizontal_m": statistics(rms)},
        corrections_m=None if system == "lidar" else statistics(0.003),
        imu_us=None,
        outages=(OutageScore(105.0, 150.0, 0.1, 0.2, 0.3, nan, inf, 0.5),),
        growth=(Growth(10.0, 0.1, 0.02, 0.3),),
        outcomes={"gnss": {"used": 7}},
        events=((1.5, "initialised", "", "standstill"),),
        real_time_factor=20.0,
        **more,
    )


def results(*runs):
    latency = (
        Latency("holdfast", TIMES, TIMES, TIMES, TIMES, ((0.5, 40.0),)),
        Latency("lidar", None, None, None, None),
    )
    return Results(
        command="holdfast paper -o here",
        quick=True,
        seeds=2,
        machine={"cpu": "one"},
        versions={"holdfast": "0"},
        scenarios={"construction": "duration_s: 1"},
        tunings={"msf": {"fix_inflation": 1.0}},
        runs=runs,
        latency=latency,
        latency_scenario="navigation",
        curves={"construction-0-msf": {"time_s": np.arange(3.0), "up_m": np.arange(3, dtype=np.float32)}},
    )


def test_results_come_back_as_they_were_saved(tmp_path):
    saved = results(run("holdfast"), run("lidar"), run("msf", failure="never started: no IMU sample has come"))
    save(saved, tmp_path)
    found = load(tmp_path)
    for mine, theirs in zip(found.runs, saved.runs, strict=True):
        assert mine.errors == theirs.errors
        assert mine.corrections_m == theirs.corrections_m
        assert mine.scores["settled_s"] == inf
        assert isnan(mine.scores["regained_s"])
        assert (mine.growth, mine.events, mine.failure) == (theirs.growth, theirs.events, theirs.failure)
        assert isnan(mine.outages[0].alone_horizontal_rms_m)
        assert mine.outages[0].settled_s == inf
    assert found.latency == saved.latency
    assert (found.command, found.seeds, found.tunings) == (saved.command, saved.seeds, saved.tunings)
    curves = found.curves["construction-0-msf"]
    np.testing.assert_array_equal(curves["up_m"], [0.0, 1.0, 2.0])


def test_results_are_json_that_any_reader_takes(tmp_path):
    save(results(run("holdfast")), tmp_path)

    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    json.loads((tmp_path / "results.json").read_text(), parse_constant=refuse)


def test_a_folder_without_results_is_refused_in_one_line(tmp_path):
    with pytest.raises(ConfigError, match="holds no results") as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)
    save(results(run("holdfast")), tmp_path)
    plain = json.loads((tmp_path / "results.json").read_text())
    (tmp_path / "results.json").write_text(json.dumps(plain | {"format": 0}))
    with pytest.raises(ConfigError, match="another version"):
        load(tmp_path)


def test_a_cell_is_the_mean_over_seeds_with_its_std():
    found = results(run("msf", 0, 0.010), run("msf", 1, 0.014), run("msf", 2, failure="x"), run("tsif", 0, 9.0))
    one = cell(found, "construction", "msf", HORIZONTAL, "rms")
    assert (one.mean, one.std, one.worst, one.runs) == (
        pytest.approx(12.0),
        pytest.approx(2.0),
        pytest.approx(14.0),
        2,
    )
    assert isnan(cell(found, "navigation", "msf", HORIZONTAL, "rms").mean)


def test_the_table_says_where_ours_loses():
    found = results(run("holdfast", rms=0.010), run("msf", rms=0.009), run("tsif", rms=0.5), run("lidar", rms=0.011))
    lost = lost_cells(found)
    assert [(one.scenario, one.quantity.key, one.system) for one in lost] == [
        ("construction", "good/horizontal_m", "msf")
    ]
    # it is no loss to do worse than ours by other rules
    assert not lost_cells(results(run("holdfast", rms=0.010), run("paper", rms=0.005)))


def test_a_difference_that_the_table_does_not_show_is_no_loss():
    assert not lost_cells(results(run("holdfast", rms=0.010004), run("msf", rms=0.010001)))


def test_the_table_says_which_baseline_answers_sooner():
    def latency(system, mean):
        return Latency(system, TIMES, TIMES | {"mean": mean}, TIMES | {"mean": 100.0 - mean}, None)

    timed = (latency("holdfast", 40.0), latency("msf", 39.0), latency("tsif", 41.0), latency("realtime", 42.0))
    found = replace(results(), latency=timed)
    assert faster_baselines(found) == [
        ("holdfast", "msf", 40.0, 39.0),
        ("realtime", "msf", 42.0, 39.0),
        ("realtime", "tsif", 42.0, 41.0),
    ]
    assert faster_baselines(found, "every_cpu_us") == [("holdfast", "tsif", 60.0, 59.0)]


def test_tables_have_a_row_for_everything_and_dashes_for_nothing():
    found = results(run("holdfast", 0, 0.010), run("holdfast", 1, 0.012), run("lidar"))
    rows = table_one(found, "construction")
    assert {len(row) for row in rows} == {len(rows[0])}
    horizontal = next(row for row in rows if row[0] == HORIZONTAL.label)
    assert horizontal[2] == "11.0 +- 1.0"
    assert horizontal[4] == "-"
    latency = table_two(found)
    assert latency[1][1:4] == ["41.0", "15.0", "40.0"]
    assert latency[1][6] == "41.0 +- 15.0"
    assert set(latency[2][1:]) == {"-"}
    assert [row[0] for row in consistency_table(results(run("msf", scenario="navigation")))] == ["", "MSF"]


def test_failures_are_listed():
    (line,) = failures(results(run("holdfast"), run("tsif", 3, failure="never started: why")))
    assert "tsif" in line
    assert "seed 3" in line
    assert line.endswith("never started: why")
