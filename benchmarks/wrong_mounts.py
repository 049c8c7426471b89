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
from drive_mishaps import cells
from drives import held_out_row, messages_of, run_system
from kitti_mishaps import RULES, configuration, kitti_in
from scipy.spatial.transform import Rotation

from holdfast.estimator.estimator import Estimator

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
    return held_out_row(config, run_system(Estimator(config), messages, RULES), messages, drive / "reference.csv")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--deg", type=float, nargs="*", default=ANGLES_DEG, help="turned by")
    parser.add_argument("--m", type=float, nargs="*", default=DISTANCES_M, help="moved by")
    parser.add_argument("--axes", nargs="+", default=["x", "y", "z"])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    if (drive := kitti_in(given.data)) is None:
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
            said = [one.axis, f"{one.by:g} {one.unit}", *cells(row, "rms", "max", "nees"), row.get("events", "")]
            print(f"| {' | '.join(said)} |", flush=True)


if __name__ == "__main__":
    main()
