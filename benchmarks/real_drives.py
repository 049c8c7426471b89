"""Prints the accuracy on the real recordings, as docs/results quotes it: `python benchmarks/real_drives.py`.

The recordings are read where they lie (`--data`, by default `../shared/data` beside the checkout). Truth never
enters the estimator: held-out fixes and `truth_lidar.tum` only judge.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from drives import print_drives

from holdfast.config.load import load_config
from holdfast.config.model import Config
from holdfast.geometry.earth import Geodetic
from holdfast.messages import GnssFix
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.recording.tum import read_tum
from holdfast.replay.held_out import HoldOut
from holdfast.replay.runner import Replay
from holdfast.replay.summary import summarise_replay

HERE = Path(__file__).parent
OUTAGE_S = 60.0
OUTAGES = 10


def replay(config: Config, bag: Path, rules: list[HoldOut]) -> Replay:
    """Replay a recording without writing anything."""
    with open_recording(bag) as recording:
        run = Replay(config, None, rules)
        run.run(recording.read(subscriptions(config)))
    return run


def print_held_out(title: str, run: Replay) -> None:
    """Print one line per track and circumstance."""
    summary = summarise_replay(run, title, [], True)
    print(f"\n{title} ({summary['timing']['real_time_factor']:.0f} x real time)")
    for track, parts in summary["held_out"].items():
        for part, errors in (parts or {}).items():
            h, nees = errors["horizontal_m"], errors["nees_per_dof"]
            print(
                f"  {track:9s} {part:8s} n {h['count']:4d}  horizontal RMS {h['rms']:.3f}  median {h['median']:.3f}"
                f"  p95 {h['p95']:.3f}  max {h['max']:.3f}  vertical RMS {errors['vertical_m']['rms']:.3f} m"
                + ("" if nees is None else f"  NEES/3 {nees:.2f}")
            )


# what is left in an outage -> the configuration, and the kinds of sensors that are taken out of it
LEFT = {
    "lidar odometry kept": ("kitti_00.yaml", ()),
    "IMU alone": ("kitti_00.yaml", ("odometry",)),
    "IMU and nonholonomic constraint": ("kitti_00_nonholonomic.yaml", ()),
}


def one_outage(left: str, bag: Path, truth_path: Path, start_s: float) -> dict[str, Any]:
    """Cut GNSS for a minute and measure the error at its end, in position and heading."""
    file, removed = LEFT[left]
    config = load_config(HERE / "configs" / file)
    sensors = {name: sensor for name, sensor in config.sensors.items() if sensor.kind not in removed}
    config = config.model_copy(update={"sensors": sensors})
    run = Replay(config, None, [HoldOut("gnss", None, start_s, start_s + OUTAGE_S)])
    headings: dict[int, float] = {}
    with open_recording(bag) as recording:
        messages = list(recording.read(subscriptions(config), 0.0, start_s + OUTAGE_S + 5.0))
    for message in run._filter.split(messages):
        output = run.estimator.process(message)
        run._judge(output)
        if output.estimate is not None:
            headings[output.estimate.stamp_ns] = float(output.estimate.nav.attitude().rpy()[2])
    outage = [j for j in run.causal.judgements if j.in_outage]
    driven = float(np.linalg.norm(np.diff([j.position for j in outage], axis=0), axis=1).sum())
    end = outage[-1]
    return {
        "start_s": start_s,
        "driven_m": driven,
        "end_m": float(np.hypot(end.error[0], end.error[1])),
        "yaw_deg": heading_error(run, messages, read_tum(truth_path), headings, end.stamp_ns),
    }


def heading_error(run: Replay, messages: list[Any], truth: Any, headings: dict[int, float], stamp_ns: int) -> float:
    """Heading against KITTI's truth (of the lidar, in its start frame), turned into W by the fixes so far [deg]."""
    world = run.estimator.world
    config = run.estimator.config
    lidar = load_config(HERE / "configs" / "kitti_00.yaml").T_I("lidar")
    T_L_I = gtsam.Pose3(lidar).inverse()
    poses = [
        gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), p) * T_L_I
        for p, (x, y, z, w) in zip(truth.positions, truth.quaternions, strict=True)
    ]
    track = np.array([pose.translation() for pose in poses])
    times = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    fixes = [m for m in messages if isinstance(m, GnssFix)]
    assert world is not None
    at = np.array([(m.stamp_ns - truth.stamps_ns[0]) * 1e-9 + config.sensors["gnss"].time_offset_s for m in fixes])
    inside = (at > times[0]) & (at < times[-1])
    enu = np.array([world.to_enu(Geodetic(m.latitude_deg, m.longitude_deg, m.altitude_m)) for m in fixes])[inside]
    on_track = np.column_stack([np.interp(at[inside], times, track[:, axis]) for axis in range(3)])
    pairs = [(a, b) for a, b in zip(enu, on_track, strict=True)]
    T_W_L0 = gtsam.Pose3.Align(pairs)
    k = int(np.argmin(np.abs(truth.stamps_ns - stamp_ns)))
    true_heading = float((T_W_L0.rotation() * poses[k].rotation()).rpy()[2])
    nearest = min(headings, key=lambda stamp: abs(stamp - int(truth.stamps_ns[k])))
    return float(np.degrees((headings[nearest] - true_heading + np.pi) % (2 * np.pi) - np.pi))


def print_outages(data: Path, left: str) -> None:
    """Print ten outages of a minute, spread evenly over the drive."""
    starts = np.linspace(20.0, 400.0, OUTAGES)
    bag, truth = data / "kitti_00" / "bag", data / "kitti_00" / "truth_lidar.tum"
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(one_outage, *zip(*[(left, bag, truth, start) for start in starts], strict=True)))
    print(f"\nkitti_00, GNSS cut for {OUTAGE_S:.0f} s, {left}")
    for row in rows:
        share = 100.0 * row["end_m"] / row["driven_m"]
        print(
            f"  from {row['start_s']:5.1f} s: driven {row['driven_m']:5.0f} m, end error {row['end_m']:7.2f} m"
            f" = {share:6.2f} %, heading {row['yaw_deg']:+.2f} deg"
        )
    shares = [100.0 * row["end_m"] / row["driven_m"] for row in rows]
    worst = max(abs(row["yaw_deg"]) for row in rows)
    print(f"  median {np.median(shares):.2f} %, worst {max(shares):.2f} %, worst heading {worst:.2f} deg")


def main() -> None:
    """Run what the data allows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=HERE.parent.parent / "shared" / "data")
    parser.add_argument("--only", choices=["held_out", "outages", "drives"], help="leave the other parts out")
    given = parser.parse_args()
    data: Path = given.data
    kitti, walk = data / "kitti_00" / "bag", data / "rtk_walk" / "bag"
    if given.only in (None, "held_out"):
        print_all_held_out(kitti, walk)
    if given.only in (None, "outages"):
        for left in LEFT if is_there(kitti) else ():
            print_outages(data, left)
    if given.only in (None, "drives"):
        print_drives(data / "drives")


def print_all_held_out(kitti: Path, walk: Path) -> None:
    """Print what every second fix says of the drive of KITTI and of the walk."""
    every_second = [HoldOut("gnss", 2)]
    alone = load_config(HERE / "configs" / "kitti_00_no_lidar.yaml")
    if is_there(kitti):
        config = load_config(HERE / "configs" / "kitti_00.yaml")
        print_held_out("kitti_00, every second fix held out", replay(config, kitti, every_second))
        by_sample = config.model_copy(update={"graph": config.graph.model_copy(update={"nodes": "imu"})})
        print_held_out("the same with a node per IMU sample", replay(by_sample, kitti, every_second))
        print_held_out("the same with IMU and GNSS alone", replay(alone, kitti, every_second))
    print_held_out("the drive in the gtsam wheel (IMU and GNSS)", replay(alone, Path("kitti"), every_second))
    if is_there(walk):
        fixed_only = load_config(HERE / "configs" / "rtk_walk.yaml")
        print_held_out("rtk_walk, every second fixed epoch held out", replay(fixed_only, walk, every_second))


def is_there(bag: Path) -> bool:
    """Return whether a recording is there, and say so if it is not."""
    if not bag.exists():
        print(f"\n{bag.parent.name}: skipped, no recording at {bag.parent}: give --data")
    return bag.exists()


if __name__ == "__main__":
    main()
