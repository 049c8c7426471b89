"""The report of one replay: the track, its errors, the health, and why the estimator switched.

From plain arrays only: the files of a replay are read by a higher room. Importing it needs plotly.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.report.figures import (
    COLOURS,
    Band,
    Line,
    Panel,
    Span,
    counts_over_time,
    histogram,
    over_time,
    quantiles,
    time_line,
    track_map,
)
from holdfast.report.page import Block, Cell, Figure, Page, Provenance, Section, Table, Text, digest
from holdfast.report.run_record import RunRecord
from holdfast.report.timeline import Interval, health_intervals, lost_intervals, trust_intervals
from holdfast.report.words import ROUTINE, in_words

LOST, WARNING, GOOD, START = "#d55e00", "#e69f00", "#009e73", "#9aa5b1"
HEALTH_COLOURS = {
    "nominal": GOOD,
    "gnss_degraded": "#56b4e9",
    "lever_arm": "#0072b2",
    "odometry_lost": "#cc79a7",
    "sensor_lost": "#f0e442",
    "recovering": WARNING,
    "fallback": LOST,
    "imu_gap": "#7a5195",
    "optimiser_reset": "#1d2630",
    "initialising": START,
}
STATISTICS = ("mean", "std", "rms", "median", "p95", "max")
POSITIONS = {"gnss", "prism"}
UNTESTED = {"imu", "base_imu", "joint", "odometry"}  # kinds of sensors that are not lost and regained by a test


def single_run_page(run: RunRecord) -> Page:
    """Return the report of one replay."""
    provenance = Provenance(run.command, run.summary["versions"], digest(run.summary["config"]), run.seed)
    sections = [
        Section("Track", _track(run)),
        Section("Errors", [*_errors(run), *_held_out(run)]),
        Section("Health", _health(run)),
        Section("Events", _switches(run)),
        Section("Measurements", _measurements(run)),
        Section("Odometry frame", _odometry(run)),
        Section("Standard deviations and biases", _claims(run)),
        Section("Speed", _speed(run)),
    ]
    lead = _lead(run)
    return Page(f"Replay of {run.name}", lead, provenance, [section for section in sections if section.blocks])


def _lead(run: RunRecord) -> str:
    distance_m = float(np.linalg.norm(np.diff(run.world, axis=0), axis=1).sum())
    lost = lost_intervals(run.events, run.start_ns, run.end_s)
    without_s = sum(interval.end_s - interval.start_s for interval in lost)
    lead = f"{run.end_s - run.times_s[0]:.0f} s of estimates over {distance_m:.0f} m, "
    if not POSITIONS & set(run.kinds.values()):
        lead += "without GNSS."
    elif lost:
        lead += f"{without_s:.0f} s of them without GNSS in {len(lost)} outage{'s' * (len(lost) > 1)}."
    else:
        lead += "GNSS was never lost."
    if run.errors is not None:
        found = run.errors.values
        rms = [f"{name.split(' [')[0]} {_rms(found[name]):.3g} {_unit(name)}" for name in list(found)[:3]]
        lead += f" RMS error against {run.errors.source}: {', '.join(rms)}."
    return lead if run.summary["finished"] else f"{lead} The replay did not come to its end."


def _track(run: RunRecord) -> list[Block]:
    tracks = [Line("estimate, as it was published", run.world[:, 0], run.world[:, 1])]
    if run.reference is not None:
        tracks.insert(0, Line("reference", run.reference[:, 0], run.reference[:, 1], START, width=5.0))
    inside = _within(run.times_s, lost_intervals(run.events, run.start_ns, run.end_s))
    if inside.any():
        without = np.where(inside[:, None], run.world[:, :2], np.nan)
        tracks.append(Line("estimate without GNSS", without[:, 0], without[:, 1], LOST, width=3.0))
    (e0, n0), (e1, n1) = run.world[0, :2], run.world[-1, :2]
    plot = track_map(tracks, {"start": (float(e0), float(n0)), "end": (float(e1), float(n1))})
    datum = run.summary.get("datum")
    where = "in the frame in which it started"
    if datum is not None:
        where = f"from the datum at {datum['latitude_deg']:.7f} deg N, {datum['longitude_deg']:.7f} deg E"
    notes: list[Block] = [Text(note, note=True) for note in run.notes]
    return [*notes, Figure("track", "Track from above", plot, f"Position of the IMU, {where}.")]


def _errors(run: RunRecord) -> list[Block]:
    if run.errors is None:
        return []
    times_s, values = run.errors.times_s, run.errors.values
    panels = [Panel(name, [*_claimed(run, name), Line("error", times_s, of)]) for name, of in values.items()]
    lost = lost_intervals(run.events, run.start_ns, run.end_s)
    without = _within(times_s, lost)
    parts = {"all": np.ones(len(times_s), dtype=np.bool_)}
    parts |= {"GNSS trusted": ~without, "GNSS lost": without} if without.any() else {}
    rows: list[list[Cell]] = [
        [name, when, *(_statistic(of[where], key) for key in STATISTICS), int(where.sum())]
        for name, of in values.items()
        for when, where in parts.items()
        if where.any()
    ]
    return [
        Table("errors", "Errors", ("error", "when", *STATISTICS, "poses"), rows, f"Against {run.errors.source}."),
        Figure("errors-over-time", "Errors over time", over_time(panels, _bands(lost)),
               "Dotted: three times the standard deviation that the estimator reports."),
    ]  # fmt: skip


def _held_out(run: RunRecord) -> list[Block]:
    """Return the errors at the positions that were held back from the estimator."""
    rows: list[list[Cell]] = [
        [track, part, of["horizontal_m"]["count"], *(of["horizontal_m"][key] for key in ("rms", "p95", "max")),
         *(of["vertical_m"][key] for key in ("rms", "max")), of["nees_per_dof"]]
        for track, parts in run.summary["held_out"].items()
        for part, of in (parts or {}).items()
    ]  # fmt: skip
    head = (
        "track",
        "when",
        "positions",
        "horizontal RMS [m]",
        "p95 [m]",
        "max [m]",
        "vertical RMS [m]",
        "max [m]",
        "NEES / 3",
    )
    caption = "The positions have errors of their own. Causal: as published; smoothed: as it left the window."
    return [Table("held-out", "Errors at held-out positions", head, rows, caption)] if rows else []


def _health(run: RunRecord) -> list[Block]:
    intervals = {"health": health_intervals(run.events, run.start_ns, run.end_s)}
    tested = [name for name, kind in run.kinds.items() if kind not in UNTESTED]
    intervals |= trust_intervals(run.events, run.start_ns, run.end_s, tested)
    spans = [Span(row, i.start_s, i.end_s, _colour(i), _in_words(i)) for row, of in intervals.items() for i in of]
    used = {interval.name for of in intervals.values() for interval in of}
    legend = {name: colour for name, colour in HEALTH_COLOURS.items() if name in used}
    plot = time_line(list(intervals), spans, legend, run.end_s)
    seconds = dict.fromkeys(HEALTH_COLOURS, 0.0)
    for interval in intervals["health"]:
        seconds[interval.name] = seconds.get(interval.name, 0.0) + interval.end_s - interval.start_s
    total = sum(seconds.values()) or 1.0
    rows: list[list[Cell]] = [[name, s, 100.0 * s / total] for name, s in seconds.items() if s > 0.0]
    caption = "A sensor is green while it is trusted. The health is the worst condition at a time."
    return [
        Figure("health", "Health and trust over time", plot, caption),
        Table("health-fractions", "Time in each health", ("health", "time [s]", "fraction [%]"), rows),
    ]


def _switches(run: RunRecord) -> list[Block]:
    rows: list[list[Cell]] = [
        [f"{run.seconds(event):.2f}", in_words(event)] for event in run.events if event["kind"] not in ROUTINE
    ]
    caption = "Single measurements that were rejected or late are counted below; events.jsonl has each of them."
    return [Table("switches", "Switches and their reasons", ("time [s]", "event and reason"), rows, caption)]


def _measurements(run: RunRecord) -> list[Block]:
    outcomes = sorted({name for of in run.summary["counts"].values() for name in of})
    rows: list[list[Cell]] = [
        [sensor, *(of.get(name, 0) for name in outcomes)] for sensor, of in run.summary["counts"].items()
    ]
    columns = ("sensor", *(name.replace("_", " ") for name in outcomes))
    blocks: list[Block] = [Table("outcomes", "Outcomes by sensor", columns, rows)]
    rejected: dict[str, list[float]] = {}
    for event in run.events:
        if event["kind"] in ("rejected", "late"):
            why = "late" if event["kind"] == "late" else str(event["reason"]).replace("_", " ")
            rejected.setdefault(f"{event['sensor']}: {why}", []).append(run.seconds(event))
    if rejected:
        times = {name: np.array(of) for name, of in sorted(rejected.items(), key=lambda item: -len(item[1]))}
        plot = counts_over_time(times, run.end_s, "measurements")
        blocks.append(Figure("rejected", "Rejected and late measurements over time", plot, "Per 1/120 of the time."))
    return blocks


def _odometry(run: RunRecord) -> list[Block]:
    lost = _bands(lost_intervals(run.events, run.start_ns, run.end_s))
    names = ("east", "north", "up")
    where = [Line(name, run.times_s, run.correction[:, k]) for k, name in enumerate(names)]
    panels = [Panel("T_W_O [m]", where), Panel("T_W_O yaw [deg]", [Line("yaw", run.times_s, run.correction[:, 3])])]
    departures = {name: _departure(track) for name, track in (("in W", run.world), ("in O", run.odometry))}
    lines = [Line(name, run.times_s[2:], np.maximum(1e3 * of, 1e-4)) for name, of in departures.items()]
    rows: list[list[Cell]] = [
        [name, *(1e3 * float(np.quantile(of, q)) for q in (0.5, 0.99, 1.0))] for name, of in departures.items()
    ]
    caption = "T_W_O takes every correction in W: a consumer of poses in O never sees one."
    why = "Distance of each estimate from the straight continuation of the two before it: acceleration, or a jump."
    return [
        Figure("correction", "The odometry frame in the world", over_time(panels, lost), caption),
        Figure("departure", "Steps", over_time([Panel("departure [mm]", lines, "log")], lost), why),
        Table("departures", "Departure from the straight continuation",
              ("frame", "median [mm]", "p99 [mm]", "max [mm]"), rows),
    ]  # fmt: skip


def _claims(run: RunRecord) -> list[Block]:
    lost = _bands(lost_intervals(run.events, run.start_ns, run.end_s))
    blocks: list[Block] = []
    if len(run.sigma_times_s):
        panels = [Panel(name, [Line("sigma", run.sigma_times_s, of)], "log") for name, of in run.sigmas.items()]
        blocks.append(Figure("sigmas", "Standard deviations as reported", over_time(panels, lost)))
    if len(run.bias_times_s):
        panels = [Panel("gyroscope [rad/s]", _bias_lines(run, 0)), Panel("accelerometer [m/s²]", _bias_lines(run, 3))]
        caption = "" if run.true_biases is None else "Dotted: the truth of the simulation."
        blocks.append(Figure("biases", "Biases of the IMU, as estimated", over_time(panels, lost), caption))
    return blocks


def _bias_lines(run: RunRecord, first: int) -> list[Line]:
    """Return the lines of three axes, and those of the truth where it is known."""
    lines = []
    for k, axis in enumerate("xyz"):
        lines.append(Line(axis, run.bias_times_s, run.biases[:, first + k], COLOURS[k]))
        if run.true_biases is not None and run.true_bias_times_s is not None:
            lines.append(Line(f"{axis}, true", run.true_bias_times_s, run.true_biases[:, first + k], COLOURS[k], "dot"))
    return lines


def _speed(run: RunRecord) -> list[Block]:
    timing = run.summary["timing"]
    found = {"IMU sample": (timing["imu_us"], 1.0), "message with an update": (timing["update_ms"], 1e3)}
    known = {name: (of, factor) for name, (of, factor) in found.items() if of}
    keys = ("mean", "median", "p90", "p99", "max")
    rows: list[list[Cell]] = [
        [name, *(factor * of[key] for key in keys), of["count"]] for name, (of, factor) in known.items()
    ]
    factor = timing["real_time_factor"]
    pace = "" if factor is None else f" The replay ran at {factor:.1f} x real time."
    caption = f"How long the estimator took for one message, in one process.{pace}"
    columns = ("message", *(f"{key} [us]" for key in keys), "count")
    blocks: list[Block] = [Table("latency", "Time per message", columns, rows, caption)]
    binned = {
        name: (scale * np.array(of["histogram"]["edges"]), np.array(of["histogram"]["counts"]))
        for name, (of, scale) in known.items()
        if "histogram" in of
    }
    if binned:
        return [*blocks, Figure("latencies", "Distribution", histogram(binned, "time per message [us]"))]
    of_all = {name: {key: scale * of[key] for key in keys[1:]} for name, (of, scale) in known.items()}
    return (
        [*blocks, Figure("latencies", "Percentiles", quantiles(of_all, "time per message [us]"))] if of_all else blocks
    )


def _claimed(run: RunRecord, name: str) -> list[Line]:
    """Return three times the reported sigma of an error as a line, and its mirror where the error has a sign."""
    if name not in run.sigmas or run.errors is None:
        return []
    signs = (1.0, -1.0) if (run.errors.values[name] < 0.0).any() else (1.0,)
    sigma = run.sigmas[name]
    return [Line("3 sigma, reported", run.sigma_times_s, 3.0 * sign * sigma, "#5f6b7a", "dot", 1.0) for sign in signs]


def _within(times_s: Array, intervals: Sequence[Interval]) -> NDArray[np.bool_]:
    """Return which times (N,) are within one of the intervals."""
    found = np.zeros(len(times_s), dtype=np.bool_)
    for interval in intervals:
        found |= (times_s >= interval.start_s) & (times_s < interval.end_s)
    return found


def _departure(positions: Array) -> Array:
    """Return |p_k - 2 p_{k-1} + p_{k-2}| (N - 2,) of positions (N, 3) [m]."""
    departure: Array = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=1)
    return departure


def _bands(intervals: Sequence[Interval]) -> list[Band]:
    return [Band(interval.start_s, interval.end_s, LOST, "without GNSS") for interval in intervals]


def _colour(interval: Interval) -> str:
    known = HEALTH_COLOURS | {"trusted": GOOD, "lost": LOST}
    return known.get(interval.name, WARNING)


def _in_words(of: Interval) -> str:
    return f"{of.start_s:.1f} to {of.end_s:.1f} s: {of.name.replace('_', ' ')}. {of.why}".strip()


def _statistic(values: Array, name: str) -> float:
    return {
        "mean": float(values.mean()),
        "std": float(values.std()),
        "rms": _rms(values),
        "median": float(np.median(values)),
        "p95": float(np.quantile(np.abs(values), 0.95)),
        "max": float(np.abs(values).max()),
    }[name]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _unit(name: str) -> str:
    return name.partition("[")[2].rstrip("]")
