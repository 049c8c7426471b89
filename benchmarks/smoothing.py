"""Prints what `holdfast smooth` gains over the causal estimate: `python benchmarks/smoothing.py`.

On the real drives at fixes that were held out, every second one and, as a harder judge, all within blocks of ten
seconds; on the simulator's scenarios by the truth, while GNSS is good and in outages. docs/results quotes it.
"""

import argparse
import resource
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np

from holdfast.config.load import config_of, load_config
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.evaluation.consistency import nees
from holdfast.evaluation.outages import nominal, norm_rms, outage_spans, within
from holdfast.evaluation.spans import Span
from holdfast.evaluation.states import States, state_errors
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.held_out import HoldOut
from holdfast.replay.published import PublishedRecorder
from holdfast.replay.runner import Replay
from holdfast.replay.summary import summarise_replay
from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import load_scenario
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.state import Trajectory
from holdfast.trial.run import RECORDING, write_simulation
from holdfast.trial.truth import truth

HERE = Path(__file__).parent
EVERY_SECOND = [HoldOut("gnss", 2)]
BLOCKS = [HoldOut("gnss", None, start_s, start_s + 10.0) for start_s in range(30, 440, 25)]
LOOSE = {"accelerometer_noise_density": 0.05}
"""An accelerometer that is trusted less than by default; it was chosen on these two drives."""
SCENARIOS = ("construction", "navigation")


def print_held_out(title: str, config: Config, bag: Path, rules: list[HoldOut]) -> None:
    """Print the errors at held-out fixes of the causal estimate, the fixed-lag smoother and the optimum."""
    batch, began_s = BatchSmoother(config), process_time()
    run = Replay(config, None, rules, batch=batch)
    with open_recording(bag) as recording:
        run.run(recording.read(subscriptions(config)))
    factor = run.timing.recorded_s / (process_time() - began_s)
    print(f"\n{title} ({factor:.0f} x real time by CPU time, optimum {batch.wall_s:.1f} s)")
    for track, parts in summarise_replay(run, title, [], True)["held_out"].items():
        for part, errors in (parts or {}).items():
            h, v, n = errors["horizontal_m"], errors["vertical_m"], errors["nees_per_dof"]
            text = "" if n is None else f"  NEES/3 {n:.2f}"
            print(
                f"  {track:9s} {part:8s} n {h['count']:4d}  horizontal RMS {h['rms']:.4f}  p95 {h['p95']:.3f}"
                f"  max {h['max']:.3f}  vertical RMS {v['rms']:.4f} m{text}"
            )


def loosened(config: Config) -> Config:
    """Return a configuration whose accelerometer is trusted less."""
    imu = config.imu.model_copy(update=LOOSE)
    return config.model_copy(update={"sensors": config.sensors | {config.imu_name: imu}})


def print_drives(data: Path) -> None:
    """Print what the real drives say."""
    drives = [("kitti_00", data / "kitti_00" / "bag"), ("rtk_walk", data / "rtk_walk" / "bag")]
    for name, bag in drives:
        if not bag.exists():
            print(f"\n{name}: skipped, no recording at {bag}: give --data")
            continue
        config = load_config(HERE / "configs" / f"{name}.yaml")
        for how, used in (("", config), (f", {LOOSE}", loosened(config))):
            print_held_out(f"{name}, every second fix held out{how}", used, bag, EVERY_SECOND)
            if name == "kitti_00":
                print_held_out(f"{name}, blocks of 10 s held out{how}", used, bag, BLOCKS)
    alone = load_config(HERE / "configs" / "kitti_00_no_lidar.yaml")
    print_held_out("the drive in the gtsam wheel, every second fix held out", alone, Path("kitti"), EVERY_SECOND)


def scenario_scores(scenario: str, seed: int) -> dict[tuple[str, str], np.ndarray]:
    """Return the scores of causal estimate and optimum, by estimate and circumstance."""
    loaded = load_scenario(scenario)
    config = config_of({"preset": "holdfast"} | configuration_data(loaded, seed), scenario)
    batch = BatchSmoother(config)
    recorder = PublishedRecorder(config, Estimator(config, batch))
    with TemporaryDirectory() as folder:
        simulation = write_simulation(loaded, seed, Path(folder))
        began_s = process_time()
        with open_recording(Path(folder) / RECORDING) as recording:
            recorder.run(recording.read(subscriptions(config)))
        batch.stop()
    factor = recorder.timing.recorded_s / (process_time() - began_s)
    published, blocks = recorder.published(), batch.take()
    stamps = np.concatenate([block.track.times_ns for block in blocks])
    optimum = States(
        Trajectory(
            stamps,
            np.concatenate([block.track.positions for block in blocks]),
            np.concatenate([block.track.quaternions for block in blocks]),
        ),
        np.concatenate([block.track.velocities for block in blocks]),
    )
    covariances = np.concatenate([block.covariances.at(block.track.times_ns) for block in blocks])
    both, ours, theirs = np.intersect1d(published.world.poses.stamps_ns, stamps, return_indices=True)
    true = truth(simulation, config, both)
    times_s = true.seconds(both)
    spans = outage_spans(true, Span(float(times_s[0]), float(times_s[-1])))
    found = {}
    for name, states, P in (
        ("causal", _rows(published.world, ours), published.covariances[ours]),
        ("smooth", _rows(optimum, theirs), covariances[theirs]),
    ):
        errors = state_errors(states, true.states)
        for when, rows in (("good", nominal(times_s, spans)), ("outage", within(times_s, spans))):
            if rows.any():
                found[name, when] = _scores(errors, P, rows, factor)
    return found


def _rows(states: States, rows: np.ndarray) -> States:
    poses = states.poses
    kept = Trajectory(poses.stamps_ns[rows], poses.positions[rows], poses.quaternions[rows])
    return States(kept, states.velocities[rows])


def _scores(errors, covariances, rows, factor) -> np.ndarray:
    p, a = errors.position[rows], np.degrees(errors.attitude[rows])
    blocks = [slice(k, k + 3) for k in (0, 3, 6)]
    consistent = [float(nees(errors.tangent[rows, b], covariances[rows, b, b]).mean()) / 3.0 for b in blocks]
    tilt = norm_rms(a[:, :2]) / np.sqrt(2.0)
    return np.array([1e3 * norm_rms(p[:, :2]), 1e3 * norm_rms(p[:, 2:]), tilt, norm_rms(a[:, 2:]), *consistent, factor])


def print_scenarios(scenarios: list[str], seeds: int) -> None:
    """Print means over seeds, and how the optimum compares with the causal estimate."""
    for scenario in scenarios:
        runs = [scenario_scores(scenario, seed) for seed in range(seeds)]
        print(f"\n{scenario}, {seeds} seeds: mean (worst)")
        for key in runs[0]:
            scores = np.array([run[key] for run in runs if key in run])
            mean, worst = scores.mean(axis=0), scores.max(axis=0)
            print(
                f"  {key[0]:7s} {key[1]:7s} horizontal {mean[0]:6.1f} ({worst[0]:.1f}) mm  vertical {mean[1]:6.1f} mm"
                f"  roll, pitch {mean[2]:.3f} ({worst[2]:.3f}) deg  yaw {mean[3]:.3f} deg"
                f"  NEES/3 attitude {mean[4]:.2f} position {mean[5]:.2f} velocity {mean[6]:.2f}"
            )
        for when in ("good", "outage"):
            pairs = [(run["smooth", when], run["causal", when]) for run in runs if ("smooth", when) in run]
            if pairs:
                ratio = np.array([a[:4] / b[:4] for a, b in pairs])
                print(
                    f"  smooth / causal, {when}: horizontal {ratio[:, 0].mean():.2f} (worst {ratio[:, 0].max():.2f})"
                    f"  vertical {ratio[:, 1].mean():.2f}  roll, pitch {ratio[:, 2].mean():.2f}"
                )
        factors = [run["causal", "good"][-1] for run in runs]
        print(f"  {min(factors):.0f} to {max(factors):.0f} x real time by CPU time, both estimates together")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=HERE.parent.parent / "shared" / "data")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", choices=["drives", "scenarios"], help="leave the other part out")
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    given = parser.parse_args()
    if given.only in (None, "drives"):
        print_drives(given.data)
    if given.only in (None, "scenarios"):
        print_scenarios(given.scenarios, given.seeds)
    print(f"\npeak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
