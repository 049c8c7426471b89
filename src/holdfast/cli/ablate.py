"""`holdfast ablate`: what each part of the estimator is worth, on one scenario, in one table."""

import csv
import json
from collections.abc import Sequence
from math import isfinite, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.cli.columns import aligned
from holdfast.cli.progress import count_bar
from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.output_folder import naming_the_output, replaced
from holdfast.trial.variations import VARIATIONS

if TYPE_CHECKING:
    from holdfast.evaluation.measures import Measure
    from holdfast.trial.ablation import Row

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
    lag-1.5s, lag-6s, no-innovation, no-drift-monitor, no-gyroscope-scale, no-standstill, frame-at-recovery,
    one-antenna, no-heading, no-lidar.

    Prints means over the seeds and writes table.csv, table.json (every score of every seed) and the recordings.
    """
    unknown = [name for name in only if name not in VARIATIONS]
    if unknown:
        raise ConfigError(f"--only {unknown[0]}: no such variation (allowed: {', '.join(VARIATIONS)})")
    with needing("simulating", "sim"):
        from holdfast.sim.scenario import load_scenario
        from holdfast.trial.ablation import run_ablation
    loaded = load_scenario(scenario)
    chosen = [name for name in VARIATIONS if not only or name in only]
    with naming_the_output(output), replaced(output, "ablate", [scenario]):
        with count_bar("ablating") as progress:
            rows = run_ablation(loaded, output, range(seeds), chosen, jobs, progress)
        write_tables(rows, output)
    _print_table(rows, f"{scenario}, {seeds} seed{'s' * (seeds > 1)}")
    click.echo(f"written to {output}: table.csv, table.json, " + ", ".join(f"seed-{seed}" for seed in range(seeds)))


def write_tables(rows: "Sequence[Row]", folder: Path) -> None:
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


def _by_variation(rows: "Sequence[Row]") -> "dict[str, list[Row]]":
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row.variation, []).append(row)
    return found


def _mean(rows: "Sequence[Row]", measure: "Measure") -> float:
    return measure.mean([row.scores.get(measure.key, nan) for row in rows])


def _print_table(rows: "Sequence[Row]", title: str) -> None:
    measures = _measures()
    table = [["variation", *(head.strip() for head in COLUMNS)]]
    for name, of in _by_variation(rows).items():
        texts = {key: measures[key].text(_mean(of, measures[key])) for key in KEYS}
        table.append([name, *("/".join(texts[key] for key in keys) for keys in COLUMNS.values())])
    click.echo(f"{title}. {LEGEND}")
    for line in aligned(table):
        click.echo(line)
    for row in rows:
        if row.failure:
            click.echo(f"{row.variation}, seed {row.seed}: {row.failure}")
