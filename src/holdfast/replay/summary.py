"""The summary of a replay: counts, timing, held-out accuracy, versions and the resolved configuration, as JSON."""

import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation.absolute import summarise
from holdfast.evaluation.percentiles import percentiles
from holdfast.recording.origin import read_origin
from holdfast.replay.held_out import Judgement
from holdfast.replay.published import by_sensor
from holdfast.replay.runner import Replay, Timing

RECOVERY_NS = 10_000_000_000  # several fixes must agree with each other before they are trusted again
LOG_BIN_WIDTH = float(np.log(1.2))


def summarise_replay(  # noqa: PLR0917
    replay: Replay,
    recording: str,
    warnings: Sequence[str],
    finished: bool,
    command: str = "",
    missing: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return the content of summary.json.

    Args:
        replay: that has run.
        recording: its path, as it was given.
        warnings: one line each.
        finished: whether it ran to the end.
        command: that asked for it; empty for a program that did.
        missing: why the recording holds nothing of some sensors, by name.
    """
    estimator = replay.estimator
    silent = {judgement.stamp_ns for judgement in replay.causal.judgements if judgement.imu_silent}
    return {
        "command": command,
        "recording": recording,
        "simulation": read_origin(recording),
        "start_ns": replay.first_stamp_ns,
        "finished": finished,
        "initialised": estimator.initialised,
        "waiting_for": None if estimator.initialised else estimator.waiting_for,
        "datum": None if estimator.datum is None else estimator.datum._asdict(),
        "counts": by_sensor(estimator.counts),
        "missing": dict(missing),
        "events": dict(sorted(estimator.event_counts.items())),
        "health": {str(health): count for health, count in sorted(replay.health.items())},
        "timing": timing_summary(replay.timing),
        "held_out": {
            "causal": held_out_summary(replay.causal.judgements, silent),
            "smoothed": held_out_summary(replay.smoothed.judgements, silent),
            **({"batch": held_out_summary(replay.batch.judgements, silent)} if replay.batch.judgements else {}),
        },
        "warnings": list(warnings),
        "versions": {name: version(name) for name in ("holdfast", "gtsam", "numpy", "rosbags")},
        "machine": {
            "python": platform.python_version(),
            "system": platform.platform(),
            "processor": platform.machine(),
        },
        "config": estimator.config.model_dump(mode="json"),
    }


def timing_summary(timing: Timing) -> dict[str, Any]:
    """Return the real-time factor, and percentiles of the time per IMU sample [us] and per update [ms]."""
    return {
        "recorded_s": timing.recorded_s,
        "wall_s": timing.wall_s,
        "real_time_factor": timing.real_time_factor,
        "imu_us": _distribution(np.frombuffer(timing.imu_ns, dtype=np.int64) * 1e-3),
        "update_ms": _distribution(np.frombuffer(timing.update_ns, dtype=np.int64) * 1e-6),
    }


def _distribution(values: NDArray[np.floating[Any]]) -> dict[str, Any] | None:
    """Return the percentiles of values (N,) and their histogram; None if there are none."""
    found = percentiles(values)
    return None if found is None else {**found, "histogram": _histogram(values)}


def _histogram(values: NDArray[np.floating[Any]]) -> dict[str, list[float]]:
    """Return how many values lie between edges that grow by a fifth."""
    low, high = np.log(np.maximum(values.min(), 1e-9)), np.log(np.maximum(values.max(), 1e-9))
    edges = np.exp(np.arange(np.floor(low / LOG_BIN_WIDTH), np.ceil(high / LOG_BIN_WIDTH) + 2.0) * LOG_BIN_WIDTH)
    counts, _ = np.histogram(values, edges)
    return {"edges": [float(f"{edge:.6g}") for edge in edges], "counts": counts.tolist()}


def held_out_summary(judgements: Sequence[Judgement], silent: Collection[int]) -> dict[str, Any] | None:
    """Return the errors at held-out positions by circumstance; None if nothing was held out.

    `silent` holds the stamps of those within a drop-out of the IMU.
    """
    if not judgements:
        return None
    parts = {"all": list(judgements), **by_circumstance(judgements, silent)}
    return {name: _errors(part) for name, part in parts.items() if part}


def by_circumstance(judgements: Sequence[Judgement], silent: Collection[int]) -> dict[str, list[Judgement]]:
    """Return the judgements of each circumstance; each is in one of them.

    `outage`: GNSS was cut; `recovery`: less than `RECOVERY_NS` after that; `imu_gap`: in a drop-out of the IMU; and
    `nominal`, none of these. `silent` holds the stamps in drop-outs.
    """
    parts: dict[str, list[Judgement]] = {"nominal": [], "imu_gap": [], "outage": [], "recovery": []}
    cut_ns = [judgement.stamp_ns for judgement in judgements if judgement.in_outage]
    for one in judgements:
        if one.in_outage:
            parts["outage"].append(one)
        elif any(0 < one.stamp_ns - stamp_ns <= RECOVERY_NS for stamp_ns in cut_ns):
            parts["recovery"].append(one)
        else:
            parts["imu_gap" if one.stamp_ns in silent else "nominal"].append(one)
    return parts


def _errors(judgements: Sequence[Judgement]) -> dict[str, Any]:
    errors = np.array([judgement.error for judgement in judgements])
    horizontal, vertical = summarise(np.hypot(errors[:, 0], errors[:, 1])), summarise(errors[:, 2])
    nees = np.array([judgement.nees for judgement in judgements]) / 3.0
    assert horizontal is not None
    assert vertical is not None
    return {
        "horizontal_m": asdict(horizontal),
        "vertical_m": asdict(vertical),
        "nees_per_dof": None if np.isnan(nees).all() else float(np.nanmean(nees)),
    }
