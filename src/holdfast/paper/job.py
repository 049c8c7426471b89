"""Runs one job in a process of its own: simulate once, run every task on it, and write each result when it is there."""

import json
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from holdfast.config.model import Config
from holdfast.errors import EstimatorError
from holdfast.paper.curves import Curves
from holdfast.paper.results import Run, to_json, write_columns
from holdfast.paper.stream import OutcomeLog, disturbed
from holdfast.paper.study import Job, Task
from holdfast.paper.systems import SYSTEMS, configured
from holdfast.paper.verdict import all_curves, verdict
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import PublishedRecorder
from holdfast.sim.configuration import configuration_data
from holdfast.sim.recorder import write_recording
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import START_NS, Simulation, simulate
from holdfast.state import Trajectory
from holdfast.trial.truth import truth
from holdfast.trial.variations import VARIATIONS, changed
from holdfast.whole_file import write_whole

RUNS, POSES = "runs", ".poses.npz"
TRAJECTORY = [field.name for field in fields(Trajectory)]
Result = tuple[Run, Curves, Trajectory | None]
"""Of one task; curves and poses only where the job keeps them."""


def run_file(output: Path, job: Job, task: Task) -> Path:
    """Return where the result of a task is kept; beside it lie its curves, as .npz, and its poses, as .poses.npz."""
    return output / RUNS / job.name / f"{task.name}.json"


def is_done(output: Path, job: Job, task: Task) -> bool:
    """Whether a task has been finished before; one that failed is tried again."""
    try:
        return not json.loads(run_file(output, job, task).read_text(encoding="utf-8"))["failure"]
    except (OSError, ValueError, KeyError, TypeError):
        return False


def kept_poses(output: Path, job: Job, task: Task) -> Trajectory:
    """Return the poses of I in W of a finished task.

    Raises:
        EstimatorError: the task has failed, as it says.
    """
    path = run_file(output, job, task)
    if not is_done(output, job, task):
        raise EstimatorError(json.loads(path.read_text(encoding="utf-8"))["failure"])
    with np.load(path.with_suffix(POSES)) as archive:
        return Trajectory(**{name: archive[name] for name in TRAJECTORY})


def run_job(job: Job, output: Path, scratch: Path | None = None) -> None:
    """Simulate, and run those tasks that are not done.

    Args:
        job: what is run.
        output: folder of the results.
        scratch: folder for the recording, which whoever started this process removes; by default one of its own.

    Raises:
        ConfigError: a file cannot be written, or the scenario or a variation of its configuration cannot be.
    """
    tasks = [task for task in job.tasks if not is_done(output, job, task)]
    if not tasks:
        return
    scenario = load_scenario(job.scenario, dict(job.overrides))
    simulation = simulate(scenario, job.seed)
    given = configuration_data(scenario, job.seed)
    with TemporaryDirectory(prefix="holdfast-paper-", dir=scratch) as folder:
        recording = Path(folder) / "recording.mcap"
        write_recording(simulation, recording, False, None)
        for task in tasks:
            config = configured(task.system, changed(given, VARIATIONS.get(task.variation, {})))
            result, found, poses = _run(job, task, config, simulation, recording)
            path = run_file(output, job, task)
            path.parent.mkdir(parents=True, exist_ok=True)
            if found:
                write_columns(path.with_suffix(".npz"), found)
            if poses is not None:
                write_columns(path.with_suffix(POSES), {name: getattr(poses, name) for name in TRAJECTORY})
            write_whole(path, json.dumps(to_json(result)))


def _run(job: Job, task: Task, config: Config, simulation: Simulation, recording: Path) -> Result:
    """Run one system; a system that fails, in whatever way, has failed and does not stop the others."""
    about: dict[str, Any] = {
        "study": task.study,
        "scenario": job.scenario,
        "seed": job.seed,
        "system": task.system,
        "variation": task.variation,
        "duration_s": simulation.scenario.duration_s,
    }
    if task.disturbance is not None:
        d = task.disturbance
        about |= {"sensor": d.kind, "delay_s": d.delay_s, "clock_s": d.clock_s}
    try:
        recorder = PublishedRecorder(config, SYSTEMS[task.system].make(config))
        log = OutcomeLog(recorder.estimator)
        with open_recording(recording) as opened:
            messages = disturbed(opened.read(subscriptions(config)), task.disturbance, config)
            recorder.run(log.watch(messages))
        poses = recorder.published().world.poses
        if not len(poses.stamps_ns):
            raise EstimatorError(f"never started: {recorder.estimator.waiting_for}")
        true = truth(simulation, config, poses.stamps_ns)
        run = Run(**about, **verdict(recorder, true, START_NS))
        return (run, all_curves(recorder, true, log), poses) if job.keep_curves else (run, {}, None)
    except Exception as error:
        kind = "" if isinstance(error, EstimatorError) else f"{type(error).__name__}: "
        return Run(**about, failure=f"{kind}{error}" or type(error).__name__), {}, None
