"""`holdfast compare`: two replays side by side, what differs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.cli.columns import aligned
from holdfast.cli.command_line import command_line
from holdfast.cli.names import names_of
from holdfast.extras import needing
from holdfast.output_folder import add_results, check_output_file

if TYPE_CHECKING:
    from holdfast.report.comparison import Change, Comparison
    from holdfast.report.page import Cell

MOST_KEYS = 8  # of the configuration on the screen; the page has all


@click.command()
@click.argument("first", metavar="OUT1", type=click.Path(path_type=Path))
@click.argument("second", metavar="OUT2", type=click.Path(path_type=Path))
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    help="Judge both by it: a TUM file, or a truth/ folder. [default: the truth beside a simulated recording]",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="HTML file. [default: OUT2/compare.html]")
def compare(first: Path, second: Path, reference: Path | None, output: Path | None) -> None:
    """Show what differs between the replays whose results are in OUT1 and OUT2.

    Prints a table and writes a page that needs no network: keys of the configuration, errors (at positions that were
    held out, or against a reference), how far the trajectories are apart over time, health, events, counts, timing.
    """
    with needing("a comparison", "report"):
        import plotly  # noqa: F401
    from holdfast.replay.comparison import read_comparison
    from holdfast.report.comparison import comparison_page
    from holdfast.report.page import page_file, write_page

    file = page_file(second / "compare.html" if output is None else output, "--output ")
    one, other = names_of(first, second) if first.resolve() != second.resolve() else (str(first), str(second))
    comparison = read_comparison((first, second), (one, other), reference, command_line())
    for written in (file, file.with_suffix(".json")):
        check_output_file(written, [] if reference is None else [reference])
    write_page(comparison_page(comparison), file)
    add_results(file, file.with_suffix(".json"))
    for line in table_of(comparison):
        click.echo(line)
    click.echo(f"written to {file} and {file.with_suffix('.json').name}")


def table_of(of: "Comparison") -> list[str]:
    """Return the short table for a terminal, and above it what the two have in common."""
    from holdfast.report.comparison import (
        accuracy_rows,
        config_changes,
        count_changes,
        event_changes,
        setting_text,
        summary_line,
        timing_rows,
    )

    keys, chosen = config_changes(of), ("real-time factor", "update, median [ms]")
    parts: list[Sequence[Change]] = [
        [row for row in accuracy_rows(of) if "RMS" in row.what],
        count_changes(of),
        event_changes(of),
        [row for row in timing_rows(of) if row.what in chosen],
    ]
    rows = [["", *of.names]]
    rows += [[row.what, setting_text(row.first), setting_text(row.second)] for row in keys[:MOST_KEYS]]
    rows += [[row.what, _text(row.first), _text(row.second)] for part in parts for row in part]
    more = [f"{len(keys) - MOST_KEYS} more keys differ: see the page"] if len(keys) > MOST_KEYS else []
    return [summary_line(of), *of.notes, *more, *(f"  {line}".rstrip() for line in aligned(rows))]


def _text(value: "Cell") -> str:
    from holdfast.report.page import shown

    return shown(value).replace("\N{EN DASH}", "-")
