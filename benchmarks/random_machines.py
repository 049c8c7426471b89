"""Prints what the defaults are worth on random machines whose configuration says where sensors are, and nothing else.

`python benchmarks/random_machines.py --count 100`: rates, noise, mounts, clocks and claims are those of
`holdfast.sim.random_machine`, seed by seed; GNSS is lost for 30 s. A row per score tells the median of the machines,
the nine in ten that are no worse, and the worst with its seed; `--each` prints every machine's, too.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from math import isnan, nan
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from holdfast.config.load import config_of
from holdfast.errors import EstimatorError
from holdfast.evaluation.measures import MEASURES, Measure
from holdfast.sim.random_machine import random_machine
from holdfast.trial.run import trials_of

OUT_H, ALONE_H = "outage_horizontal_rms_m", "outage_alone_horizontal_rms_m"
OWN = (
    Measure("started_s", "started after", "s", digits=2),
    Measure("outage_ratio", "outages: horizontal RMS / that of the odometry alone", "1", digits=2),
)
LEFT_OUT = ("rtk_", "base_", "vertical_ratio", "outage_alone_", "settled_s", "misled_s", "drift_percent")
ROWS = OWN + tuple(one for one in MEASURES if not one.key.startswith(LEFT_OUT) and "excess" not in one.key)


def scores(seed: int) -> dict[str, float]:
    """Run the machine of a seed; without scores if it never started."""
    machine = random_machine(seed)
    config = config_of(machine.configuration, f"random machine {seed}")
    with TemporaryDirectory() as folder:
        try:
            found = trials_of(machine.scenario, seed, Path(folder), [config])[0].verdict.scores
        except EstimatorError:
            return {}
    return found | {"outage_ratio": found[OUT_H] / found.get(ALONE_H, nan)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--each", action="store_true", help="print the scores of every machine, too")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    found: dict[int, dict[str, float]] = {}
    with ProcessPoolExecutor(options.jobs) as pool:
        for seed, one in zip(seeds, pool.map(scores, seeds), strict=True):
            found[seed] = one
            print(f"{len(found)} of {options.count}", file=sys.stderr, flush=True)
            if options.each:
                shown = (f"{row.key} {row.text(one[row.key])}" for row in ROWS if row.key in one)
                print(f"{seed}: " + ", ".join(shown), flush=True)
    print(f"{options.count} machines; never started: {[seed for seed, one in found.items() if not one] or 'none'}")
    print("\n| Score | median | 9 in 10 | worst | seed |\n|---|---:|---:|---:|---:|")
    for row in ROWS:
        known = {seed: one[row.key] for seed, one in found.items() if not isnan(one.get(row.key, nan))}
        worst = max(known, key=lambda seed: known[seed])
        median, most = np.percentile(list(known.values()), [50.0, 90.0])
        unit = "" if row.unit == "1" else f", {row.unit}"
        print(f"| {row.label}{unit} | {row.text(median)} | {row.text(most)} | {row.text(known[worst])} | {worst} |")


if __name__ == "__main__":
    main()
