"""Prints what other sensors are worth: machines without a lidar, with two, with a prism, with every kind of fault.

`python benchmarks/machines.py` runs each scenario over some seeds, once with all sensors and once without those named.
Errors are against the truth of the simulation; GNSS is bad where it is degraded or silent;
where it never is, the worst error and the way are those of the whole run.

`wrong-lever-arm` is the beginning of `navigation` with the translation of one antenna wrong in the configuration only.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from holdfast.config.load import load_config
from holdfast.evaluation.states import States, state_errors
from holdfast.events import EventKind
from holdfast.sim.scenario import Scenario, load_scenario
from holdfast.sim.simulation import START_NS
from holdfast.trial.run import CONFIG, estimate, write_simulation
from holdfast.trial.truth import true_states

# scenario -> the sensors that are left out in turn
MACHINES: dict[str, tuple[tuple[str, ...], ...]] = {
    "wheels": ((), ("axle",), ("wheels",), ("wheels", "axle")),
    "two-lidars": ((), ("lidar_rear",)),
    "prism": ((),),
    "new-sensors": ((), ("wheels", "axle", "doppler", "markers", "prism", "mast")),
}
WRONG_ARM = "wrong-lever-arm"
WRONG_ARM_S, DRIVEN_S = 100.0, 40.0  # of the scenario, and from when on its errors are those after 30 s of driving
# by how much the configuration is wrong about `gnss_left` [m]: x lies across the baseline, y along it
WRONG_BY_M = ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.5), (0.3, 0.0, 0.0))
LOST = {EventKind.SENSOR_LOST, EventKind.RECEIVER_LOST, EventKind.ODOMETRY_JUMP, EventKind.ODOMETRY_SLIP}


@dataclass(frozen=True)
class Row:
    """Horizontal errors of one run: RMS outside the interval, RMS and maximum in it; and the distance driven in it."""

    outside_rms_m: float
    inside_rms_m: float
    worst_m: float
    driven_m: float
    named: tuple[str, ...]


def interval_s(scenario: Scenario) -> tuple[float, float]:
    """Return when GNSS is degraded or silent, as the scenario's faults say; empty where it never is."""
    antennas = {name for name, sheet in scenario.sensors.items() if sheet.kind == "gnss"}
    faults = [
        fault for fault in scenario.faults if fault.kind in ("outage", "degraded") and antennas & {*fault.sensors}
    ]
    if not faults:
        return 0.0, 0.0
    return min(fault.start_s for fault in faults), max(fault.end_s for fault in faults)


def run(name: str, left_out: tuple[str, ...], seed: int) -> Row:
    """Simulate, estimate without some sensors, and compare with the truth."""
    scenario = load_scenario(name)
    with TemporaryDirectory() as folder:
        simulation = write_simulation(scenario, seed, Path(folder))
        config = load_config(Path(folder) / CONFIG)
        sensors = {one: sensor for one, sensor in config.sensors.items() if one not in left_out}
        recorder = estimate(Path(folder), config.model_copy(update={"sensors": sensors}))
    poses = recorder.published().world.poses
    truth, _ = true_states(simulation, poses.stamps_ns)
    error_m = np.linalg.norm((poses.positions - truth.positions)[:, :2], axis=1)
    times_s = (poses.stamps_ns - START_NS) * 1e-9
    start_s, end_s = interval_s(scenario)
    inside = (times_s >= start_s) & (times_s < end_s)
    steps_m = np.linalg.norm(np.diff(truth.positions, axis=0, prepend=truth.positions[:1]), axis=1)
    named = sorted({f"{sensor} {kind}" for _, kind, sensor, _ in recorder.event_rows(0) if kind in LOST})
    return Row(
        outside_rms_m=float(np.sqrt(np.mean(error_m[~inside] ** 2))),
        inside_rms_m=float(np.sqrt(np.mean(error_m[inside] ** 2))) if inside.any() else float("nan"),
        worst_m=float(error_m[inside].max()) if inside.any() else float(error_m.max()),
        driven_m=float(steps_m[inside].sum()) if inside.any() else float(steps_m.sum()),
        named=tuple(named),
    )


def table(seeds: int, jobs: int, scenarios: list[str]) -> Iterator[str]:
    """Yield the rows in Markdown, mean over the seeds; the worst error is that of all seeds."""
    heads = ("GNSS good: RMS, mm", "GNSS bad: RMS, m", "worst, m", "driven, m", "worst / driven")
    yield f"| Scenario | Left out | {' | '.join(heads)} | Reported |"
    yield "|---|---|---:|---:|---:|---:|---:|---|"
    cases = [(name, left_out) for name in scenarios for left_out in MACHINES[name]]
    tasks = [(*case, seed) for case in cases for seed in range(seeds)]
    with ProcessPoolExecutor(jobs) as pool:
        done = pool.map(run, *zip(*tasks, strict=True))
        for name, left_out in cases:
            rows = [next(done) for _ in range(seeds)]
            worst_m, driven_m = max(row.worst_m for row in rows), float(np.mean([row.driven_m for row in rows]))
            inside_rms_m = float(np.mean([row.inside_rms_m for row in rows]))
            named = ", ".join(sorted({one for row in rows for one in row.named if not one.startswith("gnss")}))
            yield (
                f"| {name} | {', '.join(left_out) or '-'} | {1e3 * np.mean([row.outside_rms_m for row in rows]):.1f} | "
                f"{'-' if np.isnan(inside_rms_m) else f'{inside_rms_m:.3f}'} | {worst_m:.3f} | {driven_m:.0f} | "
                f"{100 * worst_m / driven_m:.2f} % | {named} |"
            )


@dataclass(frozen=True)
class WrongArmRow:
    """One run with a wrong lever arm: when it was found, and the worst errors afterwards."""

    found_s: float
    heading_deg: float
    horizontal_m: float
    vertical_m: float


def run_wrong_arm(off_m: tuple[float, float, float], seed: int) -> WrongArmRow:
    """Estimate with a lever arm that is wrong by so much, and compare with the truth."""
    scenario = load_scenario("navigation").model_copy(update={"duration_s": WRONG_ARM_S, "faults": ()})
    with TemporaryDirectory() as folder:
        simulation = write_simulation(scenario, seed, Path(folder))
        config = load_config(Path(folder) / CONFIG)
        links = [
            one.model_copy(update={"translation_m": tuple(np.add(one.translation_m, off_m))})
            if one.child == "gnss_left"
            else one
            for one in config.extrinsics
        ]
        recorder = estimate(Path(folder), config.model_copy(update={"extrinsics": links}))
    states = recorder.published().world
    poses, velocities = true_states(simulation, states.poses.stamps_ns)
    errors = state_errors(states, States(poses, velocities))
    late = (poses.stamps_ns - START_NS) * 1e-9 >= DRIVEN_S
    found_s = [time_s for time_s, kind, _, _ in recorder.event_rows(START_NS) if kind == EventKind.LEVER_ARM]
    return WrongArmRow(
        found_s=found_s[0] if found_s else float("nan"),
        heading_deg=float(np.degrees(abs(errors.attitude[late, 2]).max())),
        horizontal_m=float(np.linalg.norm(errors.position[late, :2], axis=1).max()),
        vertical_m=float(abs(errors.position[late, 2]).max()),
    )


def wrong_arm_table(seeds: int, jobs: int) -> Iterator[str]:
    """Yield the rows in Markdown, the worst of the seeds."""
    yield "| `gnss_left` wrong by x, y, z, m | named after, s | heading, deg | horizontal, m | vertical, m |"
    yield "|---|---:|---:|---:|---:|"
    with ProcessPoolExecutor(jobs) as pool:
        done = pool.map(run_wrong_arm, *zip(*[(off_m, s) for off_m in WRONG_BY_M for s in range(seeds)], strict=True))
        for off_m in WRONG_BY_M:
            rows = [next(done) for _ in range(seeds)]
            found_s = max(row.found_s for row in rows)
            named = "never" if np.isnan(found_s) else f"{found_s:.1f}"
            off = ", ".join(f"{number:g}" for number in off_m)
            worst = " | ".join(
                f"{max(getattr(row, error) for row in rows):.{digits}f}"
                for error, digits in (("heading_deg", 2), ("horizontal_m", 3), ("vertical_m", 3))
            )
            yield f"| {off} | {named} | {worst} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    names = [*MACHINES, WRONG_ARM]
    parser.add_argument("scenarios", nargs="*", default=names, help=f"of {', '.join(names)}")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    machines = [name for name in options.scenarios if name != WRONG_ARM]
    lines = [table(options.seeds, options.jobs, machines)] if machines else []
    if WRONG_ARM in options.scenarios:
        lines.append(wrong_arm_table(options.seeds, options.jobs))
    for line in chain.from_iterable(lines):
        print(line, flush=True)


if __name__ == "__main__":
    main()
