"""`holdfast paper`: the evaluation of the paper, rebuilt on simulated recordings whose truth is known."""

from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

import click

from holdfast.cli.columns import aligned
from holdfast.cli.progress import count_bar, duration
from holdfast.errors import ConfigError
from holdfast.extras import how_to_install, needing
from holdfast.output_folder import continued, naming_the_output

if TYPE_CHECKING:
    from holdfast.paper.effort import Effort
    from holdfast.paper.results import Results

SEEDS = 10


@click.command()
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder for the results.")
@click.option("--quick", is_flag=True, help="Short recordings and few variations: minutes, for a first look.")
@click.option(
    "--seeds", type=click.IntRange(min=1), help=f"Simulate each task so many times. [default: {SEEDS}; quick: 1]"
)
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Processes at a time.")
def paper(output: Path, quick: bool, seeds: int | None, jobs: int) -> None:
    """Run every system on the paper's two tasks and print its tables.

    Systems: ours, ours by the rules of the paper, MSF, TSIF, and the lidar odometry alone. Besides Tables I and II come
    the data of Figs. 3, 4 and 6, ablations, the sensitivity to delays and clock offsets, and the growth of errors in
    outages.

    Writes results.json, curves.npz, the maps of the sites, outage.png and report.html, which needs no network. What has
    been run is kept in the folder: the same command goes on where it was interrupted, and more --seeds add to those
    that there are. --quick takes one to three minutes on two idle cores, the whole more than an hour; before it begins
    the command tells what is left to do and about how long that takes.
    """
    with needing("the paper's evaluation", "sim"):
        from holdfast.paper.effort import effort
        from holdfast.paper.evaluation import claim, evaluate
    count = seeds or (1 if quick else SEEDS)
    command = f"holdfast paper -o {output.name}" + " --quick" * quick + f" --seeds {count}"
    with naming_the_output(output), continued(output, "paper"):
        claim(output, quick)  # before anything is told of what it holds
        todo, began_s = effort(output, count, quick, jobs), monotonic()
        click.echo(announced(todo), err=True)
        with count_bar("evaluating") as progress:
            results = evaluate(output, count, quick, jobs, command, progress)
        if todo.runs:
            _tell_what_it_took(todo, monotonic() - began_s)
        print_tables(results)
        made, failures = _report(results, output, quick, jobs)
    click.echo(f"written to {output}: {', '.join(['results.json', 'curves.npz', *made])}")
    if failures:
        raise ConfigError("\n".join(failures))


def _tell_what_it_took(todo: "Effort", taken_s: float) -> None:
    cost = taken_s * todo.at_once / todo.recorded_s
    click.echo(f"{todo.runs} runs took {duration(taken_s)}, {cost:.2f} s of a processor per second recorded", err=True)


def announced(todo: "Effort") -> str:
    """Return in one line what is to be done and how long that may take."""
    if not todo.runs:
        return "all runs are there already: tables, maps and pages are made anew"
    low_s, high_s = todo.range_s()
    crowded = f"; other work makes that {todo.crowding:.1f} times as long as on an idle machine" * (todo.crowding > 1.5)
    return (
        f"{todo.runs} runs on {todo.recorded_s:.0f} s of recordings, {todo.at_once} at a time: roughly "
        f"{duration(low_s)} to {duration(high_s)}{crowded}. Interrupted, it goes on where it was."
    )


def _report(results: "Results", output: Path, quick: bool, jobs: int) -> tuple[list[str], list[str]]:
    """Make the maps, the page and the picture; return the names of what was made, and what stood against the others."""
    steps: dict[str, Callable[[Results, Path, bool, int], list[str]]] = {
        "maps": _make_maps,
        "report": _write_report,
        "picture": _draw_picture,
    }
    made, failures = [], []
    for name, step in steps.items():
        try:
            with naming_the_output(output):
                made += step(results, output, quick, jobs)
        except ConfigError as error:
            failures.append(f"no {name}: {error}")
        except ModuleNotFoundError as error:
            failures.append(f"no {name}: it needs {error.name}: {how_to_install('sim,report,plot')}")
    return made, failures


def _make_maps(_: "Results", output: Path, quick: bool, jobs: int) -> list[str]:
    from holdfast.paper.maps import make_maps

    with count_bar("mapping") as progress:
        make_maps(output, quick, jobs, progress)
    return ["maps"]


def _write_report(results: "Results", output: Path, *_: object) -> list[str]:
    from holdfast.paper.page import write_report

    page = write_report(results, output)
    return [page.name, page.with_suffix(".json").name]


def _draw_picture(results: "Results", output: Path, *_: object) -> list[str]:
    from holdfast.paper.picture import draw_picture

    return [draw_picture(results, output).name]


def print_tables(results: "Results") -> None:
    """Print Tables I and II, the consistency, and where ours loses."""
    from holdfast.paper.losses import accuracy_in_words, consistency_in_words, latency_in_words
    from holdfast.paper.study import TASKS
    from holdfast.paper.tables import consistency_table, failures, table_one, table_two

    seeds = f"{results.seeds} seed{'s' * (results.seeds > 1)}" + ", short recordings" * results.quick
    for task in TASKS:
        _print(f"Table I, {task}: RMS, mean over {seeds}; against RTK as in the paper", table_one(results, task))
    _print(f"Table II, IMU sample to state: {results.latency_scenario}", table_two(results))
    _print("Fig. 6, |propagated - optimised|, navigation", consistency_table(results))
    for line in (*(accuracy_in_words(results, task) for task in TASKS), *latency_in_words(results)):
        click.echo(line)
    for line in consistency_in_words(results):
        click.echo(line)
    for line in failures(results):
        click.echo(f"failed: {line}")


def _print(title: str, rows: Sequence[Sequence[str]]) -> None:
    click.echo(title)
    for line in aligned(rows):
        click.echo(f"  {line}")
    click.echo("")
