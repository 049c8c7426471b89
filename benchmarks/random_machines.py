"""Prints what the defaults are worth on random machines whose configuration says where sensors are, and nothing else.

`python benchmarks/random_machines.py --count 40`: rates, noise, mounts, clocks and claims are those of
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
from holdfast.sim.random_machine import random_machine
from holdfast.trial.run import trials_of

OUT_H, ALONE_H = "outage_horizontal_rms_m", "outage_alone_horizontal_rms_m"
OUT_RATIO = "outage_ratio"
# score -> label, and factor from SI
ROWS = {
    "started_s": ("started after, s", 1.0),
    "horizontal_rms_m": ("GNSS good: horizontal RMS, mm", 1e3),
    "horizontal_ratio": ("GNSS good: horizontal RMS / that of the fixes", 1.0),
    "heading_rms_deg": ("GNSS good: heading RMS, deg", 1.0),
    "roll_pitch_rms_deg": ("GNSS good: roll and pitch RMS, deg", 1.0),
    OUT_H: ("outage: horizontal RMS, mm", 1e3),
    OUT_RATIO: ("outage: horizontal RMS / that of the odometry alone", 1.0),
    "outage_heading_rms_deg": ("outage: heading RMS, deg", 1.0),
    "regained_s": ("GNSS used again after, s", 1.0),
    "step_m": ("O: largest step, mm", 1e3),
    "step_deg": ("O: largest rotation step, deg", 1.0),
    "nees_attitude": ("NEES/3 of attitude, GNSS good", 1.0),
    "nees_position": ("NEES/3 of position, GNSS good", 1.0),
    "nees_velocity": ("NEES/3 of velocity, GNSS good", 1.0),
    "fallback_nees_attitude": ("NEES/3 of attitude, outage", 1.0),
    "fallback_nees_position": ("NEES/3 of position, outage", 1.0),
}


def scores(seed: int) -> dict[str, float]:
    """Run the machine of a seed; without scores if it never started."""
    machine = random_machine(seed)
    config = config_of(machine.configuration, f"random machine {seed}")
    with TemporaryDirectory() as folder:
        try:
            found = trials_of(machine.scenario, seed, Path(folder), [config])[0].verdict.scores
        except EstimatorError:
            return {}
    return found | {OUT_RATIO: found[OUT_H] / found.get(ALONE_H, nan)}


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
                print(f"{seed}: " + ", ".join(f"{key} {one[key]:.4g}" for key in ROWS if key in one), flush=True)
    print(f"{options.count} machines; never started: {[seed for seed, one in found.items() if not one] or 'none'}")
    print("\n| Score | median | 9 in 10 | worst | seed |\n|---|---:|---:|---:|---:|")
    for key, (label, factor) in ROWS.items():
        known = {seed: factor * one[key] for seed, one in found.items() if key in one and not isnan(one[key])}
        worst = max(known, key=lambda seed: known[seed])
        median, most = np.percentile(list(known.values()), [50.0, 90.0])
        print(f"| {label} | {median:.3g} | {most:.3g} | {known[worst]:.3g} | {worst} |")


if __name__ == "__main__":
    main()
