"""The whole of `make paper-quick`, once: interrupted, gone on with, and everything that it promises is there."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from holdfast.paper.maps import load_maps
from holdfast.paper.systems import SYSTEMS

sys.path.append(str(Path(__file__).parents[1] / "report"))
from chromium import PHONE, PROGRAM, check_page

TASKS = ("construction", "navigation")
TABLES = {
    *(f"{table}-{task}" for table in ("table-1", "table-1-whole", "switches") for task in TASKS),
    *("targets", "table-2", "outages", "figure-6-table", "maps", "ablation-construction", "machine", "tunings"),
}
FIGURES = {
    *(f"{figure}-{task}" for figure in ("track", "nees", "steps", "chassis", "gate") for task in TASKS),
    *(f"map-construction-{poses}" for poses in ("truth", *SYSTEMS)),
    *("latencies", "figure-3-error", "figure-3-z", "figure-4", "figure-6", "growth"),
    *("sensitivity-delay-gnss", "sensitivity-clock-odometry"),
}
LIMIT_S = 1200.0  # of a machine that runs the other tests beside it


def start(folder: Path, scratch: Path, *more: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", "from holdfast.cli import main; main()", "paper", "-o", str(folder), "--quick", *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(scratch)},
        start_new_session=True,
        # a shell that runs the tests in the background leaves SIGINT ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 (runs no thread)
    )


def refused(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


def age_of_runs(folder: Path) -> dict[str, int]:
    return {str(file.relative_to(folder)): file.stat().st_mtime_ns for file in folder.glob("runs/*/*.json")}


def told(errors: str) -> list[str]:
    """Return what is on stderr beside what is to be done, how far it is and what it took."""
    first, *rest = errors.splitlines()
    assert re.fullmatch(r"\d+ runs on \d+ s of recordings, \d+ at a time: roughly .* to .*", first)
    return [line for line in rest if not re.match(r"(evaluating|mapping): \d+ % after |\d+ runs took ", line)]


def is_gone(group: int) -> bool:
    """Whether nobody of a group of processes is left; what tracks their resources ends a moment after them."""
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.slow
def test_the_quick_evaluation_goes_on_after_ctrl_c_and_its_report_is_complete(tmp_path: Path):
    folder, scratch = tmp_path / "paper", tmp_path / "scratch"
    scratch.mkdir()
    process = start(folder, scratch)
    deadline = time.monotonic() + LIMIT_S
    while len(age_of_runs(folder)) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.2)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all
    _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert told(errors)[-1] == f"interrupted: what was done until then is in {folder}"
    assert is_gone(process.pid)
    assert not list(scratch.iterdir())
    kept = age_of_runs(folder)
    assert len(kept) >= 2
    assert not (folder / "report.html").exists()

    process = start(folder, scratch)
    printed, errors = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, told(errors)) == (0, [])
    assert {name: age for name, age in age_of_runs(folder).items() if name in kept} == kept
    assert not list(scratch.iterdir())
    check_results(folder, printed, tmp_path)
    check_maps(folder)


def check_maps(folder: Path) -> None:
    """Every system has a map, and none is better than that of the true poses."""
    loaded = load_maps(folder)
    assert loaded is not None
    fractions = {score.system: score.closeness["all"].fraction_within for score in loaded}
    assert list(fractions) == ["truth", *SYSTEMS]
    assert fractions["truth"] == max(fractions.values())
    assert fractions["truth"] > 0.99  # the noise of the ranges is 2 cm along the ray
    for score in loaded:
        assert (folder / "maps" / "construction" / f"{score.system}.ply").stat().st_size > 10_000
        assert score.view is not None
        assert np.isfinite(score.view.errors).any()


def check_results(folder: Path, printed: str, scratch: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert len(page) < 15_000_000
    found = {
        name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8"), parse_constant=refused)
        for name in ("report", "results")
    }
    assert [run["failure"] for run in found["results"]["runs"] if run["failure"]] == []
    assert "failed:" not in printed
    assert set(found["report"]["tables"]) == TABLES
    assert set(found["report"]["figures"]) == FIGURES
    for key in TABLES | FIGURES:
        assert f'<figure id="{key}">' in page
    for key, table in found["report"]["tables"].items():
        assert table["rows"], key
    for key, figure in found["report"]["figures"].items():
        assert any(len(trace["x"]) > 1 for trace in figure["traces"]), key
    lines = [line for line in printed.splitlines() if line.startswith(tuple(f"In {task} " for task in TASKS))]
    assert [line.split()[1] for line in lines] == list(TASKS)  # where ours loses, or that it does not
    assert all(line in page for line in lines)
    assert "Holdfast, optimiser in its own process" in printed
    picture = (folder / "outage.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) < 200_000
    if PROGRAM is not None:
        check_page(folder / "report.html", scratch, PHONE, len(FIGURES))


def test_an_output_that_cannot_be_written_is_one_line_and_code_2(tmp_path: Path):
    (tmp_path / "file").write_text("here is no folder")
    process = start(tmp_path / "file" / "paper", tmp_path)
    printed, errors = process.communicate(timeout=120.0)
    assert process.returncode == 2
    assert printed == ""
    (line,) = errors.splitlines()
    assert line.startswith(f"error: {tmp_path}/file/paper")
    assert "cannot be written (Not a directory)" in line
