"""Measures the speed of a replay, each run in a process of its own, and compares it with a committed baseline.

Times depend on the machine; so a floor is measured in the same process: a bare loop in which GTSAM takes in and
propagates the same IMU samples. What is compared between machines are ratios to that floor.
"""

import json
import os
import platform
import resource
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.resource_tracker import ensure_running
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter_ns, process_time
from typing import Any

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.errors import ConfigError, EstimatorError, HoldfastError
from holdfast.evaluation.percentiles import percentiles
from holdfast.lidar_odometry.replayed import ReplayedScans
from holdfast.messages import ImuSample
from holdfast.recording.source import Subscription, open_recording
from holdfast.replay.never_started import never_started
from holdfast.replay.outputs import Outputs
from holdfast.replay.runner import Replay
from holdfast.replay.summary import timing_summary

RATIOS = {
    "imu_path": "IMU sample to estimate, median / floor",
    "update": "update, median / floor",
    "cpu": "CPU time of the replay / floor of its samples",
}
FLOOR_SAMPLES = 5_000
MAX_FACTOR = 1.5  # a ratio may be worse than its baseline by this much, unless the baseline has its own limit

Result = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Job:
    """One run: which recording with which configuration, and whether it writes what a user's replay writes."""

    recording: str
    config: Config
    subscriptions: tuple[Subscription, ...]
    duration_s: float | None = None
    with_outputs: bool = False


def measure(job: Job, progress: Callable[[int], None] | None = None) -> Result:
    """Run a job in a new process, so that its peak of memory is its own; call it from the main thread.

    Args:
        job: what to run.
        progress: called with the arrival [ns] every now and then.

    Returns:
        `timing` as in summary.json, `cpu_s`, `peak_memory_mb`, `floor_us` (per sample) and `ratios`, see `RATIOS`.

    Raises:
        HoldfastError: as the replay raises it; or the process died.
    """
    with TemporaryDirectory(prefix="holdfast-bench-") as folder:  # of this process: the other one may be ended
        return _measure_apart(job, Path(folder), progress)


def _measure_apart(job: Job, folder: Path, progress: Callable[[int], None] | None) -> Result:
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(job, folder, sender), daemon=True)
    try:
        with _holding_interrupts():
            process.start()
        sender.close()
        while True:
            answer = receiver.recv()
            if isinstance(answer, HoldfastError):
                raise answer
            if isinstance(answer, dict):
                return answer
            if progress is not None:
                progress(answer)
    except EOFError:
        process.join()
        raise HoldfastError(f"{job.recording}: the measured process died (exit code {process.exitcode})") from None
    finally:
        if process.pid is not None:
            process.terminate()
            process.join()


@contextmanager
def _holding_interrupts() -> Iterator[None]:
    """Put Ctrl-C off until the end; a process that is started meanwhile never sees it: this one answers."""
    came: list[int] = []
    ensure_running()  # of multiprocessing: later it would unblock the signal
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # is inherited
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))  # for threads that do not block it
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    if came:
        raise KeyboardInterrupt


def _run(job: Job, folder: Path, answers: Connection) -> None:
    try:
        answers.send(_measure_here(job, folder, answers.send))
    except HoldfastError as error:
        answers.send(error)


def _measure_here(job: Job, folder: Path, progress: Callable[[int], None]) -> Result:
    floor_ns = measure_floor(job)
    with (
        open_recording(job.recording) as recording,
        ReplayedScans(job.config, recording.read(job.subscriptions, 0.0, job.duration_s)) as messages,
    ):
        began_s = process_time()  # unlike wall time it does not count what other programs took
        if job.with_outputs:
            with Outputs(folder, job.config) as outputs:
                run = Replay(job.config, outputs)
                run.run(messages, None, progress)
        else:
            run = Replay(job.config)
            run.run(messages, None, progress)
    cpu_s, peak_memory_mb = process_time() - began_s, _peak_memory_mb()
    if not run.estimator.initialised:
        why = never_started(run.estimator.waiting_for, run.estimator.counts, job.config)
        raise EstimatorError(f"{job.recording}: the estimator never started: {why}")
    floor_ns += measure_floor(job)  # before and after: the machine may have become slower meanwhile
    floor_us = percentiles(np.array(floor_ns) * 1e-3)
    timing = timing_summary(run.timing)
    if floor_us is None or timing["imu_us"] is None:
        raise EstimatorError(f"{job.recording}: too short to measure")
    samples = sum(count for (sensor, _), count in run.estimator.counts.items() if sensor == job.config.imu_name)
    ratios = {
        "imu_path": timing["imu_us"]["median"] / floor_us["median"],
        "update": timing["update_ms"]["median"] * 1e3 / floor_us["median"],
        "cpu": cpu_s * 1e6 / (samples * floor_us["median"]),
    }
    return {
        "timing": timing,
        "cpu_s": cpu_s,
        "peak_memory_mb": peak_memory_mb,
        "floor_us": floor_us,
        "ratios": ratios,
    }


def measure_floor(job: Job) -> list[int]:
    """Return how long [ns] GTSAM takes per IMU sample to integrate it and predict the state, and nothing else."""
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    for set_covariance in (params.setAccelerometerCovariance, params.setGyroscopeCovariance):
        set_covariance(np.eye(3) * 1e-4)
    params.setIntegrationCovariance(np.eye(3) * 1e-8)
    bias, start = gtsam.imuBias.ConstantBias(), gtsam.NavState()
    pim = gtsam.PreintegratedImuMeasurements(params, bias)
    took_ns: list[int] = []
    with open_recording(job.recording) as recording:
        imu = [subscription for subscription in job.subscriptions if subscription.sensor == job.config.imu_name]
        last_ns: int | None = None
        for sample in islice(_samples(recording.read(imu, 0.0, job.duration_s)), FLOOR_SAMPLES):
            dt_s = 0.01 if last_ns is None else (sample.stamp_ns - last_ns) * 1e-9
            last_ns = sample.stamp_ns
            if not 0.0 < dt_s < 1.0 or pim.deltaTij() > 1.0:
                pim.resetIntegration()
                continue
            began_ns = perf_counter_ns()
            pim.integrateMeasurement(sample.specific_force, sample.angular_velocity, dt_s)
            pim.predict(start, bias)
            took_ns.append(perf_counter_ns() - began_ns)
    return took_ns


def _samples(messages: Iterator[Any]) -> Iterator[ImuSample]:
    return (message for message in messages if isinstance(message, ImuSample))


def _peak_memory_mb() -> float:
    """Return the largest resident size of this process [MB]."""
    status = Path("/proc/self/status")
    if status.exists():  # ru_maxrss would count the process that started this one
        for line in status.read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024.0**2 if sys.platform == "darwin" else 1024.0)


def describe_machine() -> dict[str, Any]:
    """Return what the times depend on."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text(encoding="utf-8", errors="replace") if cpuinfo.exists() else ""
    models = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    affinity = getattr(os, "sched_getaffinity", None)
    return {
        "cpu": models[0] if models else platform.processor() or platform.machine(),
        "cores": len(affinity(0)) if affinity else os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "gtsam": version("gtsam"),
    }


def make_baseline(result: Result, max_factor: float = MAX_FACTOR) -> Result:
    """Return what a baseline keeps of a result: the ratios, and where they come from."""
    return {
        "max_factor": max_factor,
        "recording": result["recording"],
        "duration_s": result["duration_s"],
        "ratios": {name: run["ratios"] for name, run in result["runs"].items()},
        "machine": result["machine"],
    }


def read_baseline(path: str | Path) -> Result:
    """Read a baseline.

    Raises:
        ConfigError: the file is not there or not what `make_baseline` returns.
    """
    try:
        baseline = json.loads(Path(path).read_text(encoding="utf-8"))
        if float(baseline["max_factor"]) < 1.0:
            raise ConfigError(f"{path}: max_factor is {baseline['max_factor']}: must be 1 or more")
        for ratios in baseline["ratios"].values():
            {name: float(ratios[name]) for name in RATIOS}
        baseline["recording"], baseline["duration_s"]
    except OSError as error:
        raise ConfigError(f"{path}: no baseline ({error.strerror}); --update-baseline writes one") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise ConfigError(f"{path}: is no baseline ({why}); --update-baseline writes one") from None
    return dict(baseline)


def compare(result: Result, baseline: Mapping[str, Any], path: str) -> list[str]:
    """Return one line per ratio that is worse than the baseline by more than its `max_factor`.

    Raises:
        ConfigError: the two are not of the same recording, or have no run in common.
    """
    for key in ("recording", "duration_s"):
        if result[key] != baseline[key]:
            raise ConfigError(f"{path}: is a baseline for {key} {baseline[key]}, this is {result[key]}")
    common = [name for name in result["runs"] if name in baseline["ratios"]]
    if not common:
        raise ConfigError(f"{path}: has no baseline for nodes {', '.join(result['runs'])}")
    allowed = float(baseline["max_factor"])
    lines = []
    for name in common:
        for ratio, meaning in RATIOS.items():
            now, before = result["runs"][name]["ratios"][ratio], float(baseline["ratios"][name][ratio])
            if not now <= allowed * before:
                lines.append(
                    f"nodes {name}: {meaning}: {now:.2f}, the baseline is {before:.2f} (allowed: {allowed:g} x)"
                )
    return lines
