"""Random scenarios of twenty seconds in which everything may go wrong at once, to find what nobody thought of."""

from typing import Any

import numpy as np

from holdfast.sim.readings import generator
from holdfast.sim.scenario import FAULT_SENSORS, Scenario, load_scenario

MACHINES = ("excavator_low", "excavator_roof", "dumper")
SITES = ("yard", "oberglatt", "rough")
SENSORS = {
    "excavator_low": ("imu", "base_imu", "gnss", "gnss_right", "heading", "joint", "lidar"),
    "excavator_roof": ("imu", "base_imu", "gnss", "gnss_right", "heading", "joint", "lidar"),
    "dumper": ("imu", "gnss", "gnss_right", "heading", "lidar"),
}
ABSENT_RATIO = 0.1  # of the schedules lack one sensor or another
HASTY_RATIO = 0.3  # of the schedules have late, lost and doubled messages
DURATION_S = 20.0
FIRST_S = 0.3  # faults begin later: a line needs a sample to start from, a swap a fix of each antenna
DURATIONS_S = ((0.02, 1.0), (1.0, 6.0), (6.0, 20.0))


def random_schedule(seed: int) -> Scenario:
    """Return the scenario `quick` with a random machine, site and faults; equal seeds give equal schedules."""
    rng = generator(seed, "schedule")
    machine = str(rng.choice(MACHINES))
    sensors = [name for name in SENSORS[machine] if name == "imu" or rng.random() >= ABSENT_RATIO]
    if not {"gnss", "gnss_right"} <= set(sensors) and "heading" in sensors:
        sensors.remove("heading")  # it is that of the baseline between the antennas
    sheets: dict[str, Any] = {name: None for name in SENSORS[machine] if name not in sensors}
    if rng.random() < HASTY_RATIO:
        sheets |= {name: {"transport": _transport(rng)} for name in sensors if name not in ("imu", "base_imu")}
    number = int(rng.integers(1, 7))
    overrides: dict[str, Any] = {
        "duration_s": DURATION_S,
        "description": f"Random faults, seed {seed}.",
        "machine": machine,
        "site": str(rng.choice(SITES)),
        "faults": [fault for _ in range(number) if (fault := _fault(rng, sensors)) is not None],
        "sensors": sheets,
    }
    if machine == "dumper":  # it cannot dig
        overrides["activities"] = [{"stand_s": 2.0}, {"drive_to_m": [[8.0, 6.0], [20.0, 4.0], [30.0, -10.0]]}]
    return load_scenario("quick", overrides)


def _fault(rng: np.random.Generator, present: list[str]) -> dict[str, Any] | None:
    """Return a random fault; None where the machine has no sensor to which its kind can happen."""
    kind = str(rng.choice(list(FAULT_SENSORS)))
    able = [name for name in FAULT_SENSORS[kind] if name in present]
    if not able or (kind == "swap" and len(able) < 2):
        return None
    chosen = [name for name in able if rng.random() < 0.6] or [str(rng.choice(able))]
    start_s = float(rng.uniform(FIRST_S, DURATION_S))
    shortest_s, longest_s = DURATIONS_S[int(rng.integers(len(DURATIONS_S)))]
    fault: dict[str, Any] = {
        "kind": kind,
        "sensors": chosen,
        "start_s": start_s,
        "end_s": start_s + float(rng.uniform(shortest_s, longest_s)),
        "quality": str(rng.choice(["rtk_float", "single"])),
        "offset_m": (_direction(rng) * _log_uniform(rng, 0.02, 100.0)).tolist(),
        "yaw_deg": float(rng.uniform(-180.0, 180.0)),
        "rate_m_s": _log_uniform(rng, 0.01, 5.0),
        "period_s": _log_uniform(rng, 0.05, 5.0),
        "step_s": float(rng.choice([-1.0, 1.0])) * _log_uniform(rng, 1e-3, 5.0),
    }
    if rng.random() < 0.5:
        fault["claim_growth_m_s"] = _log_uniform(rng, 0.05, 5.0)
    return fault


def _transport(rng: np.random.Generator) -> dict[str, float]:
    return {
        "latency_s": _log_uniform(rng, 1e-3, 1.0),
        "jitter_s": _log_uniform(rng, 1e-4, 0.2),
        "loss_ratio": float(rng.uniform(0.0, 0.3)),
        "duplicate_ratio": float(rng.uniform(0.0, 0.1)),
    }


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
