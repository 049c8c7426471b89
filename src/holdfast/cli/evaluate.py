"""`holdfast evaluate`: judge a trajectory against a reference."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click
from click.core import ParameterSource

from holdfast.cli.claimed import as_json, claimed_consistency, print_consistency
from holdfast.cli.metrics import metrics_of
from holdfast.cli.terminal import guarded_console
from holdfast.errors import ConfigError, RecordingError
from holdfast.output_folder import add_results, check_distinct, check_output_file
from holdfast.whole_file import write_whole

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from holdfast.evaluation.absolute import Statistics
    from holdfast.evaluation.accuracy import Accuracy, Metrics
    from holdfast.evaluation.alignment import AlignmentName
    from holdfast.evaluation.association import Pairs
    from holdfast.geometry.earth import Geodetic
    from holdfast.state import Trajectory

_FILE = click.Path(path_type=Path, dir_okay=False)
_STATISTICS = ("mean", "std", "rms", "median", "p95", "max", "count")
_TABLE_COLUMNS = 110  # a narrower terminal wraps lines instead of cutting off digits
_PIPE_WIDTH = 1000


@click.command()
@click.argument("trajectories", metavar="ESTIMATE... REFERENCE", nargs=-1, required=True, type=_FILE)
@click.option(
    "--align",
    "alignment",
    type=click.Choice(["none", "yaw", "se3", "all"]),
    default="none",
    show_default=True,
    help="Move the estimate onto the reference first: not at all, by yaw and translation, or rigidly.",
)
@click.option(
    "--rpe-distance",
    multiple=True,
    type=float,
    default=[10.0],
    help="Relative error over metres [10; of several estimates 10, 20, ... 50 % of the distance].",
)
@click.option("--rpe-time", multiple=True, type=float, default=[1.0], help="Relative error over seconds [1].")
@click.option("--rpe-pairs", type=click.Choice(["all", "consecutive"]), default="all", show_default=True)
@click.option("--kitti", is_flag=True, help="Add the segments of the KITTI odometry benchmark, 100 to 800 m.")
@click.option("--interval", "intervals", multiple=True, metavar="NAME=START:END", help="Seconds into the reference.")
@click.option("--intervals", "intervals_file", type=_FILE, help="YAML or JSON: `name: [start, end]` per line.")
@click.option("--association", type=click.Choice(["interpolate", "nearest"]), default="interpolate", show_default=True)
@click.option("--max-gap-s", type=float, default=0.5, show_default=True, help="Interpolate over no longer gap.")
@click.option("--max-difference-s", type=float, default=0.01, show_default=True, help="For --association nearest.")
@click.option("--reference-offset-s", type=float, default=0.0, help="Is added to the stamps of the reference.")
@click.option(
    "--reference-lever-arm",
    nargs=3,
    type=float,
    default=(0.0, 0.0, 0.0),
    metavar="X Y Z",
    help="Where the reference's point is in the body frame of the estimate [m].",
)
@click.option("--position-only", is_flag=True, help="Do not use the reference's orientation.")
@click.option("--json", "json_file", type=_FILE, help="Write every number to this file.")
@click.option("--plot", "plot_file", type=_FILE, help="Draw tracks and errors: .png, .svg or .pdf.")
@click.pass_context
def evaluate(
    context: click.Context,
    /,
    trajectories: tuple[Path, ...],
    alignment: str,
    json_file: Path | None,
    plot_file: Path | None,
    **options: Any,
) -> None:
    """Judge the trajectory ESTIMATE against REFERENCE, TUM files, over all and in named intervals.

    Several estimates are judged side by side, at the stamps of the reference at which all of them have a pose: one
    table, relative errors over segments, and with --plot the tracks, the errors and a box plot over segments.

    Where a single ESTIMATE has its covariances beside it (`holdfast smooth` writes them), they are judged, too.
    """
    from holdfast.evaluation.plot import check_plot

    *estimates, reference = trajectories
    if not estimates:
        raise click.UsageError("Missing argument 'REFERENCE': give at least one estimate, and the reference last.")
    _check_tolerances(context, options["association"])
    metrics = metrics_of(**options)
    options_of = {"--json": json_file, "--plot": plot_file}
    check_distinct((option, file) for option, file in options_of.items() if file is not None)
    written = [file for file in (json_file, plot_file) if file is not None]
    for file in written:
        check_output_file(file, trajectories)
    if plot_file is not None:
        check_plot(plot_file)
    if len(estimates) == 1:
        _evaluate_one(estimates[0], reference, alignment, metrics, (json_file, plot_file))
    else:
        is_given = context.get_parameter_source("rpe_distance") is not ParameterSource.DEFAULT
        lengths_m = metrics.rpe_distances_m if is_given else ()
        _evaluate_several(estimates, reference, alignment, metrics, lengths_m, (json_file, plot_file))
    add_results(*written)


def _check_tolerances(context: click.Context, association: str) -> None:
    """Refuse a tolerance of the association that was not chosen: it would change nothing.

    Raises:
        ConfigError: names the option.
    """
    for option, of in (("max_gap_s", "interpolate"), ("max_difference_s", "nearest")):
        if association != of and context.get_parameter_source(option) is not ParameterSource.DEFAULT:
            raise ConfigError(f"--{option.replace('_', '-')}: is for --association {of}, not {association}")


def _evaluate_several(  # noqa: PLR0917
    estimates: Sequence[Path],
    reference: Path,
    alignment: str,
    metrics: "Metrics",
    lengths_m: Sequence[float],
    files: tuple[Path | None, Path | None],
) -> None:
    from holdfast.cli.evaluate_systems import judge_systems, print_systems, write_systems
    from holdfast.cli.names import names_of
    from holdfast.evaluation.plot_systems import plot_systems

    places = [one.resolve() for one in estimates]
    if twice := [one for one, place in zip(estimates, places, strict=True) if places.count(place) > 1]:
        raise ConfigError(f"{twice[-1]}: is given twice")
    named = dict(zip(names_of(*estimates), estimates, strict=True))
    systems = judge_systems(named, reference, alignment, metrics, lengths_m)
    for system in systems:
        warn_of_order(system.accuracy.pairs, named[system.name], reference)
    print_systems(systems, reference, _console())
    json_file, plot_file = files
    if json_file is not None:
        write_systems(json_file, systems, named, reference, metrics)
    if plot_file is not None:
        plot_systems(systems, plot_file, f"{len(systems)} systems against {reference.name}, alignment {alignment}")


def _evaluate_one(
    estimate: Path, reference: Path, alignment: str, metrics: "Metrics", files: tuple[Path | None, Path | None]
) -> None:
    from holdfast.evaluation.association import associate
    from holdfast.evaluation.plot import plot_accuracy
    from holdfast.recording.tum import read_tum
    from holdfast.replay.reference import datum_of

    json_file, plot_file = files
    try:
        pairs = associate(read_tum(estimate), reference_in(reference, datum_of(estimate)), metrics.association)
        verdicts = _verdicts(pairs, alignment, metrics)
    except RecordingError as error:
        named = str(error) if str(estimate) in str(error) or str(reference) in str(error) else None
        raise RecordingError(named or f"{estimate} against {reference}: {error}") from error
    warn_of_order(pairs, estimate, reference)
    consistency = claimed_consistency(estimate, pairs, metrics.association.reference_lever_arm)
    _print(verdicts, estimate, reference)
    print_consistency(consistency)
    if json_file is not None:
        _write_json(json_file, verdicts, estimate, reference, metrics, as_json(consistency))
    if plot_file is not None:
        first = verdicts[0]
        plot_accuracy(first, plot_file, f"{estimate.name} against {reference.name}, alignment {first.alignment.name}")


def reference_in(file: Path, datum: "Geodetic | None") -> "Trajectory":
    """Return the poses of a reference in the world about a datum, with a note if they had to be moved there.

    Raises:
        RecordingError: it cannot be read.
    """
    from holdfast.replay.reference import read_reference

    reference = read_reference(file, datum)
    if reference.note:
        click.echo(f"note: {reference.note}", err=True)
    return reference.poses


def warn_of_order(pairs: "Pairs", estimate: Path, reference: Path) -> None:
    """Say on stderr that quaternions look like w x y z, if they do."""
    from holdfast.evaluation.quaternion_order import reordered

    files = [str({"estimate": estimate, "reference": reference}[name]) for name in reordered(pairs)]
    if files:
        click.echo(
            f"warning: {' or '.join(files)}: the quaternions look like w x y z (a TUM file has x y z w): estimate and "
            "reference do not turn alike, and would in that order",
            err=True,
        )


def _verdicts(pairs: "Pairs", alignment: str, metrics: "Metrics") -> "list[Accuracy]":
    """Judge under one alignment or all; of all, one that the tracks do not determine is left out with a note."""
    from holdfast.evaluation.accuracy import score_pairs

    if alignment != "all":
        return [score_pairs(pairs, cast("AlignmentName", alignment), metrics)]
    verdicts = [score_pairs(pairs, "none", metrics)]
    others: tuple[AlignmentName, ...] = ("yaw", "se3")
    for name in others:
        try:
            verdicts.append(score_pairs(pairs, name, metrics))
        except RecordingError as error:
            click.echo(f"note: {error}", err=True)
    return verdicts


def _write_json(  # noqa: PLR0917 (what is written)
    path: Path,
    verdicts: "list[Accuracy]",
    estimate: Path,
    reference: Path,
    metrics: "Metrics",
    consistency: dict[str, Any],
) -> None:
    from holdfast import __version__

    pairs = verdicts[0].pairs
    content = {
        "holdfast": __version__,
        "estimate": str(estimate),
        "reference": str(reference),
        "oriented": pairs.oriented,
        "reference_start_ns": pairs.reference_start_ns,
        "metrics": asdict(metrics),
        "consistency": consistency,
        "alignments": {verdict.alignment.name: verdict.to_json() for verdict in verdicts},
    }
    write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def _console() -> "Console":
    console = guarded_console(highlight=False)
    console.width = max(console.width, _TABLE_COLUMNS if console.is_terminal else _PIPE_WIDTH)
    return console


def _print(verdicts: "list[Accuracy]", estimate: Path, reference: Path) -> None:
    console = _console()
    whole = verdicts[0].scores["all"]
    orientation = "" if verdicts[0].pairs.oriented else "; positions only, there is no orientation to compare"
    console.print(f"estimate   {estimate}", markup=False)
    console.print(f"reference  {reference}", markup=False)
    console.print(
        f"compared   {whole.pairs} poses over {whole.end_s - whole.start_s:.1f} s, "
        f"{whole.end.driven_m:.1f} m driven{orientation}"
    )
    for index, verdict in enumerate(verdicts):
        console.print()
        console.print(_absolute_table(verdict, console))
        # with orientation, relative errors are the same under every alignment
        if index == 0 or not verdict.pairs.oriented:
            console.print()
            console.print(_relative_table(verdict, console))
        if len(verdict.scores) > 1:
            console.print()
            console.print(_interval_table(verdict, console))


def empty_table(title: str, columns: tuple[str, ...], console: "Console") -> "Table":
    """Return an empty table: with rules on a terminal, columns and nothing else in a pipe."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    if not console.is_terminal:
        table.box, table.pad_edge = None, False
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index else "left", no_wrap=True)
    return table


def _absolute_table(verdict: "Accuracy", console: "Console") -> "Table":
    title = f"Absolute error, alignment {verdict.alignment.name}"
    table = empty_table(title, ("error", *_STATISTICS), console)
    for name, statistics in verdict.scores["all"].ape.items():
        table.add_row(_label(name), *_cells(statistics, name))
    return table


def _relative_table(verdict: "Accuracy", console: "Console") -> "Table":
    table = empty_table("Relative error", ("over", "error", *_STATISTICS), console)
    table.columns[1].justify = "left"
    for delta, summary in verdict.scores["all"].rpe.items():
        if not summary:
            table.add_row(delta, "the track is too short", *["-"] * len(_STATISTICS))
        for name, statistics in summary.items():
            table.add_row(delta, _label(name), *_cells(statistics, name))
    return table


def _interval_table(verdict: "Accuracy", console: "Console") -> "Table":
    from rich.markup import escape

    rms = ("horiz.\nrms \\[m]", "vert.\nrms \\[m]", "yaw\nrms \\[deg]")
    ends = ("horiz.\nEND \\[m]", "vert.\nEND \\[m]", "yaw\nEND \\[deg]", "distance\nEND \\[%]")
    columns = ("\ninterval", "\nfrom - to \\[s]", "driven\n\\[m]", *rms, *ends)
    table = empty_table(f"Intervals, alignment {verdict.alignment.name}", columns, console)
    for name, score in verdict.scores.items():
        end, yaw = score.end, score.ape.get("yaw_deg")
        values = (
            (end.driven_m, 1),
            (score.ape["horizontal_m"].rms, 4),
            (score.ape["vertical_m"].rms, 4),
            (yaw.rms if yaw else None, 3),
            (end.horizontal_m, 4),
            (end.vertical_m, 4),
            (end.yaw_deg, 3),
            (end.percent, 3),
        )
        cells = ("-" if value is None else f"{value:.{digits}f}" for value, digits in values)
        table.add_row(escape(name), f"{score.start_s:.1f} - {score.end_s:.1f}", *cells)
    return table


def _label(name: str) -> str:
    """Return `rotation_deg_per_m` as `rotation [deg/m]`, with its brackets escaped for rich."""
    quantity, unit = name.split("_", 1)
    unit = "%" if unit == "percent" else unit.replace("_per_", "/")
    return f"{quantity} \\[{unit}]"


def _cells(statistics: "Statistics", name: str) -> list[str]:
    digits = 5 if "_per_" in name else 4 if name.endswith("_m") else 3
    return [f"{getattr(statistics, key):.{digits}f}" for key in _STATISTICS[:-1]] + [str(statistics.count)]
