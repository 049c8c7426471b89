"""The tables of the paper's report, from its results."""

from collections.abc import Iterator, Sequence
from math import isfinite, isnan, nan
from statistics import fmean

from holdfast.evaluation.mapping import WHOLE
from holdfast.evaluation.measures import MEASURES, Measure
from holdfast.paper.maps import Maps, title
from holdfast.paper.results import Results, Run, by_system
from holdfast.paper.study import TASKS
from holdfast.paper.systems import SYSTEMS, TITLES
from holdfast.paper.tables import OURS, QUANTITIES, Quantity, cell
from holdfast.report.page import Cell, Mark, Table
from holdfast.report.words import ROUTINE, in_words

OTHERS = ("mean", "std", "max")
OF_PAPER = {
    "construction": "The paper against RTK: 1.8 mm mean, 12.8 mm std; TSIF 15.4 mm std, MSF 16.0 mm.",
    "navigation": "The paper has no such table of this task.",
}
OF_PAPER_US = {"paper": "41 ± 15", "msf": "32.9 ± 18.7"}
ABLATED = (
    *("horizontal_rms_m", "vertical_rms_m", "heading_rms_deg"),
    *("outage_horizontal_rms_m", "outage_vertical_rms_m", "outage_heading_rms_deg"),
    *("nees_position", "fallback_nees_position", "settled_s", "step_m"),
)
MEASURE: dict[str, Measure] = {measure.key: measure for measure in MEASURES}


def table_one(results: Results, scenario: str) -> Table:
    """Return Table I: RMS of every quantity and system; the best stands out, and ours where a baseline is better."""
    caption = f"RMS, mean over {_seeds(results)} ± std. Bold: the best. Red: a baseline does better than ours. "
    rows, marks = _by_quantity(results, scenario, ("rms",))
    caption += "Against RTK is the paper's measure: nearer to fixes that were fused is not nearer to the truth. "
    caption += OF_PAPER[scenario]
    return Table(f"table-1-{scenario}", f"Table I, {scenario}", _head(), rows, caption, marks=marks)


def table_one_whole(results: Results, scenario: str) -> Table:
    """Return the mean, standard deviation and maximum of the quantities of `table_one`."""
    caption = f"Mean over {_seeds(results)} ± std; vertical and heading are signed, so that a mean is a bias."
    rows, _ = _by_quantity(results, scenario, OTHERS)
    title = f"Table I, {scenario}: mean, standard deviation, maximum"
    return Table(f"table-1-whole-{scenario}", title, _head(), rows, caption)


def table_two(results: Results) -> Table:
    """Return Table II: the time from an IMU sample to its state."""
    columns = ("mean", "std", "median", "p99", "max")
    rows: list[list[Cell]] = []
    for one in results.latency:
        imu = [None if one.imu_us is None else one.imu_us[column] for column in columns]
        cpu = [None if one.imu_cpu_us is None else one.imu_cpu_us[column] for column in ("mean", "std")]
        cpu.append(None if one.every_cpu_us is None else one.every_cpu_us["mean"])
        update = None if one.update_ms is None else one.update_ms["median"]
        count = None if one.imu_us is None else int(one.imu_us["count"])
        rows.append([TITLES[one.system], *imu, *cpu, update, count, OF_PAPER_US.get(one.system)])
    means = {k: row[1] for k, row in enumerate(rows) if isinstance(row[1], float)}
    marks: dict[tuple[int, int], Mark] = {(min(means, key=lambda k: means[k]), 1): "best"} if means else {}
    caption = (
        f"All systems fed in turn with the same messages, faster than they came: {results.latency_scenario}. CPU: "
        "without the time that other programs took meanwhile. Samples on which a system takes in measurements count "
        "only in `updates too`; the optimiser in its own process (the realtime engine) has none of them. The lidar "
        "odometry alone has no IMU path. Last column: the paper's Table II, C++ on its authors' machine; there TSIF is "
        "slower than the proposed system, with a std of 40 us."
    )
    cpus = ("CPU mean [us]", "CPU std [us]", "CPU mean, updates too [us]")
    head = (
        "system",
        *(f"{column} [us]" for column in columns),
        *cpus,
        "update, median [ms]",
        "samples",
        "paper [us]",
    )
    return Table("table-2", "Table II, latency of the IMU path", head, rows, caption, marks=marks)


def consistency(results: Results) -> Table:
    """Return |propagated - optimised| of both tasks (Fig. 6)."""
    rows: list[list[Cell]] = []
    for scenario in TASKS:
        for system, runs in by_system(results.of("accuracy", scenario)):
            found = [run.corrections_m for run in runs if run.corrections_m is not None]
            if found:
                mean, std = fmean(one.mean for one in found), fmean(one.std for one in found)
                p95, most = fmean(one.p95 for one in found), max(one.max for one in found)
                values = (1e3 * value for value in (mean, std, p95, most))
                rows.append([scenario, SYSTEMS[system].title, *values])
    caption = "The paper on its navigation task: 5.8 mm mean, 31.6 mm std. Target: 3 and 15 mm."
    head = ("task", "system", "mean [mm]", "std [mm]", "p95 [mm]", "max [mm]")
    return Table("figure-6-table", "Fig. 6, |propagated − optimised|", head, rows, caption)


def targets(results: Results) -> Table:
    """Return every measure that has a target, with the worst of all seeds."""
    rows: list[list[Cell]] = []
    marks: dict[tuple[int, int], Mark] = {}
    for measure in (measure for measure in MEASURES if measure.target):
        cells: list[Cell] = [measure.label, measure.unit, measure.target]
        for scenario in TASKS:
            values = [run.scores.get(measure.key, nan) for run in results.of("accuracy", scenario, OURS)]
            worst = measure.worst(values)
            applies = not measure.only or scenario in measure.only
            if applies and not isnan(worst):
                marks[len(rows), len(cells)] = "reached" if measure.is_reached(worst, scenario) else "missed"
            cells.append(measure.text(worst) if applies else None)
        rows.append(cells)
    head = ("measure", "unit", "target", *(f"{scenario}, worst seed" for scenario in TASKS))
    return Table("targets", "Targets of ours", head, rows, marks=marks)


def outages(results: Results) -> Table:
    """Return every outage of seed 0, for every system."""
    rows: list[list[Cell]] = [
        [
            scenario,
            SYSTEMS[run.system].title,
            f"{one.start_s:.0f} to {one.end_s:.0f}",
            1e3 * one.horizontal_rms_m,
            1e3 * one.vertical_rms_m,
            one.heading_rms_deg,
            one.settled_s,
            one.regained_s,
        ]
        for scenario in TASKS
        for run in _of_first_seed(results, "accuracy", scenario)
        for one in run.outages
    ]
    head = (
        "task",
        "system",
        "outage [s]",
        "horizontal [mm]",
        "vertical [mm]",
        "heading [deg]",
        "below 2 cm after [s]",
        "GNSS used after [s]",
    )
    return Table(
        "outages", "Outages one by one, seed 0", head, rows, "RMS within the outage, and the recovery from it."
    )


def ablation(results: Results, scenario: str) -> Table | None:
    """Return the ablation of a task: ours, and ours with one part changed; None if it was not run."""
    runs = _of_first_seed(results, "ablation", scenario)
    if not runs:
        return None
    default = [run for run in _of_first_seed(results, "accuracy", scenario) if run.system in (OURS, "paper")]
    named = [("default" if run.system == OURS else "paper's rules", run) for run in default]
    named += [(run.variation, run) for run in runs]
    rows: list[list[Cell]] = [
        [
            name,
            *(_score(run, MEASURE[key]) for key in ABLATED),
            None if run.update_ms is None else run.update_ms["median"],
        ]
        for name, run in named
    ]
    labels = (f"{MEASURE[key].label} [{MEASURE[key].unit}]" for key in ABLATED)
    head = ("variation", *labels, "update, median [ms]")
    return Table(f"ablation-{scenario}", f"Ablation, {scenario}, seed 0", head, rows)


def maps_table(maps: Maps) -> Table:
    """Return the quality of the maps, as a whole and by region."""
    regions = [name for name in dict.fromkeys(name for score in maps for name in score.closeness) if name != WHOLE]
    rows: list[list[Cell]] = []
    for score in maps:
        near = score.closeness.get(WHOLE)
        found = [score.closeness.get(name) for name in (WHOLE, *regions)]
        percents = [None if one is None else 100.0 * one.fraction_within for one in found]
        ends = (None, None, None) if near is None else (near.points, 1e3 * near.median_m, 1e3 * near.p95_m)
        rows.append([score.scenario, title(score), *ends, *percents])
    caption = (
        "Distance of the map to the true surface; the map of the true poses shows the limit of the lidar. Target: "
        "within 5 cm a larger fraction than every baseline, and at most 2 points less than the true poses."
    )
    head = ("task", "poses of", "points", "median [mm]", "p95 [mm]", "within 5 cm [%]", *(f"{r} [%]" for r in regions))
    return Table("maps", "Maps against the site's mesh", head, rows, caption)


def switches(results: Results, scenario: str) -> Table:
    """Return the events of ours, in words."""
    rows: list[list[Cell]] = [
        [f"{at_s:.2f}", in_words({"kind": kind, "sensor": sensor, "reason": reason})]
        for run in _of_first_seed(results, "accuracy", scenario)
        for at_s, kind, sensor, reason in run.events
        if run.system == OURS and kind not in ROUTINE
    ]
    return Table(f"switches-{scenario}", f"Events, {scenario}, seed 0", ("time [s]", "event and reason"), rows)


def about(results: Results) -> Iterator[Table]:
    """Yield the machine, and the tuning of the baselines."""
    machine: list[list[Cell]] = [[key, str(value)] for key, value in results.machine.items()]
    yield Table("machine", "The machine", ("", ""), machine)
    tuned: list[list[Cell]] = [
        [SYSTEMS[system].title, key, str(value)] for system, of in results.tunings.items() for key, value in of.items()
    ]
    yield Table(
        "tunings",
        "Tuning of the baselines",
        ("system", "setting", "value"),
        tuned,
        "docs/baselines.md gives the reasons.",
    )


def _head() -> tuple[str, ...]:
    return ("", "unit", *(system.title for system in SYSTEMS.values()))


def _by_quantity(
    results: Results, scenario: str, statistics: Sequence[str]
) -> tuple[list[list[Cell]], dict[tuple[int, int], Mark]]:
    """Return a row per quantity and statistic, and which cells of the RMS stand out."""
    rows: list[list[Cell]] = []
    marks: dict[tuple[int, int], Mark] = {}
    for quantity in QUANTITIES:
        for statistic in statistics:
            found = {name: cell(results, scenario, name, quantity, statistic) for name in SYSTEMS}
            label = quantity.label if len(statistics) == 1 else f"{quantity.label}, {statistic}"
            means = {name: round(one.mean, quantity.digits) for name, one in found.items() if not isnan(one.mean)}
            texts = [_with_std(one.mean, one.std, one.runs, quantity) for one in found.values()]
            if len(statistics) == 1:
                marks |= _marks(len(rows), means)
            rows.append([label, quantity.unit, *texts])
    return rows, marks


def _marks(row: int, means: dict[str, float]) -> dict[tuple[int, int], Mark]:
    """Mark the best, all of them if they are equal, and ours where a baseline is better; means as they are shown."""
    order = list(SYSTEMS)
    best = min(means.values(), default=nan)
    marks: dict[tuple[int, int], Mark] = {
        (row, 2 + order.index(name)): "best" for name, mean in means.items() if mean == best
    }
    if any(mean < means.get(OURS, -1.0) for name, mean in means.items() if name != "paper"):
        marks[row, 2 + order.index(OURS)] = "missed"
    return marks


def _with_std(mean: float, std: float, runs: int, quantity: Quantity) -> Cell:
    if isnan(mean):
        return None
    text = f"{mean:.{quantity.digits}f}"
    return text if runs == 1 or not isfinite(std) else f"{text} ± {std:.{quantity.digits}f}"


def _of_first_seed(results: Results, study: str, scenario: str) -> list[Run]:
    return [run for run in results.of(study, scenario) if run.seed == 0]


def _score(run: Run, measure: Measure) -> Cell:
    score = run.scores.get(measure.key, nan)
    return None if isnan(score) else measure.text(score)


def _seeds(results: Results) -> str:
    return f"{results.seeds} seed{'s' * (results.seeds > 1)}"
