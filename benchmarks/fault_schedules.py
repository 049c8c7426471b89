"""Runs random fault schedules through the estimator and prints every seed that breaks it.

`python benchmarks/fault_schedules.py --count 1000 --jobs 2`: each schedule is simulated, recorded and replayed; no
exception, no number that is none, and no step of the odometry frame may come of it.
"""

import argparse
import sys
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from holdfast.config.load import config_of
from holdfast.errors import ConfigError
from holdfast.evaluation.soundness import violations
from holdfast.sim.configuration import configuration_data
from holdfast.sim.schedules import random_schedule
from holdfast.sim.simulation import START_NS
from holdfast.trial.run import estimate, write_simulation


def complaints(seed: int, preset: str = "holdfast") -> list[str]:
    """Return what the schedule of a seed broke, one line each."""
    scenario = random_schedule(seed)
    config = config_of({"preset": preset} | configuration_data(scenario, seed), f"schedule {seed}")
    with TemporaryDirectory() as folder:
        try:
            write_simulation(scenario, seed, Path(folder))
        except ConfigError as error:
            return [f"no such simulation: {error}"]
        try:
            recorder = estimate(Path(folder), config)
            return [line for life in recorder.lives() for line in violations(life, START_NS)]
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            return [f"{type(error).__name__} in {Path(at.filename).name}:{at.lineno} {at.name}: {error}".split("\n")[0]]


def run(seeds: Sequence[int], jobs: int, preset: str) -> Iterator[tuple[int, list[str]]]:
    """Yield every seed with its complaints, in order."""
    if jobs == 1:
        yield from ((seed, complaints(seed, preset)) for seed in seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from zip(seeds, pool.map(complaints, seeds, [preset] * len(seeds), chunksize=4), strict=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="seed of the first schedule")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seeds", type=int, nargs="+", help="these instead")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--preset", choices=["holdfast", "paper"], default="holdfast")
    options = parser.parse_args()
    seeds = options.seeds or range(options.first, options.first + options.count)
    failed = 0
    for number, (seed, found) in enumerate(run(seeds, options.jobs, options.preset), start=1):
        for line in found:
            print(f"seed {seed}: {line}", flush=True)
        failed += bool(found)
        if sys.stderr.isatty():
            print(f"\r{number} of {len(seeds)}, {failed} failed", end="", file=sys.stderr, flush=True)
    print(f"{len(seeds)} schedules, preset {options.preset}: {failed} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
