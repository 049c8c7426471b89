"""Prints what a lidar costs that is mounted otherwise than the file says: `python benchmarks/wrong_mounts.py`.

KITTI's drive from its first metre, where the car moves too little for the start to show it, with what `config init`
writes and the pose of the lidar, which is turned about each of its axes. Every second fix, of one a second, is held
out. `--deg 90 --axes z` runs one row alone.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from drives import held_out_row, messages_of, run_system
from kitti_mishaps import RULES, configuration
from scipy.spatial.transform import Rotation

from holdfast.estimator.estimator import Estimator

NONE = Path("reference.csv")  # of KITTI there is none
ANGLES_DEG = (2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 180.0)


def run(drive: Path, turn: tuple[str, float]) -> dict[str, Any]:
    """Return the errors with the lidar turned about an axis by an angle [deg]."""
    config = configuration(drive / "bag", Rotation.from_euler(*turn, degrees=True))
    messages = messages_of(drive, config)
    return held_out_row(config, run_system(Estimator(config), messages, RULES), messages, NONE)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--deg", type=float, nargs="+", default=ANGLES_DEG, help="angles")
    parser.add_argument("--axes", nargs="+", default=["x", "y", "z"])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    drive: Path = given.data / "kitti_00"
    if not (drive / "bag").exists():
        print(f"kitti_00: skipped, no recording at {given.data}")
        return
    print("Horizontal errors at held-out fixes [m]\n")
    print("| turned about | by [deg] | RMS | largest | NEES / 3 | events |")
    print("|---|---:|---:|---:|---:|---|")
    turns = [(axis, by_deg) for by_deg in given.deg for axis in given.axes]
    with ProcessPoolExecutor(2) as pool:
        for (axis, by_deg), row in zip(turns, pool.map(partial(run, drive), turns), strict=True):
            cells = [f"{row[key]:.2f}" if key in row else "never started" for key in ("rms", "max", "nees")]
            print(f"| {axis} | {by_deg:g} | {' | '.join(cells)} | {row.get('events', '')} |", flush=True)


if __name__ == "__main__":
    main()
