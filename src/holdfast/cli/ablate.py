"""`holdfast ablate`: what each part of the estimator is worth, on one scenario, in one table."""

import csv
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass
from math import isfinite, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from holdfast.cli.progress import progress_bar
from holdfast.cli.writing import naming_the_output
from holdfast.errors import ConfigError, EstimatorError

if TYPE_CHECKING:
    from holdfast.evaluation.measures import Measure
    from holdfast.sim.scenario import Scenario

# name -> what it changes in the configuration; null takes a sensor away
VARIATIONS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": {"preset": "paper"},
    "single-graph": {"graph": {"dual": False}},
    "relative-scans": {"graph": {"dual": False, "main_lidar": "relative"}},
    "frozen-fallback": {"graph": {"fallback_lidar": "frozen"}},
    "imu-nodes": {"graph": {"nodes": "imu"}},
    "lag-1.5s": {"graph": {"lag_s": 1.5}},
    "lag-6s": {"graph": {"lag_s": 6.0}},
    "no-innovation": {"gate": {"innovation": False}},
    "no-witness": {"gate": {"witness": False}},
    "no-standstill": {"standstill": {"enabled": False}},
    "frame-at-recovery": {"frames": {"odometry_policy": "at_recovery"}},
    "one-antenna": {"sensors": {"gnss_right": None, "heading": None}},
    "no-heading": {"sensors": {"heading": None}},
    "no-lidar": {"sensors": {"lidar": None}},
}
# column on the screen -> scores that stand in it, their digits
COLUMNS = {
    "H/V mm": ("horizontal_rms_m", "vertical_rms_m"),
    "yaw deg": ("heading_rms_deg",),
    "NEES R/p/v": ("nees_attitude", "nees_position", "nees_velocity"),
    "lost: H/V mm": ("outage_horizontal_rms_m", "outage_vertical_rms_m"),
    "yaw deg ": ("outage_heading_rms_deg",),
    "NEES R/p/v ": ("fallback_nees_attitude", "fallback_nees_position", "fallback_nees_velocity"),
    "O mm/deg": ("step_m", "step_deg"),
    "update ms": ("update_ms",),
}
KEYS = [key for keys in COLUMNS.values() for key in keys]
LEGEND = "RMS with good GNSS, then in outages (lost); NEES of attitude, position, velocity; O: largest step"


@dataclass(frozen=True, slots=True)
class Row:
    """One variation with one seed; where the estimator never started, `failure` says why and there are no scores."""

    variation: str
    seed: int
    scores: dict[str, float]
    failure: str = ""


@click.command()
@click.argument("scenario")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder for recordings and tables."
)
@click.option("--seeds", type=click.IntRange(min=1), default=1, show_default=True, help="Simulate it so many times.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Processes at a time.")
@click.option("--only", multiple=True, metavar="VARIATION", help="Leave the others out; may be given several times.")
def ablate(scenario: str, output: Path, seeds: int, jobs: int, only: tuple[str, ...]) -> None:
    """Simulate SCENARIO and estimate it with parts of the estimator or sensors switched off.

    SCENARIO is a shipped one or a YAML file, as for `holdfast simulate`. Every variation changes the configuration that
    goes with the scenario: default, paper (the preset), single-graph, relative-scans, frozen-fallback, imu-nodes,
    lag-1.5s, lag-6s, no-innovation, no-witness, no-standstill, frame-at-recovery, one-antenna, no-heading, no-lidar.

    Prints means over the seeds and writes table.csv, table.json (every score of every seed) and the recordings.
    """
    unknown = [name for name in only if name not in VARIATIONS]
    if unknown:
        raise ConfigError(f"--only {unknown[0]}: no such variation (allowed: {', '.join(VARIATIONS)})")
    try:
        from holdfast.sim.scenario import load_scenario
        from holdfast.sim.simulation import simulate  # noqa: F401 (whether its packages are there)
    except ModuleNotFoundError as error:
        raise ConfigError(f"simulating needs {error.name}: pip install 'holdfast[sim]'") from None
    loaded = load_scenario(scenario)
    chosen = [name for name in VARIATIONS if not only or name in only]
    with naming_the_output(output):
        rows = _rows(loaded, output, range(seeds), chosen, jobs)
        write_tables(rows, output)
    _print_table(rows, f"{scenario}, {seeds} seed{'s' * (seeds > 1)}")
    click.echo(f"written to {output}: table.csv, table.json, " + ", ".join(f"seed-{seed}" for seed in range(seeds)))


def _rows(scenario: "Scenario", output: Path, seeds: Sequence[int], variations: Sequence[str], jobs: int) -> list[Row]:
    """Simulate every seed, then run every variation on it; return them by variation, then by seed."""
    tasks = len(seeds) * (1 + len(variations))
    pool: Executor | None = ProcessPoolExecutor(jobs) if jobs > 1 else None
    rows: list[Row] = []
    with pool or nullcontext(), progress_bar("ablating", 0, tasks) as progress:
        done = 0
        for work in (
            [(_simulate, (scenario, seed, output)) for seed in seeds],
            [(_run, (scenario, seed, output, name)) for name in variations for seed in seeds],
        ):
            for result in _results(pool, work):
                done += 1
                rows += [result] if isinstance(result, Row) else []
                if progress is not None:
                    progress(done)
    order = list(VARIATIONS)
    return sorted(rows, key=lambda row: (order.index(row.variation), row.seed))


def _results(pool: Executor | None, work: Sequence[tuple[Any, tuple[Any, ...]]]) -> Iterator[Row | None]:
    """Yield what comes of the calls, in any order."""
    if pool is None:
        yield from (function(*arguments) for function, arguments in work)
        return
    futures: list[Future[Row | None]] = [pool.submit(function, *arguments) for function, arguments in work]
    try:
        yield from (future.result() for future in as_completed(futures))
    finally:
        for future in futures:
            future.cancel()


def _folder(output: Path, seed: int) -> Path:
    return output / f"seed-{seed}"


def _simulate(scenario: "Scenario", seed: int, output: Path) -> None:
    from holdfast.cli.trial import write_simulation

    write_simulation(scenario, seed, _folder(output, seed))


def _run(scenario: "Scenario", seed: int, output: Path, name: str) -> Row:
    from holdfast.cli.trial import estimate, judged
    from holdfast.config.document import Document
    from holdfast.config.load import validate
    from holdfast.config.model import Config
    from holdfast.config.presets import with_preset
    from holdfast.sim.configuration import configuration
    from holdfast.sim.simulation import simulate

    given = configuration(scenario).model_dump(mode="json", exclude_unset=True)
    config = validate(Document(name, with_preset(changed(given, VARIATIONS[name]))), Config)
    recorder = estimate(_folder(output, seed), config)
    try:
        trial = judged(simulate(scenario, seed), recorder)
    except EstimatorError:
        return Row(name, seed, {}, f"never started: {recorder.estimator.waiting_for}")
    return Row(name, seed, trial.verdict.scores)


def changed(given: dict[str, Any], overlay: dict[str, Any]) -> dict[str, Any]:
    """Return configuration data in which the overlay's values replace those given, section by section."""
    merged = given | overlay
    for key in given.keys() & overlay.keys():
        if isinstance(given[key], dict) and isinstance(overlay[key], dict):
            merged[key] = changed(given[key], overlay[key])
    return merged


def write_tables(rows: Sequence[Row], folder: Path) -> None:
    """Write the means as table.csv, and everything as table.json; a score without an occasion is empty, or null."""
    measures = _measures()
    with (folder / "table.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["variation", "seeds", *KEYS])
        for name, of in _by_variation(rows).items():
            means = [_mean(of, measures[key]) for key in KEYS]
            writer.writerow([name, len(of), *("" if isnan(value) else f"{value:.9g}" for value in means)])
    entries = [
        {
            "variation": row.variation,
            "changes": VARIATIONS[row.variation],
            "seed": row.seed,
            "failure": row.failure or None,
            "scores": {key: float(value) if isfinite(value) else None for key, value in row.scores.items()},
        }
        for row in rows
    ]
    (folder / "table.json").write_text(json.dumps(entries, indent=2) + "\n", encoding="utf-8")


def _measures() -> "dict[str, Measure]":
    from holdfast.evaluation.measures import MEASURES

    return {measure.key: measure for measure in MEASURES}


def _by_variation(rows: Sequence[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row.variation, []).append(row)
    return found


def _mean(rows: Sequence[Row], measure: "Measure") -> float:
    return measure.mean([row.scores.get(measure.key, nan) for row in rows])


def _print_table(rows: Sequence[Row], title: str) -> None:
    measures = _measures()
    table = [["variation", *COLUMNS]]
    for name, of in _by_variation(rows).items():
        texts = {key: measures[key].text(_mean(of, measures[key])) for key in KEYS}
        table.append([name, *("/".join(texts[key] for key in keys) for keys in COLUMNS.values())])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    click.echo(f"{title}. {LEGEND}")
    for line in table:
        cells = [cell.strip().rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)]
        click.echo("  ".join([line[0].ljust(widths[0]), *cells]))
    for row in rows:
        if row.failure:
            click.echo(f"{row.variation}, seed {row.seed}: {row.failure}")
