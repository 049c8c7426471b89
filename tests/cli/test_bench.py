"""`holdfast bench`: what it measures, and a gate that closes when something became slower."""

import copy
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "replay"))

from small_drive import config_text, holdfast, make_rows, write_config, write_csv

from holdfast.bench import replay as benchmark
from holdfast.bench.replay import RATIOS, Job, compare, make_baseline, measure, measure_floor, read_baseline
from holdfast.config.load import load_config, parse_config
from holdfast.errors import EstimatorError
from holdfast.recording.subscriptions import subscriptions

SECONDS = 4.0
COMMITTED = Path(__file__).parents[2] / "benchmarks" / "baseline.json"


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_csv(tmp_path_factory.mktemp("bench") / "csv", make_rows(seconds=SECONDS))


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return write_config(tmp_path_factory.mktemp("bench") / "config.yaml")


@pytest.fixture(scope="module")
def measured(tmp_path_factory, drive, config):
    """One real run of the command: what it printed, and its JSON."""
    path = tmp_path_factory.mktemp("bench") / "result.json"
    done = holdfast("bench", "--recording", drive, "-c", config, "--nodes", "both", "--json", path)
    assert done.code == 0, done.err
    return done, json.loads(path.read_text())


@pytest.fixture
def replayed(monkeypatch, measured, drive, config):
    """The command with the measurement replaced by the one that was made: its answer is the same every time."""
    _, result = measured
    monkeypatch.setattr(benchmark, "measure", lambda job, _: result["runs"][job.config.graph.nodes])
    return lambda *arguments: holdfast("bench", "--recording", drive, "-c", config, *arguments)


def stricter(baseline, factor, names=tuple(RATIOS)):
    """The baseline of something that was faster by a factor."""
    changed = copy.deepcopy(baseline)
    for ratios in changed["ratios"].values():
        for name in names:
            ratios[name] /= factor
    return changed


def job_of(drive, config, **changes):
    loaded = load_config(config)
    return Job(str(drive), loaded, tuple(subscriptions(loaded)), **changes)


# --- what is measured -------------------------------------------------------------------------------------------------


def test_json_holds_times_memory_floor_and_ratios_of_every_run(measured):
    _, result = measured
    assert set(result["runs"]) == {"measurement", "imu"}
    for run in result["runs"].values():
        timing = run["timing"]
        assert timing["recorded_s"] == pytest.approx(SECONDS, abs=0.1)
        assert timing["real_time_factor"] == pytest.approx(timing["recorded_s"] / timing["wall_s"])
        for quantiles in (timing["imu_us"], timing["update_ms"], run["floor_us"]):
            assert 0 < quantiles["median"] <= quantiles["p90"] <= quantiles["p99"] <= quantiles["max"]
        assert timing["imu_us"]["count"] + timing["update_ms"]["count"] > SECONDS * 100
        assert run["cpu_s"] > 0
        assert 20 < run["peak_memory_mb"] < 1000
        assert run["with_outputs"]["timing"]["real_time_factor"] > 0
        assert run["with_outputs"]["peak_memory_mb"] > 20
        assert run["with_outputs"]["ratios"]["cpu"] > 0.8 * run["ratios"]["cpu"]  # it writes as well


def test_ratios_are_times_over_the_floor_of_the_same_run(measured):
    for run in measured[1]["runs"].values():
        floor_us = run["floor_us"]["median"]
        assert set(run["ratios"]) == set(RATIOS)
        assert run["ratios"]["imu_path"] == pytest.approx(run["timing"]["imu_us"]["median"] / floor_us)
        assert run["ratios"]["update"] == pytest.approx(run["timing"]["update_ms"]["median"] * 1e3 / floor_us)
        assert run["ratios"]["cpu"] == pytest.approx(run["cpu_s"] / (SECONDS * 100 * floor_us * 1e-6))
        assert run["ratios"]["imu_path"] > 1.0  # the estimator does what the floor does, and more


def test_machine_is_described(measured):
    machine = measured[1]["machine"]
    assert machine["cpu"]
    assert machine["cores"] >= 1
    assert machine["python"] == ".".join(map(str, sys.version_info[:3]))
    assert machine["gtsam"].startswith("4.3")


def test_a_pipe_gets_a_plain_table_and_a_silent_stderr(measured):
    done, result = measured
    assert done.err == ""
    assert done.out.isascii()
    assert "\x1b" not in done.out
    lines = done.out.splitlines()
    assert lines[0].startswith(result["machine"]["cpu"])
    for title in ("real-time factor", "real-time factor, writing the results", "peak memory [MB]", *RATIOS.values()):
        assert any(line.strip().startswith(title) for line in lines)
    for quantity in ("IMU sample to estimate [us]", "update [ms]"):
        assert [
            line
            for line in lines
            if quantity in line and line.split(",")[1].split()[0] in {"median", "p90", "p99", "max"}
        ]


def test_floor_takes_every_sample_of_the_imu_and_nothing_else(drive, config):
    took_ns = measure_floor(job_of(drive, config))
    # the first sample, and one after each second of integration, begin anew and are not timed
    assert SECONDS * 100 - 1 - SECONDS <= len(took_ns) < SECONDS * 100
    assert min(took_ns) > 0
    assert len(measure_floor(job_of(drive, config, duration_s=1.0))) <= 100


def test_peak_memory_is_that_of_the_run_alone(drive, config):
    ballast = np.ones(40_000_000)  # 320 MB in this process
    assert measure(job_of(drive, config, duration_s=3.0))["peak_memory_mb"] < 250
    assert ballast[-1] == 1.0


def test_progress_is_reported_and_errors_come_back_from_the_process(drive, config):
    arrivals = []
    with pytest.raises(EstimatorError, match="never started"):
        measure(job_of(drive, config, duration_s=0.5), arrivals.append)
    assert len(arrivals) >= 1
    assert arrivals == sorted(arrivals)


# --- the gate ---------------------------------------------------------------------------------------------------------


def test_the_gate_passes_against_its_own_result(replayed, tmp_path):
    baseline = tmp_path / "baseline.json"
    assert replayed("--nodes", "both", "--gate", baseline, "--update-baseline").code == 0
    written = baseline.read_bytes()
    done = replayed("--nodes", "both", "--gate", baseline)
    assert done.code == 0
    assert done.err == ""
    assert done.out.splitlines()[-1] == f"not slower than {baseline}"
    assert baseline.read_bytes() == written


def test_the_gate_fails_against_a_baseline_made_ten_times_stricter(replayed, measured, tmp_path):
    baseline = tmp_path / "baseline.json"
    baseline.write_text(json.dumps(stricter(make_baseline(measured[1]), 10.0)))
    done = replayed("--nodes", "both", "--gate", baseline)
    assert done.code == 1
    lines = done.err.splitlines()
    assert len(lines) == 2 * len(RATIOS)
    for line, (kind, meaning) in zip(
        lines, [(k, m) for k in ("measurement", "imu") for m in RATIOS.values()], strict=True
    ):
        assert line.startswith(f"error: nodes {kind}: {meaning}: ")
        assert line.endswith("(allowed: 1.5 x)")
    assert json.loads(baseline.read_text()) == stricter(make_baseline(measured[1]), 10.0)


@pytest.mark.parametrize("name", RATIOS)
def test_only_the_ratio_that_is_worse_by_more_than_the_factor_is_named(measured, name):
    baseline = make_baseline(measured[1])
    assert compare(measured[1], stricter(baseline, 1.49), "b") == []
    slower = compare(measured[1], stricter(baseline, 1.51, [name]), "b")
    assert len(slower) == 2
    assert all(RATIOS[name] in line for line in slower)
    assert compare(measured[1], stricter(baseline, 1.51) | {"max_factor": 2.0}, "b") == []
    assert compare(measured[1], stricter(baseline, 0.1), "b") == []  # faster is no fault


def test_a_ratio_that_is_not_a_number_does_not_pass(measured):
    result = copy.deepcopy(measured[1])
    result["runs"]["imu"]["ratios"]["update"] = float("nan")
    assert len(compare(result, make_baseline(measured[1]), "b")) == 1


def test_a_run_that_the_baseline_has_not_is_not_compared_but_one_must_be(replayed, measured, tmp_path):
    baseline = tmp_path / "baseline.json"
    content = make_baseline(measured[1])
    del content["ratios"]["imu"]
    baseline.write_text(json.dumps(content))
    assert replayed("--nodes", "both", "--gate", baseline).code == 0
    done = replayed("--nodes", "imu", "--gate", baseline)
    assert (done.code, done.err) == (2, f"error: {baseline}: has no baseline for nodes imu\n")


def test_update_keeps_the_factor_that_stands_in_the_file(replayed, measured, tmp_path):
    baseline = tmp_path / "baseline.json"
    baseline.write_text(json.dumps(stricter(make_baseline(measured[1], max_factor=3.0), 10.0)))
    assert replayed("--nodes", "both", "--gate", baseline, "--update-baseline").code == 0
    assert json.loads(baseline.read_text()) == make_baseline(measured[1], max_factor=3.0)


@pytest.mark.parametrize(("text", "words"), [
    (None, "no baseline (No such file"),
    ("fast", "is no baseline"),
    ("{}", "is no baseline (it has no 'max_factor')"),
    ("[]", "is no baseline"),
    ('{"max_factor": 0.5}', "max_factor is 0.5: must be 1 or more"),
])  # fmt: skip
def test_a_file_that_is_no_baseline_is_refused_before_anything_runs(replayed, tmp_path, text, words):
    baseline = tmp_path / "baseline.json"
    if text is not None:
        baseline.write_text(text)
    done = replayed("--gate", baseline)
    assert (done.code, done.out, len(done.err.splitlines())) == (2, "", 1)
    assert f"error: {baseline}: {words}" in done.err


def test_a_baseline_of_another_recording_is_refused(replayed, measured, tmp_path):
    baseline = tmp_path / "baseline.json"
    baseline.write_text(json.dumps(make_baseline(measured[1]) | {"recording": "elsewhere"}))
    done = replayed("--gate", baseline)
    assert done.code == 2
    assert "is a baseline for recording elsewhere" in done.err


def test_the_committed_baseline_serves_the_default_recording():
    baseline = read_baseline(COMMITTED)
    assert (baseline["recording"], baseline["duration_s"], baseline["max_factor"]) == ("kitti", None, 1.5)
    assert set(baseline["ratios"]) == {"measurement", "imu"}


# --- mistakes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("arguments", "code", "words"), [
    (("--recording", "DRIVE"), 2, "needs a configuration: give -c"),
    (("--recording", "nowhere.mcap", "-c", "CONFIG"), 3, "nowhere.mcap: no such file"),
    (("--recording", "DRIVE", "-c", "CONFIG", "--duration", "-1"), 2, "--duration -1: must be > 0"),
    (("--recording", "DRIVE", "-c", "CONFIG", "--json", "/nowhere/r.json"), 2, "/nowhere/r.json: cannot be written"),
    (("--recording", "DRIVE", "-c", "CONFIG", "--duration", "0.5"), 4, "never started"),
])  # fmt: skip
def test_a_mistake_ends_in_one_line_and_a_code(drive, config, arguments, code, words):
    paths = {"DRIVE": drive, "CONFIG": config}
    done = holdfast("bench", *(paths.get(argument, argument) for argument in arguments))
    assert (done.code, len(done.err.splitlines())) == (code, 1), done.err
    assert words in done.err


def test_the_drive_in_the_wheel_needs_no_configuration():
    from holdfast.cli.bench import _configuration

    assert _configuration("kitti", None).imu.topic == "/imu"
    assert _configuration("kitti", None) != parse_config(config_text())


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are found in /proc")
def test_ctrl_c_ends_the_measured_process_too():
    command = [sys.executable, "-c", "from holdfast.cli import main; main()", "bench", "--recording", "kitti"]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 (runs no thread)
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    until(lambda: len(children.read_text().split()) == 2)  # the resource tracker of Python, and the run
    started = children.read_text().split()
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to both
    stdout, stderr = process.communicate(timeout=20)
    assert (process.returncode, stdout, stderr.split()) == (130, "", ["interrupted"])
    assert until(lambda: not any(is_alive(pid) for pid in started))


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def until(condition):
    deadline = time.monotonic() + 20
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    return condition()
