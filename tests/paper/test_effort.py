"""What an evaluation announces: only what is left to do, and no false precision."""

import json
from pathlib import Path

import pytest

from holdfast.cli.paper import announced
from holdfast.paper.effort import COST, Effort, effort
from holdfast.paper.job import run_file
from holdfast.paper.study import plan

QUICK_RUNS, QUICK_RECORDED_S = 28, 923.0


def test_a_quick_evaluation_of_an_idle_machine_is_announced_as_minutes() -> None:
    todo = Effort(QUICK_RUNS, QUICK_RECORDED_S, 2, 1.0)
    assert announced(todo).startswith("28 runs on 923 s of recordings, 2 at a time: roughly 37 s to 88 s.")
    assert "other work" in announced(Effort(QUICK_RUNS, QUICK_RECORDED_S, 2, 6.0))


def test_what_is_done_is_not_announced_again(tmp_path: Path) -> None:
    whole = effort(tmp_path, 1, True, 2)
    assert (whole.runs, whole.recorded_s) == (QUICK_RUNS, QUICK_RECORDED_S)
    job = plan(1, True)[0]
    file = run_file(tmp_path, job, job.tasks[0])
    file.parent.mkdir(parents=True)
    file.write_text(json.dumps({"failure": ""}))
    left = effort(tmp_path, 1, True, 2)
    assert (left.runs, left.recorded_s) == (QUICK_RUNS - 1, QUICK_RECORDED_S - 42.0)
    for job in plan(1, True):
        for task in job.tasks:
            file = run_file(tmp_path, job, task)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps({"failure": ""}))
    assert announced(effort(tmp_path, 1, True, 2)).startswith("all runs are there already")


def test_more_processes_than_cores_make_nothing_faster(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr("os.getloadavg", lambda: (0.0, 0.0, 0.0))
    few, many = (effort(tmp_path, 1, True, jobs) for jobs in (2, 16))
    assert few.range_s() == many.range_s() == tuple(cost * QUICK_RECORDED_S / 2 for cost in COST)
    monkeypatch.setattr("os.getloadavg", lambda: (10.0, 0.0, 0.0))
    assert effort(tmp_path, 1, True, 2).crowding == pytest.approx(6.0)
