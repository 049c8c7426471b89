"""Random machines whose owner wrote down where the sensors are, roughly, and nothing else.

Kinds of sensors, rates, noise, mounts, clocks and what receivers claim are drawn, and the configuration knows none of
it: what a default is worth on machines for which it was not made.
"""

from typing import Any, NamedTuple

import numpy as np

from holdfast.sim.configuration import configuration_data
from holdfast.sim.readings import generator
from holdfast.sim.scenario import Scenario, load_scenario
from holdfast.sim.schedules import ADDED, log_uniform
from holdfast.sim.sensors.gnss import SimulatedGnss
from holdfast.sim.sensors.imu import SimulatedInertial

MACHINES = ("excavator_low", "excavator_roof", "dumper")
SITES = ("yard", "oberglatt", "field")
DURATION_S, OUTAGE_S = 160.0, (110.0, 140.0)
LOOP_M = np.array([[-6.0, 2.0], [-10.0, 8.0], [0.0, 9.0], [6.0, 3.0], [0.0, -4.0]])
LARGER = {"dumper": 3.0}  # times: it is faster
WRITTEN = ("kind", "topic", "frame", "joint_name", "primary")  # keys of sensors in the configuration

IMU_HZ, GNSS_HZ, ODOMETRY_HZ = (50.0, 100.0, 200.0, 400.0), (1.0, 2.0, 5.0, 10.0, 20.0), (2.0, 5.0, 10.0, 20.0)
NOISE, BIAS, CALIBRATION = (0.3, 10.0), (0.3, 5.0), (0.3, 10.0)  # of IMUs, times their datasheets
FIXES, CLAIM, TIME_CONSTANT_S = (0.5, 5.0), (0.4, 2.5), (10.0, 300.0)
ODOMETRY = (0.3, 5.0)  # noise and drift, each times that of the datasheet
LATENCY_S, CLOCK_S = (0.01, 0.5), 0.06
MOUNT_DEG, MOUNT_M = 2.0, 0.002  # by which an odometry may be turned, and sigma of where anything is
ENGINE_HZ, SWAY_HZ = (10.0, 90.0), 4.0
OFTEN, RARELY, FURTHER = 0.7, 0.35, 0.4


class RandomMachine(NamedTuple):
    """A scenario, and the configuration that its owner wrote, as plain data."""

    scenario: Scenario
    configuration: dict[str, Any]


def random_machine(seed: int, further: bool = False) -> RandomMachine:
    """Return the machine of a seed, at work for `DURATION_S` with an outage of GNSS in `OUTAGE_S`.

    Args:
        seed: equal seeds give equal machines.
        further: it may have sensors that the shipped machines do not have.
    """
    rng = generator(seed, "random machine")
    machine = str(rng.choice(MACHINES))
    keys: dict[str, Any] = {
        "description": f"A random machine, seed {seed}, of which nothing but the mounts is known.",
        "machine": machine,
        "site": str(rng.choice(SITES)),
        "duration_s": DURATION_S,
        "earth_rotation": True,
        "activities": _activities(rng, machine),
        "engine": {
            "idle_acceleration_m_s2": log_uniform(rng, 0.01, 1.0),
            "work_acceleration_m_s2": log_uniform(rng, 0.05, 4.0),
        },
        "faults": [],
    }
    whole = load_scenario("quick", keys)
    keys["sensors"] = _sensors(rng, whole)
    keys["engine"]["frequency_hz"] = _engine_hz(rng, keys["sensors"][whole.imu_name]["rate_hz"])
    receivers = [name for name in ("gnss", "gnss_right", "heading") if keys["sensors"][name] is not None]
    start_s, end_s = OUTAGE_S
    keys["faults"] = [{"kind": "outage", "sensors": receivers, "start_s": start_s, "end_s": end_s}]
    if further:
        drawn = generator(seed, "further sensors")
        keys["sensors"] |= {name: sheet for name, sheet in ADDED.items() if drawn.random() < FURTHER}
    keys["extrinsics"] = [one.model_dump(mode="json", exclude_unset=True) for one in whole.extrinsics]
    if rng.random() < RARELY:
        for mount in keys["extrinsics"]:
            if mount["child"] == whole.imu.frame:
                mount["rotation_rpy_deg"] = rng.uniform(-180.0, 180.0, 3).tolist()
    scenario = load_scenario("quick", keys)
    return RandomMachine(scenario, _written(rng, configuration_data(scenario, seed)))


def _activities(rng: np.random.Generator, machine: str) -> list[dict[str, Any]]:
    """Return rounds, with digging where there is an arm; one in three recordings begins in motion."""
    begin = [{"stand_s": float(rng.uniform(0.5, 20.0))}] if rng.random() < OFTEN else []
    rounds: list[dict[str, Any]] = [{"drive_to_m": (LOOP_M * LARGER.get(machine, 1.0)).tolist()}]
    if machine not in LARGER:
        rounds.append({"dig": {"cycles": 1, "swing_deg": -110.0}})
    return [*begin, {"repeat": 60, "of": rounds}]


def _engine_hz(rng: np.random.Generator, imu_hz: float) -> float:
    """Return a frequency whose first two orders the IMU's sampling does not fold to a slow sway.

    Real IMUs filter before they decimate; the simulated one does not.
    """
    while True:
        frequency_hz = log_uniform(rng, *ENGINE_HZ)
        if all(abs((order * frequency_hz + SWAY_HZ) % imu_hz - SWAY_HZ) > SWAY_HZ for order in (1, 2)):
            return frequency_hz


def _sensors(rng: np.random.Generator, whole: Scenario) -> dict[str, Any]:
    sensors: dict[str, Any] = {"scanner": None}
    sensors |= {name: _inertial(rng, sheet) for name, sheet in whole.sensors_of(SimulatedInertial).items()}
    if whole.turn_joint is not None and rng.random() > OFTEN:
        sensors["base_imu"] = None
    return sensors | _receivers(rng, whole) | {"lidar": _odometry(rng, whole)}


def _inertial(rng: np.random.Generator, sheet: SimulatedInertial) -> dict[str, Any]:
    ranges = {
        "accelerometer_noise_density": NOISE,
        "gyroscope_noise_density": NOISE,
        "accelerometer_random_walk": NOISE,
        "gyroscope_random_walk": NOISE,
        "accelerometer_bias_sigma": BIAS,
        "gyroscope_bias_sigma": BIAS,
        "accelerometer_scale_sigma": CALIBRATION,
        "gyroscope_scale_sigma": CALIBRATION,
        "misalignment_sigma_rad": BIAS,
    }
    drawn = {key: getattr(sheet, key) * log_uniform(rng, *limits) for key, limits in ranges.items()}
    return drawn | {"rate_hz": float(rng.choice(IMU_HZ))}


def _receivers(rng: np.random.Generator, whole: Scenario) -> dict[str, Any]:
    """Return one antenna, two, or two with their heading; all of one receiver, with one clock."""
    times, tau_s = log_uniform(rng, *FIXES), log_uniform(rng, *TIME_CONSTANT_S)
    shared = {"rate_hz": float(rng.choice(GNSS_HZ)), "transport": _transport(rng)} | _clock(rng)
    parts = ("white_horizontal_m", "white_vertical_m", "slow_horizontal_m", "slow_vertical_m")
    fixes = _scaled(whole.sensors_of(SimulatedGnss)["gnss"].rtk_fixed, times, *parts) | {"time_constant_s": tau_s}
    antenna = shared | {"rtk_fixed": fixes, "claim_ratio": log_uniform(rng, *CLAIM)}
    heading = shared | {"time_constant_s": tau_s}
    heading |= _scaled(whole.sensors["heading"], log_uniform(rng, 0.5, 4.0), "white_rad", "slow_rad")
    kind = rng.random()
    return {
        "gnss": antenna,
        "gnss_right": dict(antenna) if kind > 0.3 else None,
        "heading": heading if kind > 0.5 else None,
    }


def _odometry(rng: np.random.Generator, whole: Scenario) -> dict[str, Any] | None:
    if rng.random() > 0.85:
        return None
    sheet, noise, drift = whole.sensors["lidar"], log_uniform(rng, *ODOMETRY), log_uniform(rng, *ODOMETRY)
    drawn = _scaled(sheet, noise, "jitter_m", "jitter_rad")
    drawn |= _scaled(sheet, drift, "drift_m_per_sqrt_m", "drift_rad_per_sqrt_m", "drift_rad_per_sqrt_rad")
    return drawn | {"rate_hz": float(rng.choice(ODOMETRY_HZ)), "transport": _transport(rng)} | _clock(rng)


def _scaled(sheet: object, times: float, *keys: str) -> dict[str, float]:
    """Return numbers of a datasheet, so many times larger."""
    return {key: getattr(sheet, key) * times for key in keys}


def _clock(rng: np.random.Generator) -> dict[str, Any]:
    if rng.random() > RARELY:
        return {}
    return {"clock": {"offset_s": float(rng.uniform(-CLOCK_S, CLOCK_S)), "calibrated": False}}


def _transport(rng: np.random.Generator) -> dict[str, float]:
    latency_s = log_uniform(rng, *LATENCY_S)
    return {"latency_s": latency_s, "jitter_s": 0.2 * latency_s}


def _written(rng: np.random.Generator, data: dict[str, Any]) -> dict[str, Any]:
    """Return what an owner wrote who knows mounts to the millimetre, and one in three the lidar's by eye only."""
    by_eye = rng.uniform(-MOUNT_DEG, MOUNT_DEG, 3) if rng.random() < RARELY else np.zeros(3)
    for mount in data["extrinsics"]:
        moved = np.array(mount.get("translation_m", np.zeros(3))) + rng.normal(0.0, MOUNT_M, 3)
        mount["translation_m"] = moved.tolist()
        if mount["child"] == "lidar":
            mount["rotation_rpy_deg"] = (np.array(mount.get("rotation_rpy_deg", np.zeros(3))) + by_eye).tolist()
    data["sensors"] = {
        name: {key: value for key, value in sensor.items() if key in WRITTEN}
        for name, sensor in data["sensors"].items()
    }
    return {key: value for key, value in data.items() if key != "initialisation"}
