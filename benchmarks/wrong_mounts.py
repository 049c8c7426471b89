"""Prints what a lidar costs that is not mounted as the file says: `python benchmarks/wrong_mounts.py`.

KITTI's drive from its first metre, where the car moves too little for the start to show it, with what `config init`
writes and the pose of the lidar, which is turned about each of its axes, and then moved along them. Every second fix,
of one a second, is held out. `--deg 90 --m --axes z` runs one row alone.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from drives import held_out_row, messages_of, run_system
from kitti_mishaps import RULES, configuration
from scipy.spatial.transform import Rotation

from holdfast.estimator.estimator import Estimator

NONE = Path("reference.csv")  # of KITTI there is none
ANGLES_DEG, DISTANCES_M = (2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 180.0), (0.3, 1.0, 3.0, 10.0)


class Wrong(NamedTuple):
    """By how much the file is wrong, about or along an axis."""

    axis: str
    by: float
    unit: str


def run(drive: Path, wrong: Wrong) -> dict[str, Any]:
    """Return the errors with the lidar turned or moved."""
    vector = np.eye(3)["xyz".index(wrong.axis)] * wrong.by
    turned, moved = (vector, np.zeros(3)) if wrong.unit == "deg" else (np.zeros(3), vector)
    config = configuration(drive / "bag", Rotation.from_rotvec(turned, degrees=True), moved)
    messages = messages_of(drive, config)
    return held_out_row(config, run_system(Estimator(config), messages, RULES), messages, NONE)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--deg", type=float, nargs="*", default=ANGLES_DEG, help="turned by")
    parser.add_argument("--m", type=float, nargs="*", default=DISTANCES_M, help="moved by")
    parser.add_argument("--axes", nargs="+", default=["x", "y", "z"])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    drive: Path = given.data / "kitti_00"
    if not (drive / "bag").exists():
        print(f"kitti_00: skipped, no recording at {given.data}")
        return
    print("Horizontal errors at held-out fixes [m]\n")
    print("| axis | turned or moved by | RMS | largest | NEES / 3 | events |")
    print("|---|---:|---:|---:|---:|---|")
    wrong = [
        Wrong(axis, by, unit)
        for unit, all_ in (("deg", given.deg), ("m", given.m))
        for by in all_
        for axis in given.axes
    ]
    with ProcessPoolExecutor(2) as pool:
        for one, row in zip(wrong, pool.map(partial(run, drive), wrong), strict=True):
            cells = [f"{row[key]:.2f}" if key in row else "never started" for key in ("rms", "max", "nees")]
            print(f"| {one.axis} | {one.by:g} {one.unit} | {' | '.join(cells)} | {row.get('events', '')} |", flush=True)


if __name__ == "__main__":
    main()
