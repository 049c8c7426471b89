"""Prints what loop closures gain in an outage, as docs/results/whole-recording.md quotes it.

    holdfast simulate benchmarks/yard_rounds.yaml --scans -o yard
    python benchmarks/loop_closures.py yard

Every folder is one that `holdfast simulate --scans` wrote. The estimator's track is smoothed without and with closures
and judged by the truth; so are the closures themselves.
"""

import argparse
from pathlib import Path
from time import process_time

import gtsam
import numpy as np

from holdfast.config.load import load_config
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.evaluation import quaternions
from holdfast.loops.opening import loop_closer
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.recording.tum import read_tum
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.smoothing.closures import Closure, Found, Stretch
from holdfast.state import Trajectory


def pose_at(truth: Trajectory, time_ns: int) -> gtsam.Pose3:
    """Return the true pose at the sample nearest to a time."""
    row = int(np.argmin(np.abs(truth.stamps_ns - time_ns)))
    x, y, z, w = truth.quaternions[row]
    return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), truth.positions[row])


def print_closures(closures: list[Closure], truth: Trajectory) -> None:
    """Print how far the closures are off, and what they claim."""
    off, nees = [], []
    for one in closures:
        true = pose_at(truth, one.earlier_ns).between(pose_at(truth, one.later_ns))
        off.append(gtsam.Pose3.Logmap(true.between(one.T)))
        nees.append(off[-1] @ np.linalg.solve(one.covariance, off[-1]) / 6.0)
    if off:
        rotation, translation = np.split(np.abs(off), 2, axis=1)
        print(
            f"  {len(off)} closures: rotation RMS {1e3 * np.sqrt(np.mean(rotation**2)):.2f} mrad, translation RMS "
            f"{1e3 * np.sqrt(np.mean(translation**2)):.1f} mm per axis, worst {1e3 * translation.max():.1f} mm, "
            f"NEES/6 {np.mean(nees):.2f}"
        )


def smoothed(folder: Path, config: Config, truth: Trajectory) -> BatchSmoother:
    """Return the optimum over a recording, with closures if the configuration allows."""
    with (
        open_recording(folder / "recording.mcap") as recording,
        loop_closer(folder / "recording.mcap", recording, config, lambda time_ns: time_ns) as closer,
    ):

        def told(stretch: Stretch) -> Found:
            assert closer is not None
            began_s, found = process_time(), closer(stretch)
            print(f"  {dict(found.counts)} in {process_time() - began_s:.1f} s of CPU time")
            print_closures(list(found.closures), truth)
            return found

        batch = BatchSmoother(config, closer=None if closer is None else told)
        estimator = Estimator(config, batch)
        for message in recording.read(subscriptions(config)):
            estimator.process(message)
        batch.stop()
    return batch


def print_errors(batch: BatchSmoother, truth: Trajectory, start_s: float, end_s: float) -> None:
    """Print the errors within a time [s] of the recording."""
    blocks = batch.take()
    times = np.concatenate([block.track.times_ns for block in blocks])
    positions = np.concatenate([block.track.positions for block in blocks])
    attitudes = np.concatenate([block.track.quaternions for block in blocks])
    covariances = np.concatenate([block.covariances.at(block.track.times_ns) for block in blocks])
    _, ours, theirs = np.intersect1d(times, truth.stamps_ns, return_indices=True)
    seconds = (times[ours] - truth.stamps_ns[0]) * 1e-9
    inside = (seconds > start_s) & (seconds < end_s)
    off = (positions[ours] - truth.positions[theirs])[inside]
    local = quaternions.rotate(quaternions.conjugate(attitudes[ours][inside]), off)
    P = covariances[ours][inside][:, 3:6, 3:6]
    nees = np.einsum("ni,ni->n", local, np.linalg.solve(P, local[..., None])[..., 0]).mean() / 3.0
    horizontal, vertical = np.sqrt(np.square(off[:, :2]).sum(axis=1).mean()), np.sqrt(np.square(off[:, 2]).mean())
    print(f"  outage: horizontal {1e3 * horizontal:.1f} mm, vertical {1e3 * vertical:.1f} mm, NEES/3 {nees:.2f}")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="written by holdfast simulate --scans")
    parser.add_argument("--outage", type=float, nargs=2, default=(40.0, 120.0), metavar=("START", "END"), help="[s]")
    given = parser.parse_args()
    for folder in given.folders:
        config, truth = load_config(folder / "config.yaml"), read_tum(folder / "truth" / "imu_in_world.tum")
        for closes in (False, True):
            print(f"{folder.name}, {'with' if closes else 'without'} loop closures")
            smoothing = config.smoothing.model_copy(update={"loop_closures": closes})
            batch = smoothed(folder, config.model_copy(update={"smoothing": smoothing}), truth)
            print_errors(batch, truth, *given.outage)


if __name__ == "__main__":
    main()
