"""Prints what four mishaps at once cost on KITTI's drive with a lidar: `python benchmarks/kitti_mishaps.py --count 24`.

As `drive_mishaps.py`, but two of the four happen to the odometry (`odometry_mishaps.py`). The configuration is what
`config init` writes, and where the lidar is. Every second fix, of one a second, is held out.
"""

import argparse
from functools import partial
from pathlib import Path

import numpy as np
import yaml
from drive_mishaps import Tried, happen, print_seeds
from drives import held_out_row, messages_of, run_system
from further_mishaps import FURTHER, claims_of_velocity
from mishaps import MISHAPS, any_mount, no_velocities
from odometry_mishaps import ODOMETRY
from scipy.spatial.transform import Rotation

from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.recording.first_config import first_config
from holdfast.recording.source import open_recording
from holdfast.replay.held_out import HoldOut

MOUNT = Path(__file__).parent / "configs" / "kitti_00.yaml"
OTHERS = [one for one in MISHAPS + FURTHER if one not in {no_velocities, claims_of_velocity, any_mount}]
RULES = [HoldOut("gnss", 2)]
AS_MOUNTED, NOT_MOVED = Rotation.identity(), np.zeros(3)


def configuration(
    bag: Path,
    turned: Rotation = AS_MOUNTED,
    moved: np.ndarray = NOT_MOVED,
    antenna: np.ndarray = NOT_MOVED,
    *,
    is_known: bool = False,
    scale: float = 1.0,
) -> Config:
    """Return what `config init` writes, with the pose of the lidar, which may be turned and moved (3,) in its axes.

    Its distances may be scaled. The antenna, which is where the IMU is, may be moved, too; scale and place may be said
    to be known.
    """
    with open_recording(bag) as opened:
        document = yaml.safe_load(first_config(opened))
    (mount,) = yaml.safe_load(MOUNT.read_text())["extrinsics"]
    mount["rotation_matrix"] = (turned * Rotation.from_matrix(mount["rotation_matrix"])).as_matrix().tolist()
    mount["translation_m"] = (turned.apply(mount["translation_m"]) + moved).tolist()
    placed = {"parent": "imu", "child": "gnss", "translation_m": antenna.tolist()}
    if is_known:
        document["sensors"]["gnss"]["lever_arm_sigma_m"] = 0.0
    for one in document["sensors"].values():
        if one["kind"] == "odometry":
            one.update({"scale": scale} | ({"scale_sigma": 0.0} if is_known else {}))
    return config_of(document | {"extrinsics": [mount, placed]}, "config init")


def run(drive: Path, seed: int) -> Tried:
    """Return what happened, and the errors."""
    rng, config = np.random.default_rng(seed), configuration(drive / "bag")
    chosen = [kinds[k] for kinds in (ODOMETRY, OTHERS) for k in sorted(rng.choice(len(kinds), 2, replace=False))]
    messages, happened = happen(rng, config, RULES, messages_of(drive, config), chosen)
    tried = run_system(Estimator(config), messages, RULES)
    return [happened], held_out_row(config, tried, messages, drive / "reference.csv")


def kitti_in(data: Path) -> Path | None:
    """Return KITTI's drive below a folder; None where it is absent, which is said."""
    drive = data / "kitti_00"
    if (drive / "bag").exists():
        return drive
    print(f"{drive.name}: skipped, no recording at {data}")
    return None


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    if (drive := kitti_in(given.data)) is not None:
        print_seeds(["mishaps"], partial(run, drive), range(given.first, given.first + given.count))


if __name__ == "__main__":
    main()
