"""Prints whether `config init` finds a driver that gives other units or signs: `python benchmarks/wrong_drivers.py`.

The readings of real recordings are changed as such a driver would, and a configuration is begun for what comes out.
With `--replay` they are run, too, with every second fix held out: without the factors of that configuration, and with.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from drives import held_out_row, names_of, run_system

from holdfast.config.load import parse_config
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.messages import ImuSample, Message
from holdfast.recording.first_config import first_config
from holdfast.recording.imu_mended import FACTORS
from holdfast.recording.source import Subscription, open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.held_out import HoldOut

DEG, G = np.pi / 180.0, 9.80665
DRIVERS = {  # by which the readings (6,) are divided
    "as they are": (1.0,) * 6,
    "gyroscope in deg/s": (DEG, DEG, DEG, 1.0, 1.0, 1.0),
    "accelerometer in g": (1.0, 1.0, 1.0, G, G, G),
    "accelerometer in mg": (1.0, 1.0, 1.0, G / 1e3, G / 1e3, G / 1e3),
    "deg/s and g": (DEG, DEG, DEG, G, G, G),
    "gyroscope's signs": (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0),
    "sign of the gyroscope's z": (1.0, 1.0, -1.0, 1.0, 1.0, 1.0),
    "gravity, not specific force": (1.0, 1.0, 1.0, -1.0, -1.0, -1.0),
    "left-handed axes": (-1.0,) * 6,
    "deg/s, sign of z, and g": (DEG, DEG, -DEG, G, G, G),
}


class OtherDriver:
    """A recording whose IMU has another driver."""

    def __init__(self, recording: Any, units: np.ndarray) -> None:
        self._recording, self._units = recording, units

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def read(self, wanted: Any, *span_s: Any) -> Iterator[Message]:
        """As of a recording; what a subscription says of units comes after the driver."""
        by_sensor = {one.sensor: one for one in wanted}
        for one in self._recording.read([_as_it_is(each) for each in wanted], *span_s):
            yield by_sensor[one.sensor].meant(self._told(one))

    def read_headers(self, *span_s: Any) -> Iterator[Any]:
        """As of a recording."""
        for one in self._recording.read_headers(*span_s):
            yield replace(one, message=self._told(one.message))

    def _told(self, one: Any) -> Any:
        if not isinstance(one, ImuSample):
            return one
        return ImuSample.of(one.stamp_ns, one.arrival_ns, one.sensor, np.array(one.values()) / self._units)


def _as_it_is(subscription: Subscription) -> Subscription:
    return replace(subscription, factors=None)


def judge(folder: Path, driver: str, runs: bool) -> tuple[bool, list[float]]:
    """Return whether what is found is right, and with `runs` the RMS at held-out fixes [m]: without it, and with it."""
    units = np.array(DRIVERS[driver])
    with open_recording(folder / "bag") as recording:
        other: Any = OtherDriver(recording, units)
        config = parse_config(first_config(other))
        given = config.imu.model_copy(update=dict.fromkeys(FACTORS, (1.0, 1.0, 1.0)))
        ignorant = config.model_copy(update={"sensors": {**config.sensors, config.imu_name: given}})
        rms = [rms_of(one, list(other.read(subscriptions(one)))) for one in (ignorant, config) if runs]
    return bool(np.allclose(config.imu.factors or np.ones(6), units, rtol=1e-6)), rms


def rms_of(config: Config, messages: list[Message]) -> float:
    """Return the RMS of a drive at held-out fixes [m]; NaN if it never starts."""
    run = run_system(Estimator(config), messages, [HoldOut(sensor, 2) for sensor in names_of(config, "gnss")])
    return float(held_out_row(config, run, messages, Path("none")).get("rms", np.nan))


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="recordings whose name holds this")
    parser.add_argument("--replay", action="store_true", help="run them, too")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    given = parser.parse_args()
    folders = [bag.parent for bag in sorted(given.data.glob("**/bag")) if given.only in str(bag.parent)]
    if not folders:
        print(f"all recordings: skipped, none at {given.data}")
        return
    told = [f"{folder.name}: before, now" for folder in folders] if given.replay else []
    print(" | ".join(["| driver", "found", "not found", *told]), "|\n|---|---:|---|" + "---:|" * len(told))
    with ProcessPoolExecutor(2) as pool:
        jobs = {driver: [pool.submit(judge, one, driver, given.replay) for one in folders] for driver in DRIVERS}
        for driver, futures in jobs.items():
            rows = [future.result() for future in futures]
            missed = ", ".join(folder.name for folder, (is_found, _) in zip(folders, rows, strict=True) if not is_found)
            errors = [", ".join(f"{one:.2f}" for one in rms) for _, rms in rows if rms]
            found = f"{sum(is_found for is_found, _ in rows)} of {len(rows)}"
            print(" | ".join([f"| {driver}", found, missed, *errors]), "|", flush=True)


if __name__ == "__main__":
    main()
