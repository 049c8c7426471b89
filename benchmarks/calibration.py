"""Prints how well `holdfast calibrate` recovers what a simulated machine is: `python benchmarks/calibration.py`.

Each number beside its truth: error, claimed sigma and their ratio, over seeds; and held-out errors before and after.
The truth is what the scenario says of its sensors; the calibration sees the recording and the configuration alone.
With `--causal` it is what the estimator has learnt of mountings, clocks and the encoder at the end of one replay.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import degrees, hypot, nan, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import TypeVar

import gtsam
import numpy as np

from holdfast.calibration.calibrate import Calibration, calibrated
from holdfast.calibration.learnt_table import learnt_rows
from holdfast.config.load import load_config
from holdfast.config.model import Config
from holdfast.sim.configuration import configuration
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import Simulation
from holdfast.trial.run import CONFIG, RECORDING, estimate, write_simulation

SCENARIOS = ("offset-clocks", "wrong-mount", "rough")
IMU_KEYS = ("gyroscope_noise_density", "accelerometer_noise_density")

Result = TypeVar("Result")
Key = tuple[str, str]
"""What a calibration says of the sensor, and the key."""


def truths(simulation: Simulation, config: Config) -> Iterator[tuple[Key, float]]:
    """Yield what is true of the numbers that a calibration names: by what it says of the sensor and by the key."""
    sheets = simulation.scenario.sensors
    for name in config.sensors:
        sheet = sheets[name]
        if hasattr(sheet, "clock"):
            yield (name, "time_offset_s"), -sheet.clock.offset_s
        for key in IMU_KEYS:
            if hasattr(sheet, key):
                yield (name, key), getattr(sheet, key)
        if sheet.kind == "joint":
            yield (
                (f"zero of {name}", "zero_offset_deg"),
                -degrees(simulation.measured[name].constants["zero_offset_rad"]),
            )
        if sheet.kind == "odometry":
            yield (name, "translation_sigma_m"), sqrt(2.0) * sheet.jitter_m
            yield (name, "rotation_sigma_rad"), sqrt(2.0) * sheet.jitter_rad
            for key in ("drift_m_per_sqrt_m", "drift_rad_per_sqrt_m", "drift_rad_per_sqrt_rad"):
                yield (name, key), getattr(sheet, key)
            yield from _rotation(simulation, config, name)
        if sheet.kind == "gnss":
            arms = [of.T_I(of.frame_of(name))[:3, 3] for of in (_true_config(simulation), config)]
            for axis, off in zip("xyz", arms[0] - arms[1], strict=True):
                yield (f"{name}, along {axis} of the IMU", "translation_m"), float(off)


def _rotation(simulation: Simulation, config: Config, name: str) -> Iterator[tuple[Key, float]]:
    true, given = (gtsam.Rot3(of.T_I(of.frame_of(name))[:3, :3]) for of in (_true_config(simulation), config))
    off = np.degrees(gtsam.Rot3.Logmap(given.between(true)))
    for axis, value in zip("xyz", off.tolist(), strict=True):
        yield (f"{name}, about its {axis}", "rotation"), value


def _true_config(simulation: Simulation) -> Config:
    """Return the configuration whose owner is not mistaken."""
    return configuration(simulation.scenario.model_copy(update={"written": {}}), simulation.seed)


@dataclass(frozen=True, slots=True)
class Found:
    """One number that was found: its name and key as in `truths`, and its sigma."""

    key: Key
    value: float
    sigma: float


def learn(folder: Path, given: Config) -> list[Found]:
    """Return what the estimator has learnt of constants at the end of a recording; a shared clock once."""
    found, clocks = [], set()
    for row in learnt_rows(estimate(folder, given).estimator.learnt(), given):
        if row.what == "clock" and row.sigma is not None:
            if (row.learnt, row.sigma) not in clocks:
                found.append(Found((row.sensor, "time_offset_s"), row.learnt, row.sigma))
            clocks.add((row.learnt, row.sigma))
        elif row.what == "zero" and row.sigma is not None:
            found.append(Found((f"zero of {row.sensor}", "zero_offset_deg"), row.learnt, row.sigma))
        elif row.what.startswith("mounting, about its") and row.sigma is not None:
            about = row.what.removeprefix("mounting, ")
            found.append(Found((f"{row.sensor}, {about}", "rotation"), row.learnt, row.sigma))
    return found


def run(
    scenario: str, seed: int, duration_s: float | None, find: Callable[[Path, Config], Result]
) -> tuple[Result, Mapping[Key, float]]:
    """Simulate once; return what is found in the folder with the given configuration, and the truth."""
    loaded = load_scenario(scenario, {} if duration_s is None else {"duration_s": duration_s})
    with TemporaryDirectory() as name:
        folder = Path(name)
        simulation = write_simulation(loaded, seed, folder)
        given = load_config(folder / CONFIG)
        return find(folder, given), dict(truths(simulation, given))


def calibrate(folder: Path, given: Config, *, lever_arms: bool = False) -> Calibration:
    """Return what `holdfast calibrate` finds."""
    return calibrated([str(folder / RECORDING)], given, with_lever_arms=lever_arms)


def calibrate_and_print(folder: Path, given: Config, *, lever_arms: bool) -> list[Found]:
    """Return the numbers that `holdfast calibrate` finds, and print its held-out errors."""
    found = calibrate(folder, given, lever_arms=lever_arms)
    for held in found.held_out:
        nominal, outage = (held.rms(in_outage=lost) * 1e3 for lost in (False, True))
        print(f"{held.label}: {nominal:.1f} mm with GNSS, {outage:.1f} mm in cut outages")
    return [Found((one.what, str(one.path[-1])), one.after, one.sigma) for one in found.estimates if one.is_observable]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", default=SCENARIOS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--duration", type=float, default=None, help="of the recordings [s]")
    parser.add_argument("--lever-arms", action="store_true")
    parser.add_argument("--causal", action="store_true", help="what one replay has learnt")
    arguments = parser.parse_args()
    find = learn if arguments.causal else partial(calibrate_and_print, lever_arms=arguments.lever_arms)
    for scenario in arguments.scenarios or SCENARIOS:
        errors: dict[Key, list[tuple[float, float]]] = {}
        began_s = process_time()
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            print(f"{scenario} {seed}", flush=True)
            found, truth = run(scenario, seed, arguments.duration, find)
            for one in found:
                if one.key in truth:
                    errors.setdefault(one.key, []).append((one.value - truth[one.key], one.sigma))
        print(f"{scenario}: {process_time() - began_s:.0f} s of processor time")
        print(f"  {'number':34s} {'key':28s} {'RMS error':>10s} {'sigma':>10s} {'ratio':>6s} {'within 3':>8s}")
        inside = total = 0
        for (what, key), rows in errors.items():
            off, sigma = (np.array(column) for column in zip(*rows, strict=True))
            within = int((np.abs(off) <= 3.0 * sigma).sum())
            inside, total = inside + within, total + len(rows)
            ratio = float(np.sqrt(((off / sigma) ** 2).mean()))
            rms = hypot(*off) / sqrt(len(off)) if len(off) else nan
            print(f"  {what:34s} {key:28s} {rms:10.3g} {sigma.mean():10.3g} {ratio:6.2f} {within:4d}/{len(rows)}")
        print(f"  within three sigmas: {inside} of {total}", flush=True)


if __name__ == "__main__":
    main()
