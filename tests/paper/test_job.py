"""A job runs its systems on one simulation, keeps what is done, and goes on after a failure."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import holdfast
from holdfast.errors import ConfigError
from holdfast.paper.curves import MAX_ROWS, rows_of, worst_since
from holdfast.paper.evaluation import SETTINGS, code_digest, evaluate, run_jobs
from holdfast.paper.job import is_done, run_file, run_job
from holdfast.paper.results import run_from_json
from holdfast.paper.study import Disturbance, Job, Task, plan
from holdfast.paper.systems import SYSTEMS, configured

pytestmark = pytest.mark.slow

SHORT = {
    "duration_s": 16.0,
    "faults": [{"kind": "outage", "sensors": ["gnss", "gnss_right", "heading"], "start_s": 9.0, "end_s": 13.0}],
}
JOB = Job("quick", 3, tuple(Task("accuracy", system) for system in SYSTEMS), SHORT, keep_curves=True)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    output = tmp_path_factory.mktemp("paper")
    run_job(JOB, output)
    return output


def result(output, task, job=JOB):
    return run_from_json(json.loads(run_file(output, job, task).read_text()))


@pytest.mark.parametrize("task", JOB.tasks, ids=lambda task: task.system)
def test_every_system_gets_a_verdict(done, task):
    run = result(done, task)
    assert run.failure == ""
    assert run.system == task.system
    # 9 to 13 s without a fix, found from the truth
    assert [round(outage.start_s) for outage in run.outages] == [9]
    assert 12.9 < run.outages[0].end_s < 13.2
    assert [growth.after_s for growth in run.growth] == [1.0, 2.0, 3.0]
    assert run.errors["good/horizontal_m"].count > 10
    assert run.errors["good/rtk_m"].rms > 0.0
    assert (run.corrections_m is None) == (task.system == "lidar")


def test_statistics_fit_together(done):
    errors = result(done, JOB.tasks[0]).errors
    assert errors["all/position_m"].count == errors["all/heading_deg"].count
    for part in ("good", "outage", "all"):
        square = errors[f"{part}/horizontal_m"].rms ** 2 + errors[f"{part}/vertical_m"].rms ** 2
        assert errors[f"{part}/position_m"].rms ** 2 == pytest.approx(square)


@pytest.mark.parametrize("task", JOB.tasks, ids=lambda task: task.system)
def test_curves_are_thin_and_of_one_length(done, task):
    with np.load(run_file(done, JOB, task).with_suffix(".npz")) as archive:
        columns = {name: archive[name] for name in archive.files}
    beside = [name for name in columns if not any(word in name for word in ("rtk", "nis", "correction", "outcome"))]
    assert {len(columns[name]) for name in beside} == {len(columns["time_s"])}
    assert max(map(len, columns.values())) <= MAX_ROWS
    assert np.isfinite(columns["up_m"]).all()
    np.testing.assert_allclose(columns["x_m"] - columns["true_x_m"], columns["east_m"], atol=1e-4)


def test_outcomes_over_time_add_up_to_the_outcomes_of_the_run(done):
    task = JOB.tasks[0]
    used = result(done, task).outcomes["gnss"]["used"]
    with np.load(run_file(done, JOB, task).with_suffix(".npz")) as archive:
        in_time = float(archive["outcome:gnss:used"].sum())
    assert used - 25 <= in_time <= used  # but for what came in the last second


def test_what_is_done_is_not_done_again(done):
    files = [run_file(done, JOB, task) for task in JOB.tasks]
    before = [file.stat().st_mtime_ns for file in files]
    run_job(JOB, done)
    assert [file.stat().st_mtime_ns for file in files] == before


def test_a_system_that_fails_stops_nobody_and_is_tried_again(tmp_path):
    never = Job("moving-start", 0, (Task("accuracy", "msf"), Task("accuracy", "holdfast")), {"duration_s": 12.0})
    run_job(never, tmp_path)
    failed, other = (result(tmp_path, task, never) for task in never.tasks)
    assert failed.failure.startswith("never started: the machine has not stood still")
    assert not is_done(tmp_path, never, never.tasks[0])
    assert not other.failure
    assert is_done(tmp_path, never, never.tasks[1])


@pytest.mark.slow
def test_jobs_run_side_by_side_in_processes_of_their_own(tmp_path):
    tasks = (Task("sensitivity", "msf", "", Disturbance("gnss", delay_s=0.2)),)
    jobs = [Job("quick", seed, tasks, SHORT) for seed in (0, 1)]
    seen: list[tuple[int, int]] = []
    run_jobs(jobs, tmp_path, 2, lambda done, total: seen.append((done, total)))
    assert seen[-1] == (2, 2)
    found = [result(tmp_path, tasks[0], job) for job in jobs]
    assert [(run.seed, run.sensor, run.delay_s) for run in found] == [(0, "gnss", 0.2), (1, "gnss", 0.2)]
    assert not any(run.failure for run in found)


def test_every_run_of_a_plan_has_a_file_of_its_own(tmp_path):
    for quick in (False, True):
        planned = plan(3, quick)
        files = [run_file(tmp_path, job, task) for job in planned for task in job.tasks]
        assert len(set(files)) == len(files)
        assert {job.seed for job in planned if job.keep_curves} == {0}


def test_a_system_runs_under_its_preset_and_the_machine_gives_the_rest():
    given = {"sensors": {"imu": {"kind": "imu", "topic": "/imu"}}, "graph": {"lag_s": 2.0}}
    assert configured("holdfast", given).graph.nodes == "measurement"
    paper = configured("paper", given)
    assert (paper.graph.nodes, paper.graph.lag_s) == ("imu", 2.0)


def test_rows_are_even_and_no_spike_is_lost():
    rows = rows_of(4500)
    assert len(rows) <= MAX_ROWS
    assert set(np.diff(rows).tolist()) == {3}
    values = np.zeros(4500)
    values[1234] = 7.0
    values[[5, 6]] = np.nan
    assert worst_since(values, rows).max() == 7.0
    assert len(rows_of(3)) == 3
    assert len(worst_since(np.zeros(0), rows_of(0))) == 0


def test_a_folder_of_another_kind_of_run_is_refused(tmp_path):
    (tmp_path / SETTINGS).write_text(json.dumps({"quick": False, "scenarios": "other", "versions": {}}))
    with pytest.raises(ConfigError, match="other quick and scenarios and code and versions"):
        evaluate(tmp_path, 1, True, 1, "test")


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("realtime/engine.py", True),  # it has rows in Table II
        ("integrity/receiver.py", True),
        ("chassis/kinematics.py", True),
        ("bench/realtime.py", True),
        ("messages.py", True),
        ("paper/latency.py", True),
        ("paper/page_tables.py", False),
        ("cli/paper.py", False),
    ],
)
def test_runs_are_stale_when_code_that_an_answer_comes_from_has_changed(tmp_path, file, counts):
    root = tmp_path / "holdfast"
    shutil.copytree(Path(holdfast.__file__).parent, root, ignore=shutil.ignore_patterns("__pycache__"))
    before = code_digest(root)
    with (root / file).open("a") as changed:
        changed.write("# changed\n")
    assert (code_digest(root) != before) is counts


def test_a_wrong_option_is_one_line_and_code_2():
    done = subprocess.run(
        [sys.executable, "-c", "from holdfast.cli import main; main()", "paper", "--seeds", "0", "-o", "x"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "seeds" in done.stderr
