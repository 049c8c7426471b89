"""Prints what three mishaps at once cost on the cars of `drives/`: `python benchmarks/drive_mishaps.py --count 24`.

Each seed chooses a drive and three of MISHAPS, with `--further` of FURTHER, too. The fixes that judge stay right, as do
all others but for outliers, so whatever happens the estimate should come back. Every second fix is held out and judges;
the configuration is what `config init` writes of the drive as it was recorded. Seeds are printed as they end, with what
was done: a row is run again by `--first SEED --count 1`.
"""

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from drive_faults import where_used
from drives import held_out_row, messages_of, names_of, recorded_in, run_system, starter_config
from further_mishaps import FURTHER, LYING
from mishaps import MISHAPS, Messages, Mishap

from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.replay.held_out import HoldOut

Tried = tuple[list[str], dict[str, Any]]
"""What is said of a seed, and its errors as of `held_out_row`."""


def run(drives: list[Path], mishaps: Sequence[Mishap], seed: int) -> Tried:
    """Return which drive it was, what happened, and the errors; fixes that judge do not lie."""
    rng = np.random.default_rng(seed)
    drive = drives[int(rng.integers(len(drives)))]
    config = starter_config(drive / "bag")
    rules = [HoldOut(sensor, 2) for sensor in names_of(config, "gnss")]
    chosen = [mishaps[number] for number in sorted(rng.choice(len(mishaps), 3, replace=False))]
    messages, happened = happen(rng, config, rules, messages_of(drive, config), chosen)
    tried = run_system(Estimator(config), messages, rules)
    return [drive.name, happened], held_out_row(config, tried, messages, drive / "reference.csv")


def happen(
    rng: np.random.Generator, config: Config, rules: list[HoldOut], messages: Messages, chosen: Sequence[Mishap]
) -> tuple[Messages, str]:
    """Return the messages after some mishaps, and what happened."""
    happened = []
    for mishap in sorted(chosen, key=lambda one: one in LYING):
        after, what = mishap(rng, messages)
        messages = where_used(config, rules, messages, after) if mishap in LYING else after
        happened.append(what)
    return messages, ", ".join(happened)


def cells(row: dict[str, Any], *keys: str) -> list[str]:
    """Return errors of `held_out_row` as cells of a table."""
    return [f"{row[key]:.2f}" if key in row else "never started" for key in keys]


def print_seeds(titles: Sequence[str], run: Callable[[int], Tried], seeds: Sequence[int]) -> None:
    """Print a row per seed, as they end: what a run says of it below titles of its own, and the errors."""
    print("Horizontal errors at held-out fixes [m]; the line is that between the fixes used\n")
    print(f"| seed | {' | '.join(titles)} | RMS | to the line | largest | NEES / 3 |")
    print(f"|---:|{'---|' * len(titles)}---:|---:|---:|---:|")
    with ProcessPoolExecutor(2) as pool:
        for seed, (said, row) in zip(seeds, pool.map(run, seeds), strict=True):
            print(f"| {seed} | {' | '.join([*said, *cells(row, 'rms', 'ratio', 'max', 'nees')])} |", flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--further", action="store_true")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data" / "drives")
    given = parser.parse_args()
    mishaps = MISHAPS + FURTHER if given.further else MISHAPS
    drives = recorded_in(given.data)
    if not drives:
        print(f"all drives: skipped, no recording at {given.data}")
        return
    seeds = range(given.first, given.first + given.count)
    print_seeds(["drive", "mishaps"], partial(run, drives, mishaps), seeds)


if __name__ == "__main__":
    main()
