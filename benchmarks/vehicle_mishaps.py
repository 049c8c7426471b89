"""Prints what three mishaps at once cost on the machines of `vehicles.py`: `python benchmarks/vehicle_mishaps.py`.

Each seed chooses one of them, its receiver, whether it has an odometry, and what happens to its sensors; the error is
that against the truth. The configuration stays what it was without mishaps.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from drive_mishaps import happen
from further_mishaps import FURTHER, clock_step, rare_samples
from mishaps import MISHAPS, any_mount
from motions import VEHICLES
from odometry_mishaps import ODOMETRY
from vehicles import HEADS, RECEIVERS, Odometry, Recording, judge, record

from holdfast.messages import Message

OF_ALL = [one for one in MISHAPS + FURTHER if one not in {any_mount, clock_step, rare_samples}]


def spoilt(seed: int) -> tuple[Recording, list[Message], str, str]:
    """Return a recording, what is left of its messages, what has happened to them, and what is recorded."""
    rng = np.random.default_rng(seed)
    name, kind = str(rng.choice(list(VEHICLES))), str(rng.choice(list(RECEIVERS)))
    has_odometry = bool(rng.integers(2))
    recording = record(name, RECEIVERS[kind], seed, Odometry() if has_odometry else None)
    pools = [(ODOMETRY, 1), (OF_ALL, 2)] if has_odometry else [(OF_ALL, 3)]
    chosen = [pool[k] for pool, number in pools for k in rng.choice(len(pool), number, replace=False)]
    messages, happened = happen(rng, recording.config, [], recording.messages, chosen)
    return recording, messages, happened, f"{name} | {kind}"


def run(seed: int) -> str:
    """Return a row of the table."""
    recording, messages, happened, recorded = spoilt(seed)
    tried = judge(recording, messages)
    cells = [tried] if isinstance(tried, str) else [*tried.cells(), tried.told]
    return f"| {' | '.join([str(seed), recorded, happened, *cells])} |"


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--count", type=int, default=24)
    given = parser.parse_args()
    heads = ["seed", "vehicle", "GNSS", "mishaps", *HEADS, "events"]
    print(f"| {' | '.join(heads)} |")
    print(f"|---:|---|---|---|{'---:|' * len(HEADS)}---|")
    with ProcessPoolExecutor(2) as pool:
        for row in pool.map(run, range(given.first, given.first + given.count)):
            print(row, flush=True)


if __name__ == "__main__":
    main()
