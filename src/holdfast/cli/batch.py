"""`holdfast batch`: many recordings or variations side by side, results in one table."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.cli.replay import check_window
from holdfast.cli.terminal import guarded_console
from holdfast.errors import ConfigError, HoldfastError
from holdfast.output_folder import continued, naming_the_output

if TYPE_CHECKING:
    from rich.table import Table

    from holdfast.fleet.plan import Job
    from holdfast.fleet.run import Outcome

MAX_ROWS = 30  # of the table on the screen; of more runs, those that run or failed come first
STYLES = {"done": "green", "failed": "red", "running": "yellow"}


@click.command()
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("-c", "--config", required=True, type=click.Path(path_type=Path), help="Configuration (YAML).")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder of all results.")
@click.option("--jobs", type=click.IntRange(min=1), help="Replays at a time on this machine.  [default: 1]")
@click.option("--vary", multiple=True, metavar="KEY=A,B,...", help="Values of the configuration; several multiply.")
@click.option("--scheduler", metavar="tcp://...", help="Run on a dask.distributed cluster that sees the same files.")
@click.option("--hold-out", multiple=True, metavar="SENSOR=N", help="As for `holdfast replay`.")
@click.option("--duration", type=float, metavar="SECONDS", help="As for `holdfast replay`.")
@click.option("--strict", is_flag=True, help="As for `holdfast replay`.")
def batch(  # noqa: PLR0917 (click passes the options by name)
    recordings: tuple[Path, ...],
    config: Path,
    output: Path,
    jobs: int | None,
    vary: tuple[str, ...],
    scheduler: str | None,
    hold_out: tuple[str, ...],
    duration: float | None,
    strict: bool,
) -> None:
    """Replay RECORDINGS, each under every variation, side by side in processes of their own.

    With --vary graph.lag_s=1.5,3 --vary graph.nodes=imu,measurement each recording is replayed four times.

    Each run has a folder in the output folder, and results.csv a row per run; it is written anew after each. A run that
    fails does not stop the others. Runs that are done already, with the same recording and configuration, are skipped,
    so an interrupted batch goes on when it is started again. Where the folder of a recording has the truth of a
    simulation, the table has the errors.
    """
    from holdfast.fleet.plan import Variation, plan
    from holdfast.fleet.run import kept_outcome
    from holdfast.replay.held_out import HoldOut

    if scheduler is not None and jobs is not None:
        raise ConfigError("--jobs: with --scheduler the cluster decides how many run at a time")
    check_window(0.0, duration)
    rules = [HoldOut.parse_every(text) for text in hold_out]
    options = [word for rule in hold_out for word in ("--hold-out", rule)]
    options += [] if duration is None else ["--duration", f"{duration:g}"]
    options += ["--strict"] * strict
    planned = plan(recordings, config, [Variation.parse(text) for text in vary], output, options, rules=rules)
    outcomes = {job.name: kept_outcome(job) for job in planned}
    todo = [job for job in planned if outcomes[job.name].state != "done"]
    skipped = len(planned) - len(todo)
    with naming_the_output(output), continued(output, "batch", [*recordings, config]):
        _run(planned, todo, outcomes, output, jobs or 1, scheduler)
    failed = [outcome for outcome in outcomes.values() if outcome.state == "failed"]
    done = sum(outcome.state == "done" for outcome in outcomes.values())
    click.echo(f"{done} of {len(planned)} runs done, {skipped} of them before; {len(failed)} failed")
    click.echo(f"written to {output}: results.csv, and a folder per run")
    if failed:
        raise HoldfastError(f"{len(failed)} of {len(planned)} runs failed")


def _run(  # noqa: PLR0917
    planned: "Sequence[Job]",
    todo: "Sequence[Job]",
    outcomes: "dict[str, Outcome]",
    output: Path,
    jobs: int,
    scheduler: str | None,
) -> None:
    """Run what is left to do, and keep the table up to date: also with what an interruption met at its end."""
    from holdfast.fleet.run import kept_outcome
    from holdfast.fleet.schedulers import run_locally, run_on_cluster
    from holdfast.fleet.table import rows_of, write_table

    coming = run_locally(todo, output, jobs) if scheduler is None else run_on_cluster(todo, output, scheduler)
    write_table(rows_of(planned, outcomes), output)
    told: set[str] = set()
    try:
        with _table_on_screen(planned, outcomes), closing(coming):
            for outcome in coming:
                outcomes[outcome.name] = outcome
                told.add(outcome.name)
                write_table(rows_of(planned, outcomes), output)
                if not sys.stderr.isatty():
                    click.echo(f"{outcome.name}: {outcome.state} {outcome.reason}".rstrip(), err=True)
    except KeyboardInterrupt:
        outcomes.update((job.name, kept_outcome(job)) for job in todo if job.name not in told)
        write_table(rows_of(planned, outcomes), output)
        raise


@contextmanager
def _table_on_screen(planned: "Sequence[Job]", outcomes: "Mapping[str, Outcome]") -> Iterator[None]:
    """Show on a terminal how far each run is; nothing in a pipe."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.live import Live

    from holdfast.fleet.run import kept_outcome

    def table() -> "Table":
        waiting = {job.name for job in planned if outcomes[job.name].state not in ("done", "failed")}
        now = {job.name: kept_outcome(job) if job.name in waiting else outcomes[job.name] for job in planned}
        return progress_table(list(now.values()))

    with Live(get_renderable=table, console=guarded_console(stderr=True), refresh_per_second=1):
        yield


def progress_table(outcomes: "Sequence[Outcome]") -> "Table":
    """Return how far the runs are, as a table for a terminal."""
    from rich.markup import escape
    from rich.table import Table

    counts = ", ".join(
        f"{sum(outcome.state == state for outcome in outcomes)} {state}"
        for state in ("done", "running", "failed", "waiting")
    )
    table = Table("run", "state", "time \\[s]", "horizontal RMS \\[m]", "why", title=f"{counts} of {len(outcomes)}")
    order = ("running", "failed", "done", "stopped", "waiting")
    chosen = outcomes
    if len(outcomes) > MAX_ROWS:
        chosen = sorted(outcomes, key=lambda outcome: order.index(outcome.state))[:MAX_ROWS]
    for outcome in chosen:
        rms = outcome.errors.get("horizontal_m")
        style = STYLES.get(outcome.state, "")
        table.add_row(
            escape(outcome.name),
            f"[{style}]{outcome.state}[/]" if style else outcome.state,
            f"{outcome.wall_s:.0f}" if outcome.wall_s else "",
            "" if rms is None else f"{rms:.3f}",
            escape(outcome.reason),
        )
    return table
