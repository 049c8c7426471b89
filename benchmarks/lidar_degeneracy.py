"""Prints how the estimate fares where scans hold nothing along the way, over seeds, as docs/results quotes it.

    python benchmarks/lidar_degeneracy.py gallery --seeds 10

A scenario is simulated with its scans, `lidar-odometry` makes the odometry of them, and the estimator replays it. Along
the way is east, as the gallery lies.
"""

import argparse
from pathlib import Path
from subprocess import run
from sys import executable
from tempfile import TemporaryDirectory

import numpy as np

import holdfast
from holdfast.api.trajectory import Trajectory

CHILD = "from holdfast.cli import main\nif __name__ == '__main__':\n    main()\n"


def measure(scenario: str, seed: int, folder: Path) -> tuple[float, float, float]:
    """Return the largest error along the way [m], its sigma then [m], and the largest ratio of both."""
    script = folder / "command.py"
    script.write_text(CHILD, encoding="utf-8")
    site = folder / "site"
    command = [executable, str(script)]
    run(
        [*command, "simulate", scenario, "-o", str(site), "--scans", "--seed", str(seed)],
        check=True,
        capture_output=True,
    )
    config, odometry = site / "config.yaml", site / "odometry.mcap"
    bag = site / "recording.mcap"
    arguments = ["lidar-odometry", str(bag), "-o", str(odometry), "-c", str(config), "--replace"]
    run([*command, *arguments], check=True, capture_output=True)
    estimate = holdfast.replay(odometry, config).world
    truth = Trajectory.read(site / "truth" / "imu_in_world.tum").interpolate(estimate.stamps_ns)
    error = np.abs(estimate.positions[:, 0] - truth.positions[:, 0])
    sigma = estimate.sigmas_m()[:, 0]
    worst = int(error.argmax())
    late = estimate.times_s > 1.0  # the start
    return float(error[worst]), float(sigma[worst]), float((error / sigma)[late].max())


def main() -> None:
    """Run every seed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    arguments = parser.parse_args()
    print("| scenario, seed | largest error along the way | its sigma | largest error / sigma |\n|---|---|---|---|")
    held = 0
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        with TemporaryDirectory() as folder:
            error_m, sigma_m, ratio = measure(arguments.scenario, seed, Path(folder))
        held += ratio <= 3.0
        print(f"| {arguments.scenario}, {seed} | {error_m:.2f} m | {sigma_m:.2f} m | {ratio:.1f} |", flush=True)
    print(f"\nwithin 3 sigma throughout: {held} of {arguments.seeds}")


if __name__ == "__main__":
    main()
