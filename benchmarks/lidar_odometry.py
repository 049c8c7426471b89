"""Prints how good and how fast each lidar odometry is, as docs/results.md quotes it.

    holdfast simulate construction --scans -o site
    python benchmarks/lidar_odometry.py site ...

Every folder is one that `holdfast simulate --scans` wrote: recording.mcap, config.yaml and truth/.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter

import gtsam
import numpy as np

from holdfast.config.load import load_config
from holdfast.evaluation.association import Pairs, associate
from holdfast.evaluation.relative import rpe
from holdfast.lidar_odometry.gyroscope import Gyroscope
from holdfast.lidar_odometry.masked import Masked, Masking
from holdfast.lidar_odometry.reader import SweepReader
from holdfast.lidar_odometry.registration import METHODS, make_registration
from holdfast.lidar_odometry.runner import Options, choose_topic
from holdfast.recording.raw import RawBag
from holdfast.recording.tum import read_tum
from holdfast.state import Trajectory

STEP_M = 10.0
SLEWS_RAD_S = 0.005  # the turn joint moves
SETTLE_S = 0.4
HEADER = (
    "| recording | method | drift over 10 m | end | yaw per slew, rms | worst | yaw at the end "
    "| between sweeps, rms | ms, median | p95 |\n|---|---|---|---|---|---|---|---|---|---|"
)


def register(folder: Path, method: str, gyroscope_helps: bool, threads: int, seconds: float) -> tuple:
    """Return the trajectory of one method and its times a sweep [ms]; runs in a process of its own."""
    registration = Masked(make_registration(method, threads), Masking())
    stamps_ns, positions, quaternions, times_ms = [], [], [], []
    options = Options(replace=True)
    with RawBag(folder / "recording.mcap") as bag:
        topic = choose_topic(bag, options)
        gyroscope = (
            Gyroscope(load_config(folder / "config.yaml"), bag, options.output_topic) if gyroscope_helps else None
        )
        reader = SweepReader(bag, topic, options.min_range_m, gyroscope)
        for arrival_ns, channel, raw in bag.messages():
            if arrival_ns > bag.recording.start_ns + seconds * 1e9:
                break
            sweep = reader.take(arrival_ns, channel, raw)
            if sweep is None:
                continue
            began_s = perf_counter()
            registered = registration.register(sweep)
            times_ms.append((perf_counter() - began_s) * 1e3)
            pose = gtsam.Pose3(registered.T_L0_L)
            stamps_ns.append(registered.stamp_ns)
            positions.append(pose.translation())
            quaternions.append(pose.rotation().toQuaternion().coeffs())
    return Trajectory(np.array(stamps_ns), np.array(positions), np.array(quaternions)), np.array(times_ms)


def poses(trajectory: Trajectory) -> list[gtsam.Pose3]:
    """Return the poses of a trajectory."""
    rows = zip(trajectory.positions, trajectory.quaternions, strict=True)
    return [gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), p) for p, (x, y, z, w) in rows]


def slews(folder: Path, stamps_ns: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and the last pose of each movement of the turn joint, from standstill to standstill."""
    file = folder / "truth" / "joint.csv"
    if not file.exists():
        return []
    joint = np.genfromtxt(file, delimiter=",", skip_header=1, dtype=[("ns", "i8"), ("angle", "f8"), ("rate", "f8")])
    moving = np.interp(stamps_ns, joint["ns"], np.abs(joint["rate"])) > SLEWS_RAD_S
    settle = max(1, round(SETTLE_S * 1e9 / np.median(np.diff(stamps_ns))))
    edges = np.flatnonzero(np.diff(np.r_[False, moving, False].astype(np.int8)))
    pairs = [(begin - settle, end + settle) for begin, end in edges.reshape(-1, 2)]
    return [(begin, end) for begin, end in pairs if begin >= 0 and end < len(stamps_ns)]


def judge(folder: Path, track: Trajectory) -> dict[str, float]:
    """Return the errors of one trajectory against the truth."""
    truth = read_tum(folder / "truth" / "lidar_in_world.tum")
    dense = associate(truth, track)  # the truth, which is dense, at the stamps of the track
    pairs = Pairs(dense.reference, dense.estimate, True, dense.reference_start_ns)
    drift = rpe(pairs, STEP_M).errors["translation_percent"]
    ours, theirs = poses(pairs.estimate), poses(pairs.reference)
    T_W_L0 = theirs[0].compose(ours[0].inverse())
    misses = [their.between(T_W_L0.compose(our)) for our, their in zip(ours, theirs, strict=True)]
    yaw_deg = np.degrees(
        [
            their.rotation().rotate(gtsam.Rot3.Logmap(miss.rotation()))[2]
            for their, miss in zip(theirs, misses, strict=True)
        ]
    )
    turns_deg = [yaw_deg[end] - yaw_deg[begin] for begin, end in slews(folder, pairs.reference.stamps_ns)] or [np.nan]
    steps = [
        gtsam.Pose3.Logmap(a.between(b).between(c.between(d)))
        for a, b, c, d in zip(theirs, theirs[1:], ours, ours[1:], strict=False)
    ]
    step_rad, step_m = (np.sqrt(np.mean(np.sum(np.square(part), axis=1))) for part in np.split(np.array(steps), 2, 1))
    end_m = float(np.linalg.norm(misses[-1].translation()))
    return {
        "drift_percent": float(np.median(drift)) if len(drift) else np.nan,
        "end_m": end_m,
        "end_percent": 100.0 * end_m / float(pairs.driven_m()[-1]),
        "slew_rms_deg": float(np.sqrt(np.mean(np.square(turns_deg)))),
        "slew_worst_deg": float(np.max(np.abs(turns_deg))),
        "end_yaw_deg": float(yaw_deg[-1]),
        "step_mm": 1e3 * float(step_m),
        "step_mrad": 1e3 * float(step_rad),
    }


def line(folder: Path, title: str, track: Trajectory, times_ms: np.ndarray) -> str:
    """Return one row of the table."""
    e = judge(folder, track)
    cells = [
        folder.name,
        title,
        f"{e['drift_percent']:.2f} %",
        f"{e['end_m']:.3f} m = {e['end_percent']:.2f} %",
        f"{e['slew_rms_deg']:.3f} deg",
        f"{e['slew_worst_deg']:.3f} deg",
        f"{e['end_yaw_deg']:+.3f} deg",
        f"{e['step_mm']:.1f} mm, {e['step_mrad']:.2f} mrad",
        f"{np.median(times_ms):.0f}",
        f"{np.percentile(times_ms, 95):.0f}",
    ]
    return "| " + " | ".join(cells).replace("nan deg", "-").replace("nan %", "-") + " |"


def main() -> None:
    """Run every method on every recording, each in a fresh process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="written by holdfast simulate --scans")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of each recording")
    arguments = parser.parse_args()
    print(HEADER)
    for folder, method in product(arguments.folders, arguments.methods):
        for helped in (False, True) if method == "small-gicp" else (False,):
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                task = (folder, method, helped, arguments.threads, arguments.seconds)
                track, times_ms = pool.submit(register, *task).result()
            print(line(folder, method + " with gyroscope" * helped, track, times_ms), flush=True)


if __name__ == "__main__":
    main()
