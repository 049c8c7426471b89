"""The page about two replays: what differs in configuration, accuracy, trajectory, counts, events, health and timing.

From plain arrays only: the files are read by a higher room. Importing it needs plotly.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.messages import Array
from holdfast.report.figures import COLOURS, GREY, Line, Panel, Span, over_time, time_line, track_map
from holdfast.report.page import Block, Cell, Figure, Mark, Page, Provenance, Section, Table, Text
from holdfast.report.run_record import RunRecord
from holdfast.report.single_run import HEALTH_COLOURS
from holdfast.report.timeline import Interval, health_intervals

FIRST, SECOND = COLOURS[0], COLOURS[1]
ABSENT = "(not there)"
CHANGE = ("difference", "[%]")


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Two replays and how far their trajectories are apart.

    Attributes:
        names: of the two, which differ.
        runs: their results.
        apart_times_s: (N,) seconds since the first run's start.
        apart: second minus first, by name with its unit: each (N,); empty where they do not overlap in time.
        command: that makes the page again.
        notes: what could not be compared, one line each.
    """

    names: tuple[str, str]
    runs: tuple[RunRecord, RunRecord]
    apart_times_s: Array
    apart: Mapping[str, Array]
    command: str
    notes: Sequence[str] = field(default=())


@dataclass(frozen=True, slots=True)
class Change:
    """A value that differs; `what` names it."""

    what: str
    first: Cell
    second: Cell


def comparison_page(of: Comparison) -> Page:
    """Return the page."""
    one, other = of.names
    versions = {f"{name} ({run})": text for run, r in zip(of.names, of.runs, strict=True)
                for name, text in r.summary["versions"].items()}  # fmt: skip
    shared = {name: text for name, text in of.runs[0].summary["versions"].items()
              if of.runs[1].summary["versions"].get(name) == text}  # fmt: skip
    different = {name: text for name, text in versions.items() if name.partition(" (")[0] not in shared}
    sections = [
        Section("Configuration", _configuration(of)),
        Section("Trajectory", _trajectory(of)),
        Section("Accuracy", _accuracy(of)),
        Section("Health", _health(of)),
        Section("Events", _changes_table("events", "Events by kind", event_changes(of), of)),
        Section("Measurements", _changes_table("counts", "Measurements by outcome", count_changes(of), of)),
        Section(
            "Timing",
            _changes_table("timing", "Timing", timing_rows(of), of, "Of this machine, and of what else ran on it."),
        ),
    ]
    lead = f"{one}: {of.runs[0].command.partition(';')[0]}. {other}: {of.runs[1].command.partition(';')[0]}."
    provenance = Provenance(of.command, shared | different)
    return Page(f"{one} against {other}", f"{lead} {summary_line(of)}", provenance, sections)


def summary_line(of: Comparison) -> str:
    """Return what differs in one line."""
    changes = config_changes(of)
    text = f"{len(changes)} key{'s' * (len(changes) != 1)} of the configuration differ{'s' * (len(changes) == 1)}"
    if of.apart:
        horizontal = np.abs(of.apart["horizontal [m]"])
        text += (
            f"; the trajectories are {_rms(horizontal):.3g} m apart horizontally (RMS), {horizontal.max():.3g} at most"
        )
    return f"{text}."


def config_changes(of: Comparison) -> list[Change]:
    """Return the keys of the resolved configurations that differ, as dotted paths."""
    one, other = (dict(_flat(run.summary["config"])) for run in of.runs)
    keys = [*one, *(key for key in other if key not in one)]
    return [
        Change(key, one.get(key, ABSENT), other.get(key, ABSENT))
        for key in keys
        if one.get(key, ABSENT) != other.get(key, ABSENT)
    ]


def count_changes(of: Comparison) -> list[Change]:
    """Return how many measurements of each sensor came to each outcome, where that differs."""
    one, other = (
        {f"{sensor}: {name.replace('_', ' ')}": n for sensor, counts in run.summary["counts"].items()
         for name, n in counts.items()} for run in of.runs
    )  # fmt: skip
    return _differing(one, other)


def event_changes(of: Comparison) -> list[Change]:
    """Return how often each kind of event happened, where that differs."""
    one, other = (_counted(run) for run in of.runs)
    return _differing(one, other)


def timing_rows(of: Comparison) -> list[Change]:
    """Return times per message and the real-time factor of both."""
    one, other = (run.summary["timing"] for run in of.runs)
    rows = [Change("recorded [s]", one["recorded_s"], other["recorded_s"]),
            Change("taken [s]", one["wall_s"], other["wall_s"]),
            Change("real-time factor", one["real_time_factor"], other["real_time_factor"])]  # fmt: skip
    for name, key in (("IMU sample", "imu_us"), ("update", "update_ms")):
        unit = key.rpartition("_")[2]
        rows += [
            Change(f"{name}, {quantile} [{unit}]", one[key][quantile], other[key][quantile])
            for quantile in ("median", "p99", "max")
            if one[key] and other[key]
        ]
    return rows


def accuracy_rows(of: Comparison) -> list[Change]:
    """Return the errors at held-out positions, and those against the reference, of both."""
    rows = []
    one, other = (_held_out(run) for run in of.runs)
    rows += [Change(name, one.get(name), other.get(name)) for name in dict.fromkeys((*one, *other))]
    if of.runs[0].errors is not None and of.runs[1].errors is not None:
        for name, values in of.runs[0].errors.values.items():
            theirs = of.runs[1].errors.values.get(name)
            if theirs is not None:
                label, _, unit = name.partition(" [")
                rows += [
                    Change(f"against the reference, {label} {key} [{unit}", statistic(values), statistic(theirs))
                    for key, statistic in (("RMS", _rms), ("max", _largest))
                ]
    return rows


def _configuration(of: Comparison) -> list[Block]:
    notes: list[Block] = [Text(note, note=True) for note in of.notes]
    recordings = [run.summary["recording"] for run in of.runs]
    if recordings[0] != recordings[1]:
        notes.append(Text(f"The recordings differ: {recordings[0]} and {recordings[1]}.", note=True))
    changes = config_changes(of)
    if not changes:
        return [*notes, Text("Both were made with the same configuration.")]
    caption = "Of the resolved configurations, defaults included; all other keys are equal."
    rows = [[change.what, setting_text(change.first), setting_text(change.second)] for change in changes]
    return [*notes, Table("config", "Keys that differ", ("key", *of.names), rows, caption)]


def setting_text(value: Cell) -> str:
    """Return a setting with all its digits: of a latitude the last ones count."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _trajectory(of: Comparison) -> list[Block]:
    one, other = of.runs
    tracks = [Line(of.names[0], one.world[:, 0], one.world[:, 1], FIRST, width=3.0),
              Line(of.names[1], other.world[:, 0], other.world[:, 1], SECOND)]  # fmt: skip
    if one.reference is not None:
        tracks.insert(0, Line("reference", one.reference[:, 0], one.reference[:, 1], GREY, width=5.0))
    blocks: list[Block] = [
        Figure("tracks", "Tracks from above", track_map(tracks), "Position of the IMU as published.")
    ]
    if not of.apart:
        return blocks
    panels = [Panel(name, [Line("distance", of.apart_times_s, values)]) for name, values in of.apart.items()]
    rows: list[list[Cell]] = [
        [
            name,
            _rms(values),
            float(np.median(np.abs(values))),
            float(np.quantile(np.abs(values), 0.95)),
            _largest(values),
        ]
        for name, values in of.apart.items()
    ]
    columns = ("distance", "rms", "median", "p95", "max")
    return [
        *blocks,
        Figure(
            "apart-over-time",
            "Distance over time",
            over_time(panels),
            f"{of.names[1]} minus {of.names[0]}, at the stamps of the latter.",
        ),
        Table("apart", "Distance between the trajectories", columns, rows),
    ]


def _accuracy(of: Comparison) -> list[Block]:
    rows = accuracy_rows(of)
    if not rows:
        return [
            Text("Neither held-out positions nor a reference: there is nothing to judge by. Replay with --hold-out.")
        ]
    marks: dict[tuple[int, int], Mark] = {}
    for k, row in enumerate(rows):
        values = row.first, row.second
        if "NEES" not in row.what and None not in values and values[0] != values[1]:
            marks[k, 1 if values[0] < values[1] else 2] = "best"  # type: ignore[operator]
    cells = [_cells(row) for row in rows]
    blocks: list[Block] = [
        Table("accuracy", "Errors", ("error", *of.names, *CHANGE), cells, "The smaller one stands out.", marks=marks)
    ]
    one, other = of.runs
    if one.errors is not None and other.errors is not None:
        panels = [
            Panel(name, [Line(of.names[0], one.errors.times_s, values, FIRST),
                         Line(of.names[1], other.errors.times_s, other.errors.values[name], SECOND)])
            for name, values in one.errors.values.items() if name in other.errors.values
        ]  # fmt: skip
        caption = f"Against {one.errors.source}."
        blocks.append(Figure("errors-over-time", "Errors over time", over_time(panels), caption))
    return blocks


def _health(of: Comparison) -> list[Block]:
    intervals = {
        name: health_intervals(run.events, run.start_ns, run.end_s) for name, run in zip(of.names, of.runs, strict=True)
    }
    spans = [
        Span(
            name, i.start_s, i.end_s, HEALTH_COLOURS.get(i.name, GREY), f"{i.start_s:.1f} to {i.end_s:.1f} s: {i.name}"
        )
        for name, found in intervals.items()
        for i in found
    ]
    used = {interval.name for found in intervals.values() for interval in found}
    legend = {name: colour for name, colour in HEALTH_COLOURS.items() if name in used}
    plot = time_line(list(intervals), spans, legend, max(run.end_s for run in of.runs))
    one, other = (_seconds(found) for found in intervals.values())
    rows = [Change(name.replace("_", " "), one.get(name, 0.0), other.get(name, 0.0)) for name in legend]
    caption = "Time in each health [s]."
    return [
        Figure("health", "Health over time", plot),
        *_changes_table("health-seconds", "Time in each health", rows, of, caption),
    ]


def _changes_table(
    key: str, title: str, changes: Sequence[Change], of: Comparison, caption: str = "Only what differs."
) -> list[Block]:
    if not changes:
        return [Text("No difference.")]
    return [Table(key, title, ("", *of.names, *CHANGE), [_cells(change) for change in changes], caption)]


def _cells(change: Change) -> list[Cell]:
    """Return a row: what, both values, second minus first, and that in percent of the first."""
    one, other = change.first, change.second
    if isinstance(one, str) or isinstance(other, str) or one is None or other is None:
        return [change.what, one, other, None, None]
    return [change.what, one, other, other - one, 100.0 * (other - one) / abs(one) if one else None]


def _flat(value: Any, path: str = "") -> list[tuple[str, Cell]]:
    """Return the leaves of nested settings as (dotted path, value)."""
    if isinstance(value, Mapping) and value:
        return [leaf for key, of in value.items() for leaf in _flat(of, f"{path}.{key}".lstrip("."))]
    if isinstance(value, list) and any(isinstance(entry, Mapping) for entry in value):
        named = {
            f"[{entry.get('child', k) if isinstance(entry, Mapping) else k}]": entry for k, entry in enumerate(value)
        }
        return [leaf for key, of in named.items() for leaf in _flat(of, f"{path}{key}")]
    if isinstance(value, bool) or value is None:
        return [(path, str(value).lower() if value is not None else "none")]
    return [(path, value if isinstance(value, int | float | str) else str(value))]


def _differing(one: Mapping[str, int], other: Mapping[str, int]) -> list[Change]:
    names = dict.fromkeys((*one, *other))
    return [
        Change(name, one.get(name, 0), other.get(name, 0)) for name in names if one.get(name, 0) != other.get(name, 0)
    ]


def _counted(run: RunRecord) -> dict[str, int]:
    counts: dict[str, int] = {}
    for event in run.events:
        name = f"{event['kind']} {event['sensor']}".replace("_", " ").strip()
        counts[name] = counts.get(name, 0) + 1
    return dict(sorted(counts.items()))


def _held_out(run: RunRecord) -> dict[str, Cell]:
    found: dict[str, Cell] = {}
    for track, parts in run.summary["held_out"].items():
        for part, errors in (parts or {}).items():
            name = f"held out, {track}, {part}"
            found[f"{name}: horizontal RMS [m]"] = errors["horizontal_m"]["rms"]
            found[f"{name}: horizontal max [m]"] = errors["horizontal_m"]["max"]
            found[f"{name}: vertical RMS [m]"] = errors["vertical_m"]["rms"]
            if errors["nees_per_dof"] is not None:
                found[f"{name}: NEES / 3"] = errors["nees_per_dof"]
    return found


def _seconds(intervals: Sequence[Interval]) -> dict[str, float]:
    seconds: dict[str, float] = {}
    for interval in intervals:
        seconds[interval.name] = seconds.get(interval.name, 0.0) + interval.end_s - interval.start_s
    return seconds


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _largest(values: Array) -> float:
    return float(np.abs(values).max())
