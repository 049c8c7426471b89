"""Two folders that replays have written, read for a comparison."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from holdfast.errors import ConfigError, RecordingError
from holdfast.evaluation.absolute import ape
from holdfast.evaluation.association import associate
from holdfast.geometry.earth import Geodetic
from holdfast.recording.tum import read_tum
from holdfast.replay.reference import TRUTH, in_other_world, read_reference
from holdfast.replay.results import SHOWN, errors_against, read_run
from holdfast.replay.summary_file import datum_in, is_datum_given, read_summary
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
    for name, run in zip(names, (one, other), strict=True):
        if len(run.optimum):
            what = "health, events and counts are those of the causal run from which it starts"
            notes.append(f"{name}: the optimum over the recording is shown, and judged; {what}.")
    one, other = (
        _judged_anew(run, track, judge, datum_in(run.summary)) if len(run.optimum) else run
        for run, track, judge in zip((one, other), tracks, judges, strict=True)
    )
    datums = [datum for run in (one, other) if (datum := datum_in(run.summary)) is not None]
    if len(set(datums)) > 1:
        # a datum that somebody gave, and not the first fix, is that of the reference
        kept = 1 if is_datum_given(other.summary) and not is_datum_given(one.summary) else 0
        moved, world = 1 - kept, datums[kept]
        tracks[moved] = in_other_world(tracks[moved], datums[moved], world)
        one, other = (
            _judged_anew(run, track, judge, world)
            for run, track, judge in zip((one, other), tracks, judges, strict=True)
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


def _judged_anew(run: RunRecord, track: Trajectory, judge: Path | None, world: Geodetic | None) -> RunRecord:
    if judge is None:
        return replace(run, world=track.positions)
    errors = errors_against(track, read_reference(judge, world), run.start_ns)
    return replace(run, world=track.positions, errors=errors)


def truth_of(folder: Path) -> Path | None:
    """Return the truth beside the recording of a replay, if that was simulated and the truth is still there."""
    summary = read_summary(folder)
    truth = Path(summary["recording"])
    truth = (truth if truth.is_dir() else truth.parent) / "truth"
    return truth if summary.get("simulation") and (truth / TRUTH).exists() else None
