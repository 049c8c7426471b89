"""What a replay has written, read again: the other end of `Outputs`."""

import csv
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import RecordingError
from holdfast.evaluation import quaternions
from holdfast.evaluation.absolute import ape
from holdfast.evaluation.association import associate
from holdfast.messages import Array
from holdfast.recording.raw import RawBag
from holdfast.recording.tum import read_tum
from holdfast.replay.batch_outputs import CAUSAL
from holdfast.replay.measurements import MEASUREMENTS, innovation_scores, read_measurements
from holdfast.replay.outputs import ESTIMATES, EVENTS
from holdfast.replay.reference import BIASES, Reference, read_reference
from holdfast.replay.summary_file import datum_in, is_datum_given, read_summary
from holdfast.report.run_record import Errors, Measurements, RunRecord
from holdfast.ros.messages import BIAS_KEYS
from holdfast.state import Trajectory

SMOOTHED = "smoothed_in_world.tum"
TRUE_SENSORS = (("gyroscope", "rad_s"), ("accelerometer", "m_s2"))
DECIMATION = 10  # one in so many estimates of estimates.mcap is decoded: covariances change slowly
SHOWN = {
    "horizontal_m": "horizontal [m]",
    "vertical_m": "vertical [m]",
    "roll_deg": "roll [deg]",
    "pitch_deg": "pitch [deg]",
    "yaw_deg": "yaw [deg]",
}


class Claims(NamedTuple):
    """What estimates.mcap holds beside the tracks: sigmas (M,) by name, speeds (M,), biases (B, 6), at stamps [ns]."""

    stamps_ns: Array
    sigmas: dict[str, Array]
    speeds: Array
    bias_stamps_ns: Array
    biases: Array


def read_run(folder: Path, reference: Path | None) -> RunRecord:
    """Read what a replay wrote, and judge it by a reference.

    Raises:
        ConfigError: the folder holds no results of a replay.
        RecordingError: a file in it cannot be read, or the reference does not overlap with the estimate in time.
    """
    summary = read_summary(folder)
    causal = folder / CAUSAL if (folder / CAUSAL).is_dir() else folder  # beside the optimum over the recording
    events = read_events(causal)
    world, odometry = (read_tum(causal / f"imu_in_{name}.tum") for name in ("world", "odom"))
    start_ns = int(summary.get("start_ns") or min(int(world.stamps_ns[0]), *(e["stamp_ns"] for e in events)))
    claims, notes = _read_claims(causal / ESTIMATES)
    smoothed = _read_smoothed(causal / SMOOTHED)
    measurements, missing = _read_measurements(causal / MEASUREMENTS)
    truth, errors, true_bias_ns, true_biases = None, None, None, None
    if reference is not None:
        truth = read_reference(reference, datum_in(summary))
        if reference.is_dir():
            true_bias_ns, true_biases = _read_true_biases(reference / BIASES)
        errors = errors_against(world, truth, start_ns)
        missing += [truth.note] if truth.note else _in_doubt(truth, summary)
    judged = "" if reference is None else f" --reference {reference}"
    made = summary.get("command") or f"holdfast replay {summary['recording']} -c CONFIG -o {folder}"
    return RunRecord(
        name=Path(summary["recording"]).name,
        command=f"{made}; holdfast report {folder}{judged}",
        start_ns=start_ns,
        summary=summary,
        events=events,
        times_s=(world.stamps_ns - start_ns) * np.float64(1e-9),
        world=world.positions,
        odometry=odometry.positions,
        attitude=_attitude_deg(world),
        correction=_correction(world, odometry),
        sigma_times_s=(claims.stamps_ns - start_ns) * 1e-9,
        sigmas=claims.sigmas,
        speeds=claims.speeds,
        bias_times_s=(claims.bias_stamps_ns - start_ns) * 1e-9,
        biases=claims.biases,
        true_bias_times_s=None if true_bias_ns is None else (true_bias_ns - start_ns) * np.float64(1e-9),
        true_biases=true_biases,
        optimum=np.zeros((0, 3)) if causal is folder else read_tum(folder / "imu_in_world.tum").positions,
        reference=None if truth is None else _of_the_time(truth.poses, world),
        smoothed_times_s=np.zeros(0) if smoothed is None else (smoothed.stamps_ns - start_ns) * np.float64(1e-9),
        smoothed=np.zeros((0, 3)) if smoothed is None else smoothed.positions,
        measurements=measurements,
        scores=[score for name, of in measurements.items() for score in innovation_scores(name, of)],
        errors=errors,
        seed=summary.get("simulation", {}).get("seed", ""),
        notes=[*notes, *missing, *summary["warnings"]],
    )


def read_events(folder: Path) -> list[dict[str, Any]]:
    """Read events.jsonl; a line that a killed run left unfinished is left out.

    Raises:
        RecordingError: there is none, or it holds something else.
    """
    file = folder / EVENTS
    events: list[dict[str, Any]] = []
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise RecordingError(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise RecordingError(f"{file}: is not UTF-8 text") from None
    for number, line in enumerate(lines, start=1):
        try:
            event = json.loads(line)
            _ = event["stamp_ns"] + 0, event["kind"], event["sensor"], event["reason"]
        except (json.JSONDecodeError, TypeError, KeyError):
            if number == len(lines):
                break
            raise RecordingError(f"{file}:{number}: is no event") from None
        events.append(event)
    return events


def _read_claims(file: Path) -> tuple[Claims, list[str]]:
    """Read covariances and biases; without the file they are left out, and a note is returned."""
    stamps: list[int] = []
    rows: list[list[float]] = []
    bias_stamps: list[int] = []
    biases: list[list[float]] = []
    notes: list[str] = []
    try:
        with RawBag(file) as bag:
            codecs = {channel: channel.codec() for channel in bag.channels}
            seen = 0
            for arrival_ns, channel, raw in bag.messages():
                if channel.topic.endswith("/odometry/world"):
                    seen += 1
                    if seen % DECIMATION == 1:
                        stamps.append(arrival_ns)
                        rows.append(_claimed(codecs[channel].deserialize(raw)))
                elif channel.topic == "/diagnostics":
                    statuses = codecs[channel].deserialize(raw).status
                    values = {pair.key: pair.value for status in statuses for pair in status.values}
                    if all(key in values for key in BIAS_KEYS):
                        bias_stamps.append(arrival_ns)
                        biases.append([float(values[key]) for key in BIAS_KEYS])
    except RecordingError as error:
        notes.append(f"Standard deviations and biases are left out: {error}.")
    table = np.array(rows).reshape(-1, len(SHOWN) + 1)
    sigmas = dict(zip(SHOWN.values(), table.T, strict=False))
    return Claims(np.array(stamps), sigmas, table[:, -1], np.array(bias_stamps), np.array(biases).reshape(-1, 6)), notes


def _claimed(odometry: Any) -> list[float]:
    """Return the sigmas of `SHOWN` that an Odometry claims, and the speed [m/s].

    Its rotations are about the axes of W; roll and pitch are about those axes turned by the yaw.
    """
    covariance = odometry.pose.covariance.reshape(6, 6)
    at = odometry.pose.pose.orientation
    yaw = float(quaternions.roll_pitch_yaw_rad(np.array([[at.x, at.y, at.z, at.w]]))[0, 2])
    axes = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    tilt = np.diag(axes @ covariance[3:5, 3:5] @ axes.T)
    variances = np.array([covariance[0, 0] + covariance[1, 1], covariance[2, 2], *tilt, covariance[5, 5]])
    velocity = odometry.twist.twist.linear
    in_units = np.sqrt(variances) * [1.0, 1.0, *np.degrees(np.ones(3))]
    return [*in_units.tolist(), float(np.linalg.norm([velocity.x, velocity.y, velocity.z]))]


def _read_smoothed(file: Path) -> Trajectory | None:
    """Read the smoothed track; None where none was written, or no node has left the window."""
    return read_tum(file) if file.is_file() and file.stat().st_size else None


def _read_measurements(file: Path) -> tuple[dict[str, Measurements], list[str]]:
    """Read measurements.csv; without it fixes and innovations are left out, and a note is returned."""
    try:
        return read_measurements(file), []
    except RecordingError as error:
        return {}, [f"Fixes and innovations are left out: {error}."]


def _read_true_biases(file: Path) -> tuple[NDArray[np.int64], Array]:
    """Read stamps (T,) [ns] and true biases (T, 6) of the gyroscope, then the accelerometer."""
    axes = [f"{sensor}_{axis}_{unit}" for sensor, unit in TRUE_SENSORS for axis in "xyz"]
    try:
        with file.open(encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        stamps = np.array([int(row["stamp_ns"]) for row in rows], dtype=np.int64)
        return stamps, np.array([[float(row[axis]) for axis in axes] for row in rows]).reshape(-1, 6)
    except OSError as error:
        raise RecordingError(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except (KeyError, TypeError, ValueError):
        raise RecordingError(f"{file}: is no table of biases (allowed: that of `holdfast simulate`)") from None


def _in_doubt(reference: Reference, summary: dict[str, Any]) -> list[str]:
    """Return a note if nothing says that the world of a reference is the one that began at the first fix."""
    if reference.is_placed or is_datum_given(summary) or datum_in(summary) is None:
        return []
    return [
        f"{reference.file} does not say where its world is, and that of the run began at its first fix: "
        "where they differ, so do the errors. With frames.datum the run has the world of the reference."
    ]


def errors_against(world: Trajectory, truth: Reference, start_ns: int) -> Errors:
    """Return the errors of an estimate against a reference, by the names of `SHOWN`.

    Raises:
        RecordingError: they do not overlap in time; the text names the file of the reference.
    """
    try:
        pairs = associate(world, truth.poses)
    except RecordingError as error:
        raise RecordingError(f"{truth.file}: {error}") from None
    values = ape(pairs)
    shown = {label: values[name] for name, label in SHOWN.items() if name in values}
    return Errors(str(truth.file), (pairs.reference.stamps_ns - start_ns) * np.float64(1e-9), shown)


def _attitude_deg(world: Trajectory) -> Array:
    """Return roll, pitch, yaw (N, 3) [deg]; yaw goes on beyond 180 deg."""
    angles = quaternions.roll_pitch_yaw_rad(world.quaternions)
    attitude: Array = np.degrees(np.column_stack([angles[:, :2], np.unwrap(angles[:, 2])]))
    return attitude


def _correction(world: Trajectory, odometry: Trajectory) -> Array:
    """Return east, north, up [m] and yaw [deg] (N, 4) of T_W_O = T_W_I T_O_I^-1."""
    q = quaternions.multiply(world.quaternions, quaternions.conjugate(odometry.quaternions))
    moved = world.positions - quaternions.rotate(q, odometry.positions)
    yaw = np.degrees(np.unwrap(quaternions.roll_pitch_yaw_rad(q)[:, 2]))
    return np.column_stack([moved, yaw])


def _of_the_time(truth: Trajectory, world: Trajectory) -> Array:
    """Return the positions of a reference within the time span of the estimate."""
    inside = (truth.stamps_ns >= world.stamps_ns[0]) & (truth.stamps_ns <= world.stamps_ns[-1])
    positions: Array = truth.positions[inside]
    return positions
