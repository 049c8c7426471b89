"""Prints what becomes of the estimate when a number of the configuration is ten times too large or too small.

`python benchmarks/wrong_by_ten.py` simulates a scenario and estimates it with the configuration as it is, and then with
each noise, drift, correlation time and prior multiplied, one key at a time for all sensors of a kind. It prints ratios
of the errors to those of the configuration as it is; `--worst 1.5` leaves out rows whose ratios are all below, `--key
ratio` tries only keys with that in their name.
"""

import argparse
import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from functools import partial
from math import nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from holdfast.config.load import config_of
from holdfast.errors import ConfigError
from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import Scenario, load_scenario
from holdfast.sim.simulation import Simulation
from holdfast.trial.run import estimate, judged, write_simulation

IS_BELIEF = re.compile(r"density|random_walk|_ratio|sigma|drift|correlation|time_constant")
IS_THRESHOLD = re.compile(r"^(gate|jump|max|min)_")
MEASURES = {
    "with GNSS": "horizontal_rms_m",
    "heading": "heading_rms_deg",
    "outage": "outage_horizontal_rms_m",
    "heading there": "outage_heading_rms_deg",
    "chassis": "base_rotation_rms_deg",
}


class Change(NamedTuple):
    """One key in the sections of all sensors of a kind, multiplied; `values` by the name of the sensor."""

    kind: str
    key: str
    factor: float
    values: Mapping[str, float]

    def of(self, data: dict[str, Any]) -> dict[str, Any]:
        """Return a configuration with the change."""
        changed = deepcopy(data)
        for sensor, value in self.values.items():
            changed["sensors"][sensor][self.key] = value
        return changed


def changes(data: dict[str, Any], factors: Sequence[float]) -> Iterator[Change]:
    """Yield all that can be changed and is allowed."""
    sections = config_of(data, "as it is").sensors
    for kind in dict.fromkeys(section.kind for section in sections.values()):
        alike = {name: section for name, section in sections.items() if section.kind == kind}
        for key, value in next(iter(alike.values())):
            if not isinstance(value, float) or not value or not IS_BELIEF.search(key) or IS_THRESHOLD.search(key):
                continue
            for factor in factors:
                change = Change(kind, key, factor, {name: getattr(one, key) * factor for name, one in alike.items()})
                try:
                    config_of(change.of(data), "changed")
                except ConfigError:
                    continue  # beyond what is allowed
                yield change


def scores(folder: Path, simulation: Simulation, data: dict[str, Any]) -> dict[str, float]:
    """Return the measures of one run."""
    trial = judged(simulation, estimate(folder, config_of(data, "changed")))
    return {title: trial.verdict.scores.get(key, nan) for title, key in MEASURES.items()}


def scored(
    scenario: Scenario, seed: int, configurations: Sequence[dict[str, Any]], jobs: int = 2
) -> Iterator[dict[str, float]]:
    """Yield the measures of one recording of a scenario under each of some configurations."""
    with TemporaryDirectory() as folder, ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(
            partial(scores, Path(folder), write_simulation(scenario, seed, Path(folder))), configurations
        )


def print_scored(
    scenario: Scenario,
    seed: int,
    heads: Sequence[str],
    tried: Sequence[tuple[Sequence[str], dict[str, Any]]],
    shown: Sequence[str],
) -> None:
    """Print a table of some measures: a line per configuration, which begins with what is wrong with it."""
    print(f"| {' | '.join([*heads, *shown])} |")
    print(f"|{'---|' * len(heads)}{'---:|' * len(shown)}")
    for (labels, _), row in zip(tried, scored(scenario, seed, [data for _, data in tried]), strict=True):
        print(f"| {' | '.join([*labels, *(f'{row[title]:.3f}' for title in shown)])} |", flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", nargs="?", default="rounds")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--factors", type=float, nargs="+", default=[0.1, 10.0])
    parser.add_argument("--key", default="", help="only keys with this in their name")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--worst", type=float, default=0.0, help="print only rows with a ratio beyond this")
    given = parser.parse_args()
    scenario = load_scenario(given.scenario)
    data = configuration_data(scenario, given.seed)
    found = [change for change in changes(data, given.factors) if given.key in change.key]
    rows = scored(scenario, given.seed, [data, *(change.of(data) for change in found)], given.jobs)
    base = next(rows)
    print("as it is: " + ", ".join(f"{title} {value:.3f}" for title, value in base.items()), flush=True)
    for change, row in zip(found, rows, strict=True):
        ratios = {title: row[title] / base[title] for title in base}
        if max(ratios.values()) >= given.worst:
            text = "  ".join(f"{title} {ratio:6.2f}" for title, ratio in ratios.items())
            print(f"  {change.kind:10s} {change.key:28s} x {change.factor:<5g}  {text}", flush=True)


if __name__ == "__main__":
    main()
