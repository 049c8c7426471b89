"""The output of `holdfast evaluate` for several systems: one table, one file of numbers, one figure."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from holdfast.errors import ConfigError, RecordingError
from holdfast.whole_file import write_whole

if TYPE_CHECKING:
    from rich.console import Console

    from holdfast.evaluation.accuracy import Metrics
    from holdfast.evaluation.alignment import AlignmentName
    from holdfast.evaluation.side_by_side import System

ABSOLUTE = (("horizontal_m", "rms"), ("horizontal_m", "p95"), ("horizontal_m", "max"), ("vertical_m", "rms"))


def judge_systems(
    files: Mapping[str, Path], reference: Path, alignment: str, metrics: "Metrics", lengths_m: Sequence[float]
) -> "list[System]":
    """Read and judge several estimates.

    Raises:
        ConfigError: several alignments are asked for, or as `side_by_side`.
        RecordingError: a file cannot be read, or as `side_by_side`.
    """
    from holdfast.cli.evaluate import reference_in
    from holdfast.evaluation.side_by_side import side_by_side
    from holdfast.recording.tum import read_tum
    from holdfast.replay.reference import datum_of, in_other_world

    if alignment == "all":
        raise ConfigError("--align all: is for one estimate; of several, choose none, yaw or se3")
    estimates = {name: read_tum(file) for name, file in files.items()}
    datums = {name: datum for name, file in files.items() if (datum := datum_of(file)) is not None}
    world = next(iter(datums.values()), None)
    for name, datum in datums.items():
        if world is not None and datum != world:
            estimates[name] = in_other_world(estimates[name], datum, world)
    poses = reference_in(reference, world)
    try:
        return side_by_side(estimates, poses, cast("AlignmentName", alignment), metrics, lengths_m)
    except RecordingError as error:
        raise RecordingError(f"{error} (reference: {reference})") from None


def print_systems(systems: "Sequence[System]", reference: Path, console: "Console") -> None:
    """Print the systems side by side."""
    from rich.markup import escape

    from holdfast.cli.evaluate import empty_table

    whole = systems[0].accuracy.scores["all"]
    alignment = systems[0].accuracy.alignment.name
    console.print(f"reference  {reference}", markup=False)
    console.print(
        f"compared   {whole.pairs} poses that all have, over {whole.end_s - whole.start_s:.1f} s, "
        f"{whole.end.driven_m:.1f} m driven"
    )
    console.print()
    horizontal = ("horiz.\nrms \\[m]", "horiz.\np95 \\[m]", "horiz.\nmax \\[m]")
    columns = ("system", "own\nposes", *horizontal, "vert.\nrms \\[m]", "yaw\nrms \\[deg]", "horiz.\nEND \\[m]")
    absolute = empty_table(f"Absolute error, alignment {alignment}", columns, console)
    for system in systems:
        score = system.accuracy.scores["all"]
        yaw = score.ape.get("yaw_deg")
        cells = [f"{getattr(score.ape[name], key):.4f}" for name, key in ABSOLUTE]
        cells += ["-" if yaw is None else f"{yaw.rms:.3f}", f"{score.end.horizontal_m:.4f}"]
        absolute.add_row(escape(system.name), str(system.own_pairs), *cells)
    console.print(absolute)
    lengths = list(dict.fromkeys(name for system in systems for name in system.segment_statistics()))
    if lengths:
        console.print()
        relative = empty_table("Relative error over segments, translation rms [m]".replace("[", "\\["),
                         ("system", *lengths), console)  # fmt: skip
        for system in systems:
            found = system.segment_statistics()
            cells = [f"{found[name].rms:.4f}" if name in found else "-" for name in lengths]
            relative.add_row(escape(system.name), *cells)
        console.print(relative)
    if absent := [name for length_m in systems[0].segments if (name := f"{length_m:g} m") not in lengths]:
        console.print(f"over {', '.join(absent)}: the track is too short")
    if "KITTI" in systems[0].accuracy.scores["all"].rpe:
        console.print()
        _print_kitti(systems, console)
    for name in list(systems[0].accuracy.scores)[1:]:
        console.print()
        _print_interval(systems, name, console)


def _print_kitti(systems: "Sequence[System]", console: "Console") -> None:
    from rich.markup import escape

    from holdfast.cli.evaluate import empty_table

    found = {system.name: system.accuracy.scores["all"].rpe["KITTI"] for system in systems}
    if not any(found.values()):
        console.print("segments of KITTI, 100 to 800 m: the track is too short")
        return
    columns = ("system", "translation \\[%]", "rotation \\[deg/m]")
    means = empty_table("Segments of KITTI, 100 to 800 m, mean", columns, console)
    for name, summary in found.items():
        values = (summary.get(key) for key in ("translation_percent", "rotation_deg_per_m"))
        means.add_row(escape(name), *("-" if value is None else f"{value.mean:.4f}" for value in values))
    console.print(means)


def _print_interval(systems: "Sequence[System]", name: str, console: "Console") -> None:
    from rich.markup import escape

    from holdfast.cli.evaluate import empty_table

    score = systems[0].accuracy.scores[name]
    columns = ("system", "horiz. rms \\[m]", "vert. rms \\[m]", "horiz. END \\[m]")
    rows = empty_table(f"Interval {escape(name)}, {score.start_s:.1f} to {score.end_s:.1f} s", columns, console)
    for system in systems:
        of = system.accuracy.scores[name]
        values = of.ape["horizontal_m"].rms, of.ape["vertical_m"].rms, of.end.horizontal_m
        rows.add_row(escape(system.name), *(f"{value:.4f}" for value in values))
    console.print(rows)


def write_systems(
    path: Path, systems: "Sequence[System]", files: Mapping[str, Path], reference: Path, metrics: "Metrics"
) -> None:
    """Write every number.

    Raises:
        ConfigError: the file cannot be written.
    """
    from holdfast import __version__

    content: dict[str, Any] = {
        "holdfast": __version__,
        "reference": str(reference),
        "alignment": systems[0].accuracy.alignment.name,
        "metrics": asdict(metrics),
        "systems": {system.name: {"file": str(files[system.name]), **system.to_json()} for system in systems},
    }
    write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
