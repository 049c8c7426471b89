"""`holdfast batch`: many runs side by side; what is done stays done, and what fails harms no other."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from io import StringIO
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "replay"))
from small_drive import Done, holdfast

pytestmark = pytest.mark.slow

MAIN = [sys.executable, "-c", "from holdfast.cli import main; main()"]
LIMIT_S = 120.0


def run(*arguments: str | Path) -> Done:
    return holdfast("batch", *arguments)


def table(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "results.csv").open(encoding="utf-8") as file:
        return {row["run"]: row for row in csv.DictReader(file)}


def kept_states(folder: Path) -> list[str]:
    """What the runs say of themselves, before the table does."""
    return [json.loads(file.read_text())["state"] for file in folder.glob("*/run.json")]


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("broken") / "broken.mcap"
    file.write_bytes(b"this is no recording")
    return file


@pytest.fixture(scope="module")
def batch(simulated: Path, broken: Path, tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("batch") / "out"
    arguments = (simulated, broken, "-c", simulated / "config.yaml", "-o", folder, "--jobs", "2")
    vary = ("--vary", "graph.lag_s=1.5,3")
    return run(*arguments, *vary), folder, (*arguments, *vary)


def test_one_failure_does_not_stop_the_rest_and_its_reason_is_reported(batch):
    result, folder, _ = batch
    rows = table(folder)
    assert {name: row["state"] for name, row in rows.items()} == {
        "yard@graph.lag_s=1.5": "done",
        "yard@graph.lag_s=3": "done",
        "broken@graph.lag_s=1.5": "failed",
        "broken@graph.lag_s=3": "failed",
    }
    assert "broken.mcap" in rows["broken@graph.lag_s=3"]["reason"]
    assert result.code == 1
    assert "2 of 4 runs failed" in result.err
    assert "Traceback" not in result.err


def test_the_table_has_what_was_varied_the_errors_against_the_truth_and_the_time(batch):
    row = table(batch[1])["yard@graph.lag_s=1.5"]
    assert row["graph.lag_s"] == "1.5"
    assert 0.0 < float(row["horizontal_m_rms"]) < 0.1  # RTK fixes of 1 cm
    assert float(row["recorded_s"]) == pytest.approx(8.0, abs=0.1)
    assert float(row["update_ms_median"]) > 0.0


def test_every_run_leaves_what_a_replay_leaves_and_the_configuration_that_it_had(batch):
    folder = batch[1] / "yard@graph.lag_s=1.5"
    assert {"summary.json", "imu_in_world.tum", "events.jsonl", "config.yaml"} <= {f.name for f in folder.iterdir()}
    assert json.loads((folder / "summary.json").read_text())["config"]["graph"]["lag_s"] == 1.5


def test_done_runs_are_skipped_and_failed_ones_tried_again(batch):
    _, folder, arguments = batch
    before = {file: file.stat().st_mtime_ns for file in folder.glob("*/summary.json")}
    result = run(*arguments)
    assert "2 of 4 runs done, 2 of them before; 2 failed" in result.out
    assert {file: file.stat().st_mtime_ns for file in folder.glob("*/summary.json")} == before
    assert result.err.count(": failed ") == 2


def test_another_configuration_is_run_anew(batch, simulated: Path, tmp_path: Path):
    folder = tmp_path / "out"
    config = tmp_path / "config.yaml"
    text = (simulated / "config.yaml").read_text(encoding="utf-8")
    printed = []
    for extra in ("", "", "\nstandstill: {enabled: false}\n"):
        config.write_text(text + extra, encoding="utf-8")
        printed.append(run(simulated, "-c", config, "-o", folder, "--duration", "3").out.splitlines()[0])
    assert [line.partition(" of them before")[0][-1] for line in printed] == ["0", "1", "0"]


def test_errors_at_held_out_fixes_are_in_the_table(simulated: Path, tmp_path: Path):
    arguments = (simulated, "-c", simulated / "config.yaml", "-o", tmp_path, "--hold-out", "gnss=2", "--duration", "5")
    assert run(*arguments).code == 0
    (row,) = table(tmp_path).values()
    summary = json.loads((tmp_path / "yard" / "summary.json").read_text())
    rms = summary["held_out"]["causal"]["all"]["horizontal_m"]["rms"]
    assert float(row["held_out_horizontal_m_rms"]) == pytest.approx(rms, rel=1e-6)


def test_ctrl_c_keeps_what_is_done_and_the_next_batch_goes_on(simulated: Path, tmp_path: Path):
    arguments = [simulated, "-c", simulated / "config.yaml", "-o", tmp_path / "out"]
    arguments += ["--vary", "graph.lag_s=1.5,2,3", "--duration", "4"]
    process = subprocess.Popen([*MAIN, "batch", *map(str, arguments)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + LIMIT_S
    while "done" not in kept_states(tmp_path / "out") and time.monotonic() < deadline:
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 130
    assert "Traceback" not in errors
    states = [row["state"] for row in table(tmp_path / "out").values()]
    done = states.count("done")
    assert 1 <= done < 3
    assert not list((tmp_path / "out").glob(".stop*"))
    time.sleep(0.5)
    assert not replays_of(tmp_path), "a replay goes on although the batch was stopped"
    again = run(*arguments)
    assert again.code == 0
    assert f"3 of 3 runs done, {done} of them before; 0 failed" in again.out


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_no_replay_outlives_its_batch_and_each_leaves_its_summary(simulated: Path, tmp_path: Path, number: int):
    arguments = [simulated, "-c", simulated / "config.yaml", "-o", tmp_path / "out"]
    process = subprocess.Popen([*MAIN, "batch", *map(str, arguments)], stderr=subprocess.PIPE, text=True)
    track = tmp_path / "out" / "yard" / "imu_in_world.tum"
    deadline = time.monotonic() + LIMIT_S
    while not (track.exists() and track.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(replays_of(tmp_path)) == 1
    process.send_signal(number)
    _, errors = process.communicate(timeout=LIMIT_S)
    while replays_of(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not replays_of(tmp_path), "a replay goes on although its batch is gone"
    assert json.loads((track.parent / "summary.json").read_text())["finished"] is False
    if number == signal.SIGTERM:
        assert process.returncode == 128 + number
        assert errors.strip().endswith(f"interrupted: what was done until then is in {tmp_path / 'out'}")
    again = run(*arguments)
    assert again.code == 0, again.err
    assert "1 of 1 runs done, 0 of them before; 0 failed" in again.out


def test_the_drive_that_ships_with_gtsam_can_be_in_a_batch(tmp_path: Path):
    from holdfast.cli.demo import CONFIG

    (tmp_path / "config.yaml").write_text(CONFIG, encoding="utf-8")
    done = run("kitti", "-c", tmp_path / "config.yaml", "-o", tmp_path / "out", "--duration", "20")
    assert done.code == 0, done.err
    assert table(tmp_path / "out")["kitti"]["recording"] == "kitti"
    assert json.loads((tmp_path / "out/kitti/summary.json").read_text())["recording"] == "kitti"


def replays_of(folder: Path) -> list[str]:
    commands = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            commands.append(file.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:
            continue
    return [command for command in commands if str(folder) in command and " replay " in command]


def test_a_mistake_ends_in_one_line_and_exit_code_2(simulated: Path, tmp_path: Path):
    right = ("-c", simulated / "config.yaml")
    for wrong, printed in (
        ((*right, "--vary", "graph.lag_s=no"), "graph.lag_s"),
        ((*right, "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2"), "--jobs"),
        (("-c", tmp_path / "none.yaml"), "none.yaml"),
        ((*right, "--hold-out", "gps=2"), "--hold-out gps=2: sensor 'gps' is not configured"),
    ):
        result = run(simulated, "-o", tmp_path / "out", *wrong)
        assert result.code == 2
        assert printed in result.err
        assert len(result.err.splitlines()) == 1


def test_ctrl_c_in_a_terminal_reaches_the_replays_too_and_none_counts_as_failed(simulated: Path, tmp_path: Path):
    arguments = [simulated, "-c", simulated / "config.yaml", "-o", tmp_path / "out", "--jobs", "2"]
    command = [*MAIN, "batch", *map(str, arguments), "--vary", "graph.lag_s=1.5,2"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + LIMIT_S
    while len(list(tmp_path.glob("out/*/imu_in_world.tum"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 130
    assert "Traceback" not in errors
    states = [json.loads(file.read_text())["state"] for file in tmp_path.glob("out/*/run.json")]
    assert "failed" not in states


def test_the_table_on_a_terminal_tells_units_and_reasons():
    from rich.console import Console

    from holdfast.cli.batch import progress_table
    from holdfast.fleet.run import Outcome

    console = Console(width=120, record=True, file=StringIO())
    outcomes = [
        Outcome("a [1]", "done", "", "", 12.3, {"horizontal_m": 0.0123}),
        Outcome("b", "failed", "", "why [not]"),
    ]
    console.print(progress_table(outcomes))
    text = console.export_text()
    for part in ("time [s]", "horizontal RMS [m]", "a [1]", "0.012", "why [not]", "1 done, 0 running, 1 failed"):
        assert part in text


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as started:
        yield started.scheduler_address


@pytest.mark.slow
def test_a_cluster_of_two_workers_gives_the_same_table(cluster: str, batch, simulated: Path, broken: Path, tmp_path):
    here = table(batch[1])
    arguments = (simulated, broken, "-c", simulated / "config.yaml", "-o", tmp_path / "out")
    result = run(*arguments, "--vary", "graph.lag_s=1.5,3", "--scheduler", cluster)
    there = table(tmp_path / "out")
    assert result.code == 1
    assert "Traceback" not in result.err
    assert list(there) == list(here)
    for name, row in here.items():
        for key in ("state", "graph.lag_s", "horizontal_m_rms", "yaw_deg_rms", "gnss_lost", "reason"):
            assert there[name][key] == row[key], (name, key)


@pytest.mark.slow
def test_ctrl_c_stops_what_runs_on_the_cluster(cluster: str, simulated: Path, tmp_path: Path):
    arguments = [simulated, "-c", simulated / "config.yaml", "-o", tmp_path / "out", "--scheduler", cluster]
    arguments += ["--vary", "graph.lag_s=1.5,2,2.5,3,3.5,4,4.5,5"]
    process = subprocess.Popen([*MAIN, "batch", *map(str, arguments)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + LIMIT_S
    while "done" not in kept_states(tmp_path / "out") and time.monotonic() < deadline:
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 130
    assert "Traceback" not in errors
    time.sleep(1.0)
    assert not replays_of(tmp_path)


@pytest.mark.parametrize("address", ["nowhere://127.0.0.1:8786", "tcp://127.0.0.1:1", "tcp://127.0.0.1", "cluster"])
def test_a_scheduler_that_does_not_answer_is_reported_in_one_line(simulated: Path, tmp_path: Path, address: str):
    pytest.importorskip("distributed")
    result = run(simulated, "-c", simulated / "config.yaml", "-o", tmp_path, "--scheduler", address)
    assert result.code == 2
    assert f"--scheduler {address}: no scheduler answers" in result.err
    assert len(result.err.splitlines()) == 1
