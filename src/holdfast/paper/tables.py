"""Tables I and II, and those that the paper does not have, as rows of text."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, isnan, nan
from statistics import fmean, pstdev

from holdfast.paper.results import Results, Run
from holdfast.paper.study import TASKS
from holdfast.paper.systems import ENGINE, SYSTEMS, TITLES

OURS = "holdfast"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A row of Table I.

    Attributes:
        key: part and quantity among `Run.errors`.
        factor: from the unit of the key to that which is shown.
    """

    key: str
    label: str
    unit: str
    factor: float = 1.0
    digits: int = 1


QUANTITIES = (
    Quantity("good/rtk_axes_m", "GNSS good: against RTK, per axis", "mm", 1e3, 2),
    Quantity("good/rtk_m", "GNSS good: distance from RTK", "mm", 1e3),
    Quantity("good/position_m", "GNSS good: position", "mm", 1e3),
    Quantity("good/horizontal_m", "GNSS good: horizontal", "mm", 1e3),
    Quantity("good/vertical_m", "GNSS good: vertical", "mm", 1e3),
    Quantity("good/heading_deg", "GNSS good: heading", "deg", 1.0, 3),
    Quantity("good/velocity_m_s", "GNSS good: velocity", "mm/s", 1e3),
    Quantity("outage/position_m", "GNSS lost: position", "mm", 1e3),
    Quantity("outage/horizontal_m", "GNSS lost: horizontal", "mm", 1e3),
    Quantity("outage/vertical_m", "GNSS lost: vertical", "mm", 1e3),
    Quantity("outage/heading_deg", "GNSS lost: heading", "deg", 1.0, 3),
    Quantity("outage/velocity_m_s", "GNSS lost: velocity", "mm/s", 1e3),
)
STATISTICS = ("mean", "std", "rms", "max")


@dataclass(frozen=True, slots=True)
class Cell:
    """A statistic of one quantity of one system on one task, over seeds.

    Attributes:
        mean: over the seeds, in the unit that is shown; NaN without a run.
        std: standard deviation over the seeds.
        worst: of all seeds.
        runs: how many seeds there are.
    """

    mean: float
    std: float
    worst: float
    runs: int


@dataclass(frozen=True, slots=True)
class Lost:
    """A cell of Table I in which another system does better than ours."""

    scenario: str
    quantity: Quantity
    statistic: str
    system: str
    ours: Cell
    theirs: Cell


def cell(results: Results, scenario: str, system: str, quantity: Quantity, statistic: str) -> Cell:
    """Return a cell of Table I; of a signed quantity the magnitude of its mean."""
    values = [
        quantity.factor * abs(float(getattr(run.errors[quantity.key], statistic)))
        for run in results.of("accuracy", scenario, system)
        if quantity.key in run.errors
    ]
    if not values:
        return Cell(nan, nan, nan, 0)
    return Cell(fmean(values), pstdev(values), max(values), len(values))


def lost_cells(results: Results, statistics: Sequence[str] = ("rms",)) -> list[Lost]:
    """Return the cells in which a baseline does better than ours, by more than the rounding of the table.

    Where ours has no value, every baseline that has one does better.
    """
    rivals = [name for name in SYSTEMS if name not in (OURS, "paper")]
    found = []
    for scenario in TASKS:
        for quantity in QUANTITIES:
            for statistic in statistics:
                ours = cell(results, scenario, OURS, quantity, statistic)
                for rival in rivals:
                    theirs = cell(results, scenario, rival, quantity, statistic)
                    is_better = round(theirs.mean, quantity.digits) < round(ours.mean, quantity.digits)
                    if is_better or (isnan(ours.mean) and not isnan(theirs.mean)):
                        found.append(Lost(scenario, quantity, statistic, rival, ours, theirs))
    return found


def table_one(results: Results, scenario: str, statistics: Sequence[str] = ("rms",)) -> list[list[str]]:
    """Return Table I of a task: a head, then quantity, unit and one cell per system: mean over seeds +- std."""
    rows = [["", "unit", *(system.title for system in SYSTEMS.values())]]
    for quantity in QUANTITIES:
        for statistic in statistics:
            cells = [cell(results, scenario, system, quantity, statistic) for system in SYSTEMS]
            label = quantity.label if len(statistics) == 1 else f"{quantity.label}, {statistic}"
            rows.append([label, quantity.unit, *(_text(one, quantity.digits) for one in cells)])
    return rows


def table_two(results: Results) -> list[list[str]]:
    """Return Table II: a head, then one row per system; mean and std are of the CPU time, too."""
    columns = ("mean", "std", "median", "p99", "max")
    rows = [["", *(f"{column} [us]" for column in columns), "CPU [us]", "updates too [us]", "update, median [ms]"]]
    for one in results.latency:
        cells = ["-"] * (len(columns) + 2)
        if one.imu_us is not None and one.imu_cpu_us is not None:
            cells = [f"{one.imu_us[column]:.1f}" for column in columns]
            cells.append(f"{one.imu_cpu_us['mean']:.1f} +- {one.imu_cpu_us['std']:.1f}")
            cells.append("-" if one.every_cpu_us is None else f"{one.every_cpu_us['mean']:.1f}")
        update = "-" if one.update_ms is None else f"{one.update_ms['median']:.2f}"
        rows.append([TITLES[one.system], *cells, update])
    return rows


def faster_baselines(results: Results, times: str = "imu_cpu_us") -> list[tuple[str, str, float, float]]:
    """Return ours (the estimator, the engine) and each baseline that answers sooner than it.

    Both names are followed by our and their mean CPU time per IMU sample [us].

    Args:
        results: of the evaluation.
        times: `imu_cpu_us` of a `Latency`, or `every_cpu_us`, which has the samples with an update as well.
    """
    found = {one.system: getattr(one, times) for one in results.latency}
    means: dict[str, float] = {name: of["mean"] for name, of in found.items() if of is not None}
    theirs = {name: mean for name, mean in means.items() if name not in (OURS, "paper", ENGINE)}
    return [
        (ours, name, means[ours], mean)
        for ours in (OURS, ENGINE)
        for name, mean in theirs.items()
        if mean < means.get(ours, nan)
    ]


def consistency_table(results: Results) -> list[list[str]]:
    """Return |propagated - optimised| of the navigation task (Fig. 6): a head, then one row per system."""
    rows = [["", "mean [mm]", "std [mm]", "max [mm]"]]
    for name, system in SYSTEMS.items():
        found = [run.corrections_m for run in results.of("accuracy", "navigation", name) if run.corrections_m]
        if found:
            mean, std = fmean(one.mean for one in found), fmean(one.std for one in found)
            rows.append([system.title, *(f"{1e3 * value:.2f}" for value in (mean, std, max(o.max for o in found)))])
    return rows


def failures(results: Results) -> list[str]:
    """Return one line for every run without a verdict."""
    return [f"{_title(run)}: {run.failure}" for run in results.runs if run.failure]


def _title(run: Run) -> str:
    parts = [run.study, run.scenario, f"seed {run.seed}", run.system, run.variation, run.sensor]
    return ", ".join(part for part in parts if part)


def _text(one: Cell, digits: int) -> str:
    if isnan(one.mean):
        return "-"
    text = f"{one.mean:.{digits}f}"
    return text if one.runs == 1 or not isfinite(one.std) else f"{text} +- {one.std:.{digits}f}"
