"""Prints what four mishaps at once cost on KITTI's drive with a lidar: `python benchmarks/kitti_mishaps.py --count 24`.

As `drive_mishaps.py`, but two of the four happen to the odometry (`odometry_mishaps.py`). The configuration is what
`config init` writes, and where the lidar is. Every second fix, of one a second, is held out.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from drive_mishaps import happen
from drives import held_out_row, messages_of, run_system
from further_mishaps import FURTHER, claims_of_velocity
from mishaps import MISHAPS, any_mount, no_velocities
from odometry_mishaps import ODOMETRY

from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.recording.first_config import first_config
from holdfast.recording.source import open_recording
from holdfast.replay.held_out import HoldOut

MOUNT = Path(__file__).parent / "configs" / "kitti_00.yaml"
OTHERS = [one for one in MISHAPS + FURTHER if one not in {no_velocities, claims_of_velocity, any_mount}]
RULES = [HoldOut("gnss", 2)]


def configuration(bag: Path) -> Config:
    """Return what `config init` writes, with the pose of the lidar."""
    with open_recording(bag) as opened:
        document = yaml.safe_load(first_config(opened))
    mount = yaml.safe_load(MOUNT.read_text())["extrinsics"]
    return config_of(document | {"extrinsics": [*mount, {"parent": "imu", "child": "gnss"}]}, "config init")


def run(drive: Path, seed: int) -> tuple[list[str], dict[str, Any]]:
    """Return what happened and the errors."""
    rng, config = np.random.default_rng(seed), configuration(drive / "bag")
    chosen = [kinds[k] for kinds in (ODOMETRY, OTHERS) for k in sorted(rng.choice(len(kinds), 2, replace=False))]
    messages, happened = happen(rng, config, RULES, messages_of(drive, config), chosen)
    tried = run_system(Estimator(config), messages, RULES)
    return happened, held_out_row(config, tried, messages, drive / "none")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    drive: Path = given.data / "kitti_00"
    if not (drive / "bag").exists():
        print(f"kitti_00: skipped, no recording at {given.data}")
        return
    print("Horizontal errors at held-out fixes [m]; the line is that between the fixes used\n")
    print("| seed | mishaps | RMS | to the line | largest | NEES / 3 |\n|---:|---|---:|---:|---:|---:|")
    seeds = range(given.first, given.first + given.count)
    with ProcessPoolExecutor(2) as pool:
        futures = [pool.submit(run, drive, seed) for seed in seeds]
        for seed, future in zip(seeds, futures, strict=True):
            happened, row = future.result()
            cells = [f"{row[key]:.2f}" if key in row else "never started" for key in ("rms", "ratio", "max", "nees")]
            print(f"| {seed} | {', '.join(happened)} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
