"""Two folders that replays have written, read for a comparison."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from gtsam import SO3

from holdfast.errors import ConfigError, RecordingError
from holdfast.evaluation import quaternions
from holdfast.evaluation.absolute import ape
from holdfast.evaluation.association import associate
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.recording.tum import read_tum
from holdfast.replay.results import SHOWN, TRUTH, errors_against, read_run, read_summary
from holdfast.report.comparison import Comparison
from holdfast.report.run_record import RunRecord
from holdfast.state import Trajectory

WORLD = "imu_in_world.tum"


def read_comparison(
    folders: tuple[Path, Path], names: tuple[str, str], reference: Path | None, command: str
) -> Comparison:
    """Read what two replays wrote, and how far their trajectories are apart.

    Args:
        folders: of the results.
        names: of the two in the page.
        reference: TUM file, or the truth/ folder of a simulation, to judge both by; None for `truth_of` each.
        command: that asked for it.

    Raises:
        ConfigError: the folders are one, or a folder holds no results of a replay.
        RecordingError: a file in it cannot be read, or the reference does not overlap with the estimates in time.
    """
    first, second = folders
    if first.resolve() == second.resolve():
        raise ConfigError(f"{first} and {second} are one folder: there is nothing to compare")
    judges = tuple(reference or truth_of(folder) for folder in folders)
    one, other = (read_run(folder, judge) for folder, judge in zip(folders, judges, strict=True))
    tracks = [read_tum(folder / WORLD) for folder in folders]
    notes = [f"{name}: {note}" for name, run in zip(names, (one, other), strict=True) for note in run.notes]
    datums = [run.summary.get("datum") or {} for run in (one, other)]
    if datums[0] and datums[1] and datums[0] != datums[1]:
        # a datum that somebody gave, and not the first fix, is that of the reference
        kept = 1 if _has_datum(other) and not _has_datum(one) else 0
        moved = 1 - kept
        tracks[moved] = in_other_world(tracks[moved], datums[moved], datums[kept])
        one, other = (
            _judged_anew(run, track, judge) for run, track, judge in zip((one, other), tracks, judges, strict=True)
        )
        notes.append(f"The datums differ: {names[moved]} is shown, and judged, in the world frame of {names[kept]}.")
    times_s, apart = np.zeros(0), {}
    try:
        pairs = associate(tracks[1], tracks[0])
    except RecordingError as error:
        notes.append(f"The trajectories are not compared: {error}.")
    else:
        errors = ape(pairs)
        times_s = (pairs.reference.stamps_ns - one.start_ns) * np.float64(1e-9)
        apart = {label: errors[name] for name, label in SHOWN.items() if name in errors}
    return Comparison(names, (one, other), times_s, apart, command, notes)


def in_other_world(track: Trajectory, datum: Mapping[str, float], other: Mapping[str, float]) -> Trajectory:
    """Return a track that is given in the W of a datum in the W of another one.

    Args:
        track: poses in W.
        datum: latitude_deg, longitude_deg, altitude_m of the origin of W.
        other: the same of the wanted one.
    """
    here, there = LocalFrame(Geodetic(**datum)), LocalFrame(Geodetic(**other))
    origin = there.to_enu(here.to_geodetic(np.zeros(3)))
    axes = [there.to_enu(here.to_geodetic(axis)) - origin for axis in 1000.0 * np.eye(3)]
    turn: Any = gtsam.Rot3(SO3.ClosestTo(np.column_stack(axes) / 1000.0).matrix()).toQuaternion()
    q = np.tile(turn.coeffs(), (len(track.stamps_ns), 1))
    positions = origin + quaternions.rotate(q, track.positions)
    return replace(track, positions=positions, quaternions=quaternions.multiply(q, track.quaternions))


def _has_datum(run: RunRecord) -> bool:
    return bool(run.summary["config"].get("frames", {}).get("datum"))


def _judged_anew(run: RunRecord, track: Trajectory, judge: Path | None) -> RunRecord:
    if judge is None:
        return replace(run, world=track.positions)
    file = judge / TRUTH if judge.is_dir() else judge
    return replace(run, world=track.positions, errors=errors_against(track, read_tum(file), file, run.start_ns))


def truth_of(folder: Path) -> Path | None:
    """Return the truth beside the recording of a replay, if that was simulated and the truth is still there."""
    summary = read_summary(folder)
    truth = Path(summary["recording"])
    truth = (truth if truth.is_dir() else truth.parent) / "truth"
    return truth if summary.get("simulation") and (truth / TRUTH).exists() else None
