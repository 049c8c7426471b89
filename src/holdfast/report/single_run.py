"""The report of one replay: trajectory, accuracy, consistency, health, events, timing.

From plain arrays only: the files of a replay are read by a higher room. Importing it needs plotly.
"""

import numpy as np

from holdfast.messages import Array
from holdfast.report.consistency import consistency
from holdfast.report.figures import (
    Line,
    Panel,
    Span,
    counts_over_time,
    histogram,
    over_time,
    quantiles,
    time_line,
)
from holdfast.report.held_out import COLUMNS, held_out_rows, tracks_in_words
from holdfast.report.outages import LOST, outage_bands, outages, within
from holdfast.report.page import Block, Cell, Clock, Figure, Mark, Page, Provenance, Section, Table, digest
from holdfast.report.run_record import RunRecord
from holdfast.report.timeline import Interval, health_intervals, trust_intervals
from holdfast.report.trajectory import trajectory
from holdfast.report.words import ROUTINE, in_words

WARNING, GOOD, START = "#e69f00", "#009e73", "#9aa5b1"
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
IN_THE_LEAD = ("horizontal [m]", "vertical [m]", "yaw [deg]")
BRIEF_S = 10.0  # outages that are told to a tenth of a second
STATISTICS = ("mean", "std", "rms", "median", "p95", "max")
POSITIONS = {"gnss", "prism"}
UNTESTED = {"imu", "base_imu", "joint", "odometry"}  # kinds of sensors that are not lost and regained by a test


def single_run_page(run: RunRecord) -> Page:
    """Return the report of one replay."""
    provenance = Provenance(run.command, run.summary["versions"], digest(run.summary["config"]), run.seed)
    sections = [
        Section("Trajectory", trajectory(run)),
        Section("Accuracy", [*_errors(run), *_held_out(run)]),
        Section("Consistency", consistency(run)),
        Section("Health", [*_health(run), *_measurements(run), *_loop_closures(run)]),
        Section("Calibration", _learnt(run)),
        Section("Events", _events(run)),
        Section("Timing", _timing(run)),
    ]
    lead = _lead(run)
    clock = Clock(run.start_ns * 1e-9, run.end_s)
    filled = [section for section in sections if section.blocks]
    return Page(f"Replay of {run.name}", lead, provenance, filled, clock)


def _lead(run: RunRecord) -> str:
    distance_m = float(np.linalg.norm(np.diff(run.world, axis=0), axis=1).sum())
    lost = outages(run)
    without_s = sum(interval.end_s - interval.start_s for interval in lost)
    lead = f"{run.end_s - run.times_s[0]:.0f} s of estimates over {distance_m:.0f} m, "
    if not POSITIONS & set(run.kinds.values()):
        lead += "without GNSS."
    elif lost:
        digits = int(without_s < BRIEF_S)
        lead += f"{without_s:.{digits}f} s of them without GNSS in {len(lost)} outage{'s' * (len(lost) > 1)}."
    else:
        lead += "GNSS was never lost."
    if run.errors is not None:
        found = run.errors.values
        told = [name for name in IN_THE_LEAD if name in found]
        rms = [f"{name.split(' [')[0]} {_rms(found[name]):.3g} {_unit(name)}" for name in told]
        lead += f" RMS error against {run.errors.source}: {', '.join(rms)}."
    return lead if run.summary["finished"] else f"{lead} The replay did not come to its end."


def _errors(run: RunRecord) -> list[Block]:
    if run.errors is None:
        return []
    times_s, values = run.errors.times_s, run.errors.values
    panels = [Panel(name, [*_claimed(run, name), Line("error", times_s, of)]) for name, of in values.items()]
    without = within(times_s, outages(run))
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
        Figure("errors-over-time", "Errors over time", over_time(panels, outage_bands(run)),
               "Dotted: three times the standard deviation that the estimator reports."),
    ]  # fmt: skip


def _held_out(run: RunRecord) -> list[Block]:
    """Return the errors at the positions that were held back from the estimator."""
    rows = held_out_rows(run.summary)
    caption = f"The positions have errors of their own. {tracks_in_words(run.summary)}"
    return [Table("held-out", "Errors at held-out positions", COLUMNS, rows, caption)] if rows else []


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


def _events(run: RunRecord) -> list[Block]:
    told = [event for event in run.events if event["kind"] not in ROUTINE]
    rows: list[list[Cell]] = [[f"{run.seconds(event):.2f}", run.utc(event), in_words(event)] for event in told]
    caption = (
        "A click on a row moves every plot there. Single measurements that were rejected or late are counted under "
        "Health; events.jsonl has each of them. UTC is what the recording's clock says."
    )
    times_s = [run.seconds(event) for event in told]
    columns = ("time [s]", "UTC", "event and reason")
    return [Table("switches", "Switches and their reasons", columns, rows, caption, times_s=times_s)]


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


def _loop_closures(run: RunRecord) -> list[Block]:
    found = run.summary.get("smooth", {}).get("loop_closures", {})
    rows: list[list[Cell]] = [[what, count] for what, count in found.items()]
    caption = "Pairs of places that the optimum over the recording has tried to register, and what became of them."
    columns = ("result", "pairs")
    return [Table("loop-closures", "Loop closures", columns, rows, caption)] if rows else []


def _learnt(run: RunRecord) -> list[Block]:
    """Return what was learnt of the sensors beside what the configuration says."""
    keys = "sensor", "what", "unit", "configured", "learnt", "sigma", "key", "write"
    columns = *keys[:-1], "looks wrong, write"
    found = run.summary.get("learnt", [])
    rows: list[list[Cell]] = [[one[key] for key in keys] for one in found]
    marks: dict[tuple[int, int], Mark] = {(k, 4): "missed" for k, one in enumerate(found) if one["looks_wrong"]}
    caption = (
        "A key looks wrong where it is off by a factor of two, or a constant by three sigmas. The estimate has used "
    )
    caption += "what was learnt; with it in the file the next run begins there, as with --learnt."
    return [Table("learnt", "What was learnt", columns, rows, caption, 4, marks)] if rows else []


def _timing(run: RunRecord) -> list[Block]:
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
