"""Prints what four mishaps at once cost on random machines: `python benchmarks/machine_mishaps.py --count 80`.

A seed is a machine of `random_machines.py`, of which the configuration knows the mounts and no more, with up to five
sensors more: wheels, a prism, a mast, markers, a camera. To two of its sensors something happens (`sensor_mishaps.py`,
`odometry_mishaps.py`), two things more to the IMU and to GNSS, which is lost for 30 s on top of that. The truth of the
simulation judges while fixes come, from `SETTLED_S` after the start or an outage on. A simulated IMU filters nothing:
of one whose samples are left out the engine shakes the rest, as no real one's.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from further_mishaps import FURTHER, claims_of_velocity, clock_step
from mishaps import MISHAPS, Messages, Mishap, any_mount, late_start, no_velocities
from odometry_mishaps import ODOMETRY
from sensor_mishaps import OF_KIND

from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.errors import HoldfastError
from holdfast.evaluation.states import States, state_errors
from holdfast.messages import Array, GnssFix, ImuSample, SensorPose
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import PublishedRecorder
from holdfast.sim.random_machine import random_machine
from holdfast.sim.simulation import Simulation
from holdfast.trial.run import RECORDING, write_simulation
from holdfast.trial.truth import true_states

OTHERS = [one for one in MISHAPS + FURTHER if one not in {no_velocities, claims_of_velocity, any_mount, clock_step}]
SETTLED_S, GAP_S = 10.0, 3.0
WRONG_M = 0.3


class Judged(NamedTuple):
    """What a machine made of its mishaps: RMS and largest error, and how much of the time it was `WRONG_M` wrong."""

    happened: str
    rms_m: float = np.nan
    largest_m: float = np.nan
    wrong: float = np.nan
    heading_deg: float = np.nan


def happen(rng: np.random.Generator, config: Config, messages: Messages) -> tuple[Messages, str]:
    """Return the messages after four mishaps, and what happened."""
    kinds: dict[str, Any] = {}
    for one in messages:
        kinds.setdefault(one.sensor, type(one))
    mishaps = {name: ODOMETRY if kind is SensorPose else OF_KIND.get(kind, ()) for name, kind in sorted(kinds.items())}
    able = [name for name, known in mishaps.items() if known and name != config.imu_name]
    happened = []
    for name in rng.choice(able, min(2, len(able)), replace=False) if able else []:
        mishap = mishaps[str(name)][int(rng.integers(len(mishaps[str(name)])))]
        messages, what = among(messages, {str(name)}, mishap, rng)
        happened.append(f"{name} {what}")
    inertial = {name for name, kind in kinds.items() if kind is ImuSample}
    for number in sorted(rng.choice(len(OTHERS), 2, replace=False)):
        # the second IMU goes on as it is
        to = kinds.keys() - (inertial - {config.imu_name} if OTHERS[number] is not late_start else set())
        messages, what = among(messages, to, OTHERS[number], rng)
        happened.append(what)
    return messages, ", ".join(happened)


def among(messages: Messages, names: Any, mishap: Mishap, rng: np.random.Generator) -> tuple[Messages, str]:
    """Return the messages after what happens to some sensors, as long as the recording lasts."""
    ends = [one for one in (messages[0], messages[-1]) if one.sensor not in names]
    mine = sorted([*(one for one in messages if one.sensor in names), *ends], key=lambda one: one.arrival_ns)
    after, what = mishap(rng, mine)
    others = [one for one in messages if one.sensor not in names]
    kept = [one for one in after if one.sensor in names]
    return sorted([*others, *kept], key=lambda one: one.arrival_ns), what


def prepared(seed: int, folder: Path) -> tuple[Config, Simulation, Messages, str]:
    """Return the machine of a seed with its messages after what happened.

    Raises:
        HoldfastError: there is no such machine.
    """
    machine = random_machine(seed, further=True)
    config = config_of(machine.configuration, f"random machine {seed}")
    simulation = write_simulation(machine.scenario, seed, folder)
    with open_recording(folder / RECORDING) as opened:
        messages = list(opened.read(subscriptions(config)))
    return config, simulation, *happen(np.random.default_rng(seed), config, messages)


def while_fixes_come(messages: Messages, stamps_ns: Array) -> Array:
    """Return at which stamps (N,) fixes have come for `SETTLED_S`, after as much since the first."""
    fixes = np.sort([one.arrival_ns for one in messages if isinstance(one, GnssFix)])
    settled_ns, gap_ns = round(SETTLED_S * 1e9), round(GAP_S * 1e9)
    good: Array = (stamps_ns > stamps_ns[0] + settled_ns) & (stamps_ns < fixes[-1] + gap_ns)
    for k in np.flatnonzero(np.diff(fixes) > gap_ns):
        good &= ~((stamps_ns > fixes[k] + gap_ns) & (stamps_ns < fixes[k + 1] + settled_ns))
    return good


def run(seed: int) -> Judged:
    """Return what the machine of a seed made of its mishaps."""
    with TemporaryDirectory() as folder:
        try:
            config, simulation, messages, happened = prepared(seed, Path(folder))
        except HoldfastError as error:
            return Judged(f"no such machine: {error}")
    recorder = PublishedRecorder(config)
    recorder.run(messages)
    if not recorder.lives():
        return Judged(f"{happened}: never started")
    world = recorder.published().world
    stamps_ns = world.poses.stamps_ns
    errors = state_errors(world, States(*true_states(simulation, stamps_ns)))
    good = while_fixes_come(messages, stamps_ns)
    if not good.any():
        return Judged(f"{happened}: nothing to judge")
    horizontal, heading = np.hypot(*errors.position[good, :2].T), np.degrees(errors.attitude[good, 2])
    rms_m, heading_deg = (float(np.sqrt(np.mean(one**2))) for one in (horizontal, heading))
    return Judged(happened, rms_m, float(horizontal.max()), float(np.mean(horizontal > WRONG_M)), heading_deg)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--count", type=int, default=24)
    given = parser.parse_args()
    print(f"| seed | mishaps | RMS [m] | largest [m] | beyond {WRONG_M:g} m | heading RMS [deg] |")
    print("|---:|---|---:|---:|---:|---:|")
    seeds, found = range(given.first, given.first + given.count), []
    with ProcessPoolExecutor(2) as pool:
        for seed, one in zip(seeds, pool.map(run, seeds), strict=True):
            cells = f"{one.rms_m:.3f} | {one.largest_m:.2f} | {one.wrong:.1%} | {one.heading_deg:.2f}"
            print(f"| {seed} | {one.happened} | {cells} |", flush=True)
            found.append(one)
    rms_m = np.array([one.rms_m for one in found])
    often = sum(one.wrong > 0.01 for one in found)
    print(
        f"\n{np.isfinite(rms_m).sum()} of {len(found)} judged: RMS {np.nanmedian(rms_m):.3f} m in the median, "
        f"{np.nanquantile(rms_m, 0.9):.3f} m in nine of ten, {np.nanmax(rms_m):.3f} m in the worst; "
        f"beyond {WRONG_M:g} m for more than a hundredth of the time: {often}"
    )


if __name__ == "__main__":
    main()
