"""The whole evaluation: every job in a pool of processes, the latencies alone, and the results in one file.

A finished run is kept as a file: an evaluation that was interrupted continues where it stopped.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import holdfast
from holdfast.baselines.msf import MSF_TUNING
from holdfast.baselines.tsif import TSIF_TUNING
from holdfast.bench.replay import describe_machine
from holdfast.config.load import resolved_yaml
from holdfast.errors import ConfigError
from holdfast.messages import Array
from holdfast.paper.job import is_done, run_file, run_job
from holdfast.paper.latency import measure
from holdfast.paper.results import (
    Latency,
    Results,
    Run,
    latency_from_json,
    run_from_json,
    save,
    to_json,
)
from holdfast.paper.study import QUICK, TASKS, Job, plan
from holdfast.sim.scenario import load_scenario
from holdfast.trial.pool import processes, run_all
from holdfast.whole_file import write_whole

SETTINGS, LATENCY = "settings.json", "latency.json"
LATENCY_S, QUICK_LATENCY_S = 120.0, 12.0
# neither makes a number: tables, maps and pages are drawn anew from the runs each time
OTHER_ROOMS = {"cli", "fleet", "lidar_odometry", "live", "report", "viz"}
DRAWING = {"effort", "losses", "maps", "page", "page_figures", "page_tables", "picture", "tables"}

Progress = Callable[[int, int], None]
"""Takes how many runs are done, and how many there are."""


def evaluate(  # noqa: PLR0917 (what the command line asks for)
    output: Path, seeds: int, quick: bool, jobs: int, command: str, progress: Progress | None = None
) -> Results:
    """Run what is not done yet, and return and save everything.

    Args:
        output: folder of the results.
        seeds: simulations of each of the paper's tasks.
        quick: short recordings, few variations.
        jobs: processes at a time.
        command: that asked for it.
        progress: called every now and then.

    Raises:
        ConfigError: the folder holds results of another kind or version.
        OSError: a file cannot be written.
    """
    planned = plan(seeds, quick)
    scenarios = claim(output, quick)
    count = sum(len(job.tasks) for job in planned)
    run_jobs(planned, output, jobs, None if progress is None else lambda done, _: progress(done, count + 1))
    latency = _latency(output, quick)  # the one more
    if progress is not None:
        progress(count + 1, count + 1)
    runs, curves = _collect(planned, output)
    results = Results(
        command=command,
        quick=quick,
        seeds=seeds,
        machine=describe_machine(),
        versions=_versions(),
        scenarios=scenarios,
        tunings={"msf": asdict(MSF_TUNING), "tsif": asdict(TSIF_TUNING)},
        runs=tuple(runs),
        latency=latency,
        latency_scenario=f"navigation, seed 0, {QUICK_LATENCY_S if quick else LATENCY_S:g} s",
        curves=curves,
    )
    save(results, output)
    return results


def run_jobs(planned: Sequence[Job], output: Path, jobs: int, progress: Progress | None = None) -> None:
    """Run all jobs; the first that raises stops the others.

    Raises:
        OSError: a file cannot be written.
        HoldfastError: a process was killed.
    """
    files = [run_file(output, job, task) for job in planned for task in job.tasks]
    open_jobs = [job for job in planned if not all(is_done(output, job, task) for task in job.tasks)]
    if not open_jobs:
        return
    lost = f"{output}: a process of the evaluation was killed (out of memory?); what is done is kept: run it again"

    def report(_: list[None]) -> None:
        if progress is not None:
            progress(sum(file.exists() for file in files), len(files))

    # the folder is of this process: the others may be ended
    with TemporaryDirectory(prefix="holdfast-paper-") as scratch, processes(jobs, lost) as pool:
        run_all(pool, [partial(run_job, job, output, Path(scratch)) for job in open_jobs], report)


def claim(output: Path, quick: bool) -> dict[str, str]:
    """Refuse a folder whose runs were made with other settings or by other code; write into a new one what is run.

    Returns the scenarios, resolved, by name.

    Raises:
        ConfigError: the folder holds results of another kind or version.
    """
    scenarios = {
        name: resolved_yaml(load_scenario(name, dict(QUICK[name]) if quick else {})) for name in (*TASKS, "tunnel")
    }
    digest = sha256("\n".join(scenarios.values()).encode()).hexdigest()
    mine = {
        "quick": quick,
        "scenarios": digest,
        "code": code_digest(Path(holdfast.__file__).parent),
        "versions": _versions(),
    }
    path = output / SETTINGS
    if path.exists():
        try:
            theirs = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            theirs = None
        if theirs != mine:
            changed = [key for key in mine if not isinstance(theirs, dict) or theirs.get(key) != mine[key]]
            raise ConfigError(
                f"{output}: holds runs with other {' and '.join(changed)}; choose another folder, or remove this one"
            )
    else:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(mine, indent=1))
    return scenarios


def code_digest(root: Path) -> str:
    """Return the digest of all code of the package in a folder that a number can come from; a version hides changes."""
    digest = sha256()
    for file in sorted(root.rglob("*.py")):
        room, *_ = path = file.relative_to(root).parts
        if room not in OTHER_ROOMS and not (room == "paper" and file.stem in DRAWING):
            digest.update("/".join(path).encode() + file.read_bytes())
    return digest.hexdigest()


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("holdfast", "gtsam", "numpy", "scipy")}


def _latency(output: Path, quick: bool) -> tuple[Latency, ...]:
    """Return what was measured before, or measure it now, while nothing else runs here."""
    path = output / LATENCY
    if path.exists():
        return tuple(latency_from_json(one) for one in json.loads(path.read_text(encoding="utf-8")))
    measured = measure("navigation", {"duration_s": QUICK_LATENCY_S if quick else LATENCY_S, "faults": []})
    write_whole(path, json.dumps(to_json(measured)))
    return measured


def _collect(planned: Sequence[Job], output: Path) -> tuple[list[Run], dict[str, dict[str, Array]]]:
    runs: list[Run] = []
    curves: dict[str, dict[str, Array]] = {}
    for job in planned:
        for task in job.tasks:
            path = run_file(output, job, task)
            plain: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            run = run_from_json(plain)
            runs.append(run)
            if path.with_suffix(".npz").exists():
                with np.load(path.with_suffix(".npz")) as archive:
                    curves[run.name] = {name: archive[name] for name in archive.files}
    return runs, curves
