"""Prints what a lidar and an antenna cost that are not where the file says: `python benchmarks/wrong_mounts.py`.

KITTI's drive from its first metre, where the car moves too little for the start to show it, with what `config init`
writes and the pose of the lidar, which is turned about each of its axes, and then moved along them; then its distances
are scaled, and then the antenna is moved along the axes of the IMU. Every second fix, of one a second, is held out.
`--deg 90 --m --times --antenna-m --axes z` runs one row alone, `--deg --m --known` lidars whose scale and antennas
whose place is not estimated.
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
SCALES = 0.5, 0.9, 0.97, 1.03, 1.1, 2.0


class Wrong(NamedTuple):
    """By how much the file is wrong of a lidar or an antenna, about or along an axis if it is not a scale."""

    what: str
    axis: str
    by: float
    unit: str


def run(drive: Path, is_known: bool, wrong: Wrong) -> dict[str, Any]:
    """Return the errors with the lidar turned, moved or scaled, or the antenna moved."""
    vector = np.eye(3)["xyz".index(wrong.axis)] * wrong.by if wrong.axis else np.zeros(3)
    if wrong.what == "antenna":
        config = configuration(drive / "bag", antenna=vector, is_known=is_known)
    elif wrong.unit == "deg":
        config = configuration(drive / "bag", Rotation.from_rotvec(vector, degrees=True))
    elif wrong.unit == "m":
        config = configuration(drive / "bag", moved=vector)
    else:
        config = configuration(drive / "bag", scale=wrong.by, is_known=is_known)
    messages = messages_of(drive, config)
    return held_out_row(config, run_system(Estimator(config), messages, RULES), messages, drive / "reference.csv")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--deg", type=float, nargs="*", default=ANGLES_DEG, help="by which the lidar is turned")
    parser.add_argument("--m", type=float, nargs="*", default=DISTANCES_M, help="by which it is moved")
    parser.add_argument("--times", type=float, nargs="*", default=SCALES, help="by which its distances are scaled")
    parser.add_argument("--antenna-m", type=float, nargs="*", default=DISTANCES_M, help="by which the antenna is moved")
    parser.add_argument("--known", action="store_true", help="the file says that scale and place are known")
    parser.add_argument("--axes", nargs="+", default=["x", "y", "z"])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    if (drive := kitti_in(given.data)) is None:
        return
    print("Horizontal errors at held-out fixes [m]\n")
    print("| what | axis | turned, moved or scaled by | RMS | largest | NEES / 3 | events |")
    print("|---|---|---:|---:|---:|---:|---|")
    kinds = (
        ("lidar", "deg", given.deg, given.axes),
        ("lidar", "m", given.m, given.axes),
        ("lidar", "times", given.times, [""]),
        ("antenna", "m", given.antenna_m, given.axes),
    )
    wrong = [Wrong(what, axis, by, unit) for what, unit, all_, axes in kinds for by in all_ for axis in axes]
    with ProcessPoolExecutor(2) as pool:
        for one, row in zip(wrong, pool.map(partial(run, drive, given.known), wrong), strict=True):
            said = [
                one.what,
                one.axis,
                f"{one.by:g} {one.unit}",
                *cells(row, "rms", "max", "nees"),
                row.get("events", ""),
            ]
            print(f"| {' | '.join(said)} |", flush=True)


if __name__ == "__main__":
    main()
