"""Prints how good and how fast each lidar odometry is, as docs/results/lidar-odometry.md quotes it.

    holdfast simulate construction --scans -o site
    python benchmarks/lidar_odometry.py site ...

Every folder is one that `holdfast simulate --scans` wrote: recording.mcap, config.yaml and truth/.
"""

import argparse
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import gtsam
import numpy as np

import holdfast
from holdfast.config.load import load_config
from holdfast.evaluation.association import Pairs, associate
from holdfast.evaluation.relative import rpe
from holdfast.lidar_odometry.inertial_guide import ImuSamples
from holdfast.lidar_odometry.registration import METHODS
from holdfast.lidar_odometry.runner import Options, choose_topic, guide_of, settings_of_options
from holdfast.lidar_odometry.scan_odometry import ScanOdometry
from holdfast.recording.decode import stamp_ns
from holdfast.recording.kinds.scans import point_cloud
from holdfast.recording.raw import RawBag
from holdfast.recording.tum import read_tum
from holdfast.state import Trajectory

STEP_M = 10.0
SLEWS_RAD_S = 0.005  # the turn joint moves
SETTLE_S = 0.4
GNSS = ("gnss", "heading", "gnss_velocity")
COMMAND = "from holdfast.cli import main; main()"
HEADER = (
    "| recording | method | drift over 10 m | end | yaw per slew, rms | worst | yaw at the end "
    "| between sweeps, rms | ms, median | p99 | ms of processor, median | p99 |\n" + "|---" * 12 + "|"
)


def register(folder: Path, method: str, imu_helps: bool, threads: int, seconds: float) -> tuple:
    """Return the trajectory of one method and its times a scan [ms], on the wall and of the processor."""
    options = Options(method=method, threads=threads, replace=True)
    stamps_ns, positions, quaternions, times_ms, samples = [], [], [], [], []
    with RawBag(folder / "recording.mcap") as bag:
        topic = choose_topic(bag, options)
        guide = guide_of(load_config(folder / "config.yaml"), bag, options) if imu_helps else None
        odometry = ScanOdometry(settings_of_options(options) if guide is None else guide.settings)
        wanted = {topic} if guide is None else {topic, guide.imu_topic}
        codecs = {channel: channel.codec() for channel in bag.channels if channel.topic in wanted}
        for arrival_ns, channel, raw in bag.messages():
            if arrival_ns > bag.recording.start_ns + seconds * 1e9:
                break
            if channel not in codecs:
                continue
            message = codecs[channel].deserialize(raw)
            if channel.topic != topic:
                samples.append(guide.decode(message, arrival_ns))
                continue
            scan = point_cloud(stamp_ns(message), arrival_ns, "", message)
            began_s, cpu_s = perf_counter(), process_time()
            registered = odometry.register(scan, ImuSamples.of(samples))
            times_ms.append(((perf_counter() - began_s) * 1e3, (process_time() - cpu_s) * 1e3))
            samples.clear()
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
        f"{e['drift_percent']:.3f} %",
        f"{e['end_m']:.3f} m = {e['end_percent']:.2f} %",
        f"{e['slew_rms_deg']:.3f} deg",
        f"{e['slew_worst_deg']:.3f} deg",
        f"{e['end_yaw_deg']:+.3f} deg",
        f"{e['step_mm']:.1f} mm, {e['step_mrad']:.2f} mrad",
        *(f"{np.percentile(times_ms[:, k], q):.0f}" for k in (0, 1) for q in (50, 99)),
    ]
    return "| " + " | ".join(cells).replace("nan deg", "-").replace("nan %", "-") + " |"


def estimator_rows(folder: Path, seconds: float) -> Iterator[str]:
    """Yield what the estimate is worth with an odometry made beforehand, and with one made of the scans as it goes.

    GNSS is cut for the second half, where the odometry alone holds the estimate. Errors are horizontal, of the
    published track against the truth.
    """
    config = load_config(folder / "config.yaml").model_dump(mode="json", exclude_unset=True)
    truth = read_tum(folder / "truth" / "imu_in_world.tum")
    with RawBag(folder / "recording.mcap") as bag:
        recorded_s = (bag.recording.end_ns - bag.recording.start_ns) * 1e-9
        clouds = choose_topic(bag, Options(replace=True))
    length_s = min(seconds, recorded_s)
    cut = {name: (length_s / 2.0, length_s) for name, one in config["sensors"].items() if one["kind"] in GNSS}
    lidar = next(name for name, one in config["sensors"].items() if one["kind"] == "odometry")
    scans = config["sensors"][lidar] | {"kind": "scans", "topic": clouds}
    from_scans = config | {"sensors": config["sensors"] | {lidar: scans}}
    with TemporaryDirectory() as work:
        made = Path(work) / "odometry.mcap"
        make = ["lidar-odometry", folder / "recording.mcap", "-o", made, "-c", folder / "config.yaml", "--replace"]
        subprocess.run([sys.executable, "-c", COMMAND, *map(str, make)], check=True, capture_output=True)
        runs = {
            "made beforehand": (made, config),
            "made of scans in the replay": (folder / "recording.mcap", from_scans),
        }
        for title, (recording, settings) in runs.items():
            result = holdfast.replay(
                recording, settings, outage=cut, duration_s=seconds if length_s == seconds else None
            )
            track = Trajectory(result.world.stamps_ns, result.world.positions, result.world.quaternions_xyzw)
            dense = associate(truth, track)
            off_m = np.linalg.norm((dense.estimate.positions - dense.reference.positions)[:, :2], axis=1)
            late = (dense.reference.stamps_ns - truth.stamps_ns[0]) * 1e-9 > length_s / 2.0
            found = [float(np.sqrt(np.mean(part**2))) for part in (off_m[~late], off_m[late])] + [off_m[-1]]
            yield f"| {folder.name} | {title} | " + " | ".join(f"{error * 1e3:.1f} mm" for error in found) + " |"


def main() -> None:
    """Run every method on every recording, each in a fresh process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="written by holdfast simulate --scans")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of each recording")
    parser.add_argument("--estimator", action="store_true", help="compare estimates instead, GNSS cut at half time")
    arguments = parser.parse_args()
    if arguments.estimator:
        print("| recording | odometry | horizontal RMS with GNSS | without | at the end |\n|---|---|---|---|---|")
        for folder in arguments.folders:
            for row in estimator_rows(folder, arguments.seconds):
                print(row, flush=True)
        return
    print(HEADER)
    for folder, method in product(arguments.folders, arguments.methods):
        for helped in (False, True) if method == "small-gicp" else (False,):
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                task = (folder, method, helped, arguments.threads, arguments.seconds)
                track, times_ms = pool.submit(register, *task).result()
            print(line(folder, method + " with the IMU" * helped, track, times_ms), flush=True)


if __name__ == "__main__":
    main()
