"""One job of a batch: a `holdfast replay` in a process of its own, isolated from the others."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from holdfast.errors import HoldfastError, RecordingError
from holdfast.fleet.plan import Job
from holdfast.output_folder import replaced
from holdfast.whole_file import write_whole

STATE, LOG, CONFIG, ESTIMATE = "run.json", "run.log", "config.yaml", "imu_in_world.tum"
TRUTH = Path("truth") / ESTIMATE
POLL_S = 0.1
STOP_TIMEOUT_S = 10.0  # in which an interrupted replay writes its results
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
INTERRUPTED = "the batch was interrupted"
STOPPED = {128 + number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}

State = Literal["waiting", "running", "done", "failed", "stopped"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a job.

    Attributes:
        reason: why it failed, in one line.
        errors: RMS against the truth of a simulated recording, by name with its unit.
    """

    name: str
    state: State
    fingerprint: str
    reason: str = ""
    wall_s: float = 0.0
    errors: dict[str, float] = field(default_factory=dict)


def run_job(job: Job, stop_file: Path) -> Outcome:
    """Replay, and keep the outcome beside the results; whatever goes wrong is an outcome too.

    The replay is interrupted when `stop_file` appears, and not begun once it has.
    """
    if stop_file.exists():
        return Outcome(job.name, "stopped", job.fingerprint, INTERRUPTED)
    began = time.monotonic()
    try:
        with replaced(job.folder, "batch", [job.recording]):
            _keep(job, Outcome(job.name, "running", job.fingerprint))
            (job.folder / CONFIG).write_text(job.config_yaml, encoding="utf-8")
            state, reason = _replay(job, stop_file)
            errors = _errors(job) if state == "done" else {}
            outcome = Outcome(job.name, state, job.fingerprint, reason, time.monotonic() - began, errors)
            _keep(job, outcome)
    except (OSError, HoldfastError) as error:
        reason = (
            f"{error.filename or job.folder}: {error.strerror or error}" if isinstance(error, OSError) else f"{error}"
        )
        return Outcome(job.name, "failed", job.fingerprint, reason, time.monotonic() - began)
    return outcome


def kept_outcome(job: Job) -> Outcome:
    """Return the outcome of a job in an earlier or running batch; `waiting` where there is none."""
    waiting = Outcome(job.name, "waiting", job.fingerprint)
    try:
        kept = Outcome(**json.loads((job.folder / STATE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return waiting
    return kept if kept.fingerprint == job.fingerprint else waiting


def _keep(job: Job, outcome: Outcome) -> None:
    """Write the outcome whole: a concurrent reader finds the old one or the new one."""
    write_whole(job.folder / STATE, json.dumps(asdict(outcome), indent=1) + "\n")


def _replay(job: Job, stop_file: Path) -> tuple[State, str]:
    command = [sys.executable, "-m", "holdfast", "replay", str(job.recording)]
    command += ["-c", str(job.folder / CONFIG), "-o", str(job.folder), "--child", *job.arguments]
    with (
        (job.folder / LOG).open("wb") as log,
        # the pipe ends when this process does, however: then the replay ends too
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=log, stderr=log, env=os.environ | ONE_THREAD
        ) as process,
    ):
        try:
            while process.poll() is None:
                if stop_file.exists():
                    return "stopped", INTERRUPTED
                time.sleep(POLL_S)
        finally:
            _end(process)
    if process.returncode == 0:
        return "done", ""
    if process.returncode in STOPPED:  # Ctrl-C in a terminal reaches the replays, too
        return "stopped", INTERRUPTED
    return "failed", _reason(job.folder / LOG, process.returncode)


def _end(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _reason(log: Path, code: int) -> str:
    """Return why a replay failed: its last error, or the signal that ended it."""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    return (errors or lines or [f"exit code {code}"])[-1]


def _errors(job: Job) -> dict[str, float]:
    """Judge the estimate by the truth of a simulated recording in the world of the run, if there is one."""
    folder = job.recording if job.recording.is_dir() else job.recording.parent
    if not (folder / TRUTH).exists():
        return {}
    import numpy as np

    from holdfast.evaluation.absolute import ape
    from holdfast.evaluation.association import associate
    from holdfast.recording.tum import read_tum
    from holdfast.replay.reference import datum_of, read_reference

    estimate = job.folder / ESTIMATE
    try:
        truth = read_reference(folder / TRUTH, datum_of(estimate))
        errors = ape(associate(read_tum(estimate), truth.poses))
    except RecordingError:
        return {}
    names = ("horizontal_m", "vertical_m", "yaw_deg")
    return {name: float(np.sqrt(np.mean(errors[name] ** 2))) for name in names if name in errors}
