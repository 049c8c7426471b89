"""`holdfast info`: what a recording holds and what is wrong with it."""

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from holdfast.cli.progress import reading_bar
from holdfast.cli.replay import check_window
from holdfast.cli.terminal import guarded_console

if TYPE_CHECKING:
    from rich.console import Console

    from holdfast.recording.inspection import Inspection, TopicFindings

PIPE_WIDTH = 160  # a pipe has no width of its own


@click.command()
@click.argument("recording", type=click.Path())
@click.option("--start", "start_s", type=float, default=0.0, metavar="SECONDS", help="Skip the beginning.")
@click.option("--duration", "duration_s", type=float, metavar="SECONDS", help="Read only this much.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for machines.")
def info(recording: str, start_s: float, duration_s: float | None, as_json: bool) -> None:
    """List what RECORDING holds and what is wrong with its clocks.

    RECORDING is a ROS 1 or ROS 2 bag, an .mcap or .db3 file, a folder of CSV files, or `kitti` for the drive that ships
    with gtsam.
    """
    from holdfast.recording.inspection import inspect
    from holdfast.recording.problems import list_problems
    from holdfast.recording.source import open_recording

    check_window(start_s, duration_s)
    with (
        open_recording(recording) as opened,
        reading_bar("reading", opened, start_s, duration_s) as progress,
    ):
        inspection = inspect(opened, start_s, duration_s, progress)
    problems = list_problems(inspection)
    if as_json:
        click.echo(json.dumps(_to_json(inspection, problems), indent=2))
    else:
        _print(inspection, problems)
    if inspection.damage is not None:
        raise inspection.damage


def _to_json(inspection: "Inspection", problems: list[str]) -> dict[str, Any]:
    return {
        "path": inspection.path,
        "start_ns": inspection.start_ns,
        "end_ns": inspection.end_ns,
        "topics": [_topic_json(topic) for topic in inspection.topics],
        "problems": problems,
        "damage": None if inspection.damage is None else str(inspection.damage),
    }


def _topic_json(topic: "TopicFindings") -> dict[str, Any]:
    """Return what was found; the findings in its values stand under the name of the kind."""
    found = asdict(topic)
    values = found.pop("values")
    return found if topic.kind is None or values is None else found | {topic.kind: values}


def _print(inspection: "Inspection", problems: list[str]) -> None:
    plain = not sys.stdout.isatty()
    console = guarded_console(markup=False, highlight=False, width=PIPE_WIDTH if plain else None)
    console.print(_title(inspection))
    _print_table(console, inspection, plain=plain)
    for topic in inspection.topics:
        if topic.values is not None:
            console.print(f"{topic.topic}: {topic.values.summary()}", soft_wrap=True)
    console.print()
    if problems:
        console.print(f"{len(problems)} problem(s):")
    else:
        console.print("No problems found.")
    for problem in problems:
        console.print(f"- {problem}", soft_wrap=True)


def _title(inspection: "Inspection") -> str:
    from datetime import UTC, datetime

    if inspection.start_ns is None:
        return inspection.path
    begin = datetime.fromtimestamp(inspection.start_ns // 1_000_000_000, UTC)
    title = f"{inspection.path}: begins {begin:%Y-%m-%d %H:%M:%S} UTC"
    if inspection.end_ns is None:
        return title
    return f"{title}, lasts {(inspection.end_ns - inspection.start_ns) / 1e9:.3f} s"


def _print_table(console: "Console", inspection: "Inspection", *, plain: bool) -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=None if plain else box.SIMPLE_HEAD, pad_edge=not plain, padding=(0, 2 if plain else 1, 0, 0))
    for name in ("topic", "type"):
        table.add_column(name, overflow="fold")
    for name in (
        "count",
        "rate\n[Hz]",
        "duration\n[s]",
        "longest\ngap [s]",
        "gaps",
        "latency\n[ms]",
        "back/twice/\nearly",
    ):
        table.add_column(name.replace("/\n", "/").replace("\n", " ") if plain else name, justify="right", no_wrap=True)
    for topic in inspection.topics:
        latency = "-"
        if topic.latency_mean_s is not None and topic.latency_sigma_s is not None:
            latency = f"{topic.latency_mean_s * 1e3:.1f}+-{topic.latency_sigma_s * 1e3:.1f}"
        table.add_row(
            topic.topic,
            topic.type if plain else topic.type.rpartition("/")[2],
            str(topic.count),
            _number(topic.rate_hz, 2),
            _number(topic.duration_s, 3),
            _number(topic.longest_gap_s, 3),
            str(topic.gaps),
            latency,
            f"{topic.stamps_back}/{topic.duplicate_stamps}/{topic.arrived_before_stamp}",
        )
    console.print(table)


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"
