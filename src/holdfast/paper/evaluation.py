"""The whole evaluation: every job in a pool of processes, the latencies alone, and the results in one file.

What is done is kept: a finished run is a file, and an evaluation that was interrupted goes on where it stopped.
"""

import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict
from hashlib import sha256
from importlib.metadata import version
from multiprocessing import active_children, get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import holdfast
from holdfast.baselines.msf import MSF_TUNING
from holdfast.baselines.tsif import TSIF_TUNING
from holdfast.config.load import resolved_yaml
from holdfast.errors import ConfigError, HoldfastError
from holdfast.messages import Array
from holdfast.paper.job import Lent, is_done, run_file, run_job
from holdfast.paper.latency import measure
from holdfast.paper.results import (
    Latency,
    Results,
    Run,
    latency_from_json,
    run_from_json,
    save,
    to_json,
    write_whole,
)
from holdfast.paper.study import QUICK, TASKS, Job, plan
from holdfast.replay.benchmark import describe_machine
from holdfast.sim.scenario import load_scenario

SETTINGS, LATENCY = "settings.json", "latency.json"
LATENCY_S, QUICK_LATENCY_S = 120.0, 30.0
POLL_S = 0.5
# tables, maps and pages are drawn anew from the runs each time
ROOMS = ("baselines", "config", "estimator", "evaluation", "geometry", "graph", "recording", "replay", "sensors", "sim")
FILES = ("curves", "job", "latency", "stream", "study", "systems", "verdict")
MAKES_RUNS = ("*.py", *(f"{room}/**/*.py" for room in ROOMS), *(f"paper/{name}.py" for name in FILES))

Progress = Callable[[int, int], None]
"""Is told how many runs are done, and how many there are."""


def evaluate(  # noqa: PLR0917 (what the command line asks for)
    output: Path, seeds: int, quick: bool, jobs: int, lent: Lent, command: str, progress: Progress | None = None
) -> Results:
    """Run what is not done yet, and return and save everything.

    Args:
        output: folder of the results.
        seeds: simulations of each of the paper's tasks.
        quick: short recordings, few variations.
        jobs: processes at a time.
        lent: what the command line lends.
        command: that asked for it.
        progress: called every now and then.

    Raises:
        ConfigError: the folder holds results of another kind or version.
        OSError: a file cannot be written.
    """
    planned = plan(seeds, quick, lent.variations)
    scenarios = {
        name: resolved_yaml(load_scenario(name, dict(QUICK[name]) if quick else {})) for name in (*TASKS, "tunnel")
    }
    _claim(output, quick, scenarios)
    run_jobs(planned, output, jobs, lent, progress)
    latency = _latency(output, quick, lent)
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


def run_jobs(planned: Sequence[Job], output: Path, jobs: int, lent: Lent, progress: Progress | None = None) -> None:
    """Run all jobs; the first that raises stops the others.

    Raises:
        OSError: a file cannot be written.
        HoldfastError: a process was killed.
    """
    files = [run_file(output, job, task) for job in planned for task in job.tasks]
    open_jobs = [job for job in planned if not all(is_done(output, job, task) for task in job.tasks)]
    if not open_jobs:
        return
    # one process per core is enough: no threads below it; the processes inherit this
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with TemporaryDirectory(prefix="holdfast-paper-") as scratch:  # of this process: the others may be ended
        others = active_children()
        pool = ProcessPoolExecutor(jobs, get_context("spawn"))
        waiting: set[Future[None]] = set()
        try:
            with _deaf_to_interrupts():
                waiting = {pool.submit(run_job, job, output, lent, Path(scratch)) for job in open_jobs}
            while waiting:
                done, waiting = wait(waiting, timeout=POLL_S, return_when=FIRST_EXCEPTION)
                for future in done:
                    future.result()
                if progress is not None:
                    progress(sum(file.exists() for file in files), len(files))
        except BrokenProcessPool:
            raise HoldfastError(
                f"{output}: a process of the evaluation was killed (out of memory?); what is done is kept: run it again"
            ) from None
        finally:
            pool.shutdown(wait=not waiting, cancel_futures=True)
            for process in set(active_children()).difference(others) if waiting else ():
                process.terminate()
                process.join()


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Start processes that do not hear Ctrl-C: this one answers, and ends them."""
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # is inherited
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def _claim(output: Path, quick: bool, scenarios: Mapping[str, str]) -> None:
    """Refuse a folder whose runs were made in another way, or by other code; say in a new one what is run."""
    digest = sha256("\n".join(scenarios.values()).encode()).hexdigest()
    mine = {"quick": quick, "scenarios": digest, "code": _code_digest(), "versions": _versions()}
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
        return
    write_whole(path, json.dumps(mine, indent=1).encode())


def _code_digest() -> str:
    """Return what changes with any line that makes a run: the version does not, while somebody works on the code."""
    root = Path(holdfast.__file__).parent
    digest = sha256()
    for file in sorted(file for place in MAKES_RUNS for file in root.glob(place)):
        digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    return digest.hexdigest()


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("holdfast", "gtsam", "numpy", "scipy")}


def _latency(output: Path, quick: bool, lent: Lent) -> tuple[Latency, ...]:
    """Return what was measured before, or measure it now, while nothing else runs here."""
    path = output / LATENCY
    if path.exists():
        return tuple(latency_from_json(one) for one in json.loads(path.read_text(encoding="utf-8")))
    measured = measure("navigation", {"duration_s": QUICK_LATENCY_S if quick else LATENCY_S, "faults": []}, lent)
    write_whole(path, json.dumps(to_json(measured)).encode())
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
