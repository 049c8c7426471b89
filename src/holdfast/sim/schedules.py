"""Random scenarios of twenty seconds in which everything may go wrong at once, to find what nobody thought of."""

from typing import Any

import numpy as np

from holdfast.sim.datasheets import SimulatedSensor
from holdfast.sim.fault import Fault
from holdfast.sim.faults import can_happen
from holdfast.sim.readings import generator
from holdfast.sim.scenario import BASE, Scenario, load_scenario
from holdfast.sim.sensors import KINDS
from holdfast.sim.sensors.gnss import SimulatedGnss
from holdfast.sim.sensors.heading import SimulatedHeading
from holdfast.sim.sensors.imu import SimulatedInertial
from holdfast.sim.sensors.joint import SimulatedJoint

MACHINES = ("excavator_low", "excavator_roof", "dumper")
SITES = ("yard", "oberglatt", "rough")
# sensors that the shipped machines do not have
ADDED = {row.example[0]: {"kind": kind, **row.example[1]} for kind, row in KINDS.items() if row.example is not None}
ADDED_RATIO = 0.2  # of the schedules have one of them or another
ABSENT_RATIO = 0.1  # of the schedules lack one sensor or another
HASTY_RATIO = 0.3  # of the schedules have late, lost and doubled messages
DURATION_S = 20.0
DRAWN = (
    *("outage", "degraded", "walk", "offset", "spikes", "swap"),
    *("silence", "line", "jump", "freeze", "slip", "clock_step"),
)
"""The faults that a schedule draws; their order is part of what a seed means."""
HOSTILE = ("clock_step", "flood", "twin", "garbage")
"""The faults that a hostile schedule has in addition."""
FIRST_S = 0.3  # faults begin later: a line needs a sample to start from, a swap a fix of each antenna
DURATIONS_S = ((0.02, 1.0), (1.0, 6.0), (6.0, 20.0))


def random_schedule(seed: int) -> Scenario:
    """Return the scenario `quick` with a random machine, sensors, site and faults; equal seeds give equal schedules."""
    rng = generator(seed, "schedule")
    machine = str(rng.choice(MACHINES))
    overrides: dict[str, Any] = {
        "duration_s": DURATION_S,
        "description": f"Random faults, seed {seed}.",
        "machine": machine,
        "site": str(rng.choice(SITES)),
        "faults": [],
    }
    if machine == "dumper":  # it cannot dig
        overrides["activities"] = [{"stand_s": 2.0}, {"drive_to_m": [[8.0, 6.0], [20.0, 4.0], [30.0, -10.0]]}]
    overrides["sensors"] = _sensors(rng, load_scenario("quick", overrides))
    present = load_scenario("quick", overrides).sensors_of(SimulatedSensor)
    kinds = {name: sheet.kind for name, sheet in present.items() if sheet.kind != "scanner"}
    number = int(rng.integers(1, 7))
    overrides["faults"] = [fault for _ in range(number) if (fault := _fault(rng, kinds)) is not None]
    return load_scenario("quick", overrides)


def hostile_schedule(seed: int) -> Scenario:
    """Return the random schedule of a seed with one to four faults more, of what broken software does to any topic.

    Clocks of all sensors or of one step by up to fifty years, a sensor floods, has a twin, or sends garbage. They are
    drawn from random numbers of their own: what else happens is what happens in `random_schedule`.
    """
    schedule, rng = random_schedule(seed), generator(seed, "schedule", "hostile")
    names = [name for name in schedule.sensors_of(SimulatedSensor) if schedule.sensors[name].kind != "scanner"]
    faults = tuple(_hostile_fault(rng, names) for _ in range(int(rng.integers(1, 5))))
    return schedule.model_copy(update={"faults": (*schedule.faults, *faults)})


def _hostile_fault(rng: np.random.Generator, names: list[str]) -> Fault:
    kind = str(rng.choice(HOSTILE))
    is_clock = kind == "clock_step"
    of_all = is_clock and rng.random() < 0.5
    several = [name for name in names if rng.random() < 0.4] if kind in ("twin", "garbage") else []
    start_s = float(rng.uniform(FIRST_S, DURATION_S))
    shortest_s, longest_s = DURATIONS_S[int(rng.integers(2 if kind == "flood" else len(DURATIONS_S)))]
    values: dict[str, Any] = {
        "kind": kind,
        "sensors": names if of_all else several or [str(rng.choice(names))],
        "start_s": start_s,
        "end_s": start_s + float(rng.uniform(shortest_s, longest_s)),
        "flood_hz": log_uniform(rng, 200.0, 4000.0),
        "behind": int(rng.integers(3)),
        "garbage_ratio": log_uniform(rng, 0.01, 1.0),
    }
    step_s = log_uniform(rng, 1e-3, 4e8) if is_clock else log_uniform(rng, 1e-3, 1.0) * int(rng.integers(2))
    return Fault(**values, step_s=float(rng.choice([-1.0, 1.0])) * step_s)


def _sensors(rng: np.random.Generator, whole: Scenario) -> dict[str, Any]:
    """Return what differs from the sensors of a machine: some are absent, some added, some late."""
    kept = [name for name in whole.sensors if name == whole.imu_name or rng.random() >= ABSENT_RATIO]
    antennas = whole.sensors_of(SimulatedGnss).keys()
    if not antennas <= set(kept):  # a heading is that of the baseline between the antennas
        kept = [name for name in kept if name not in whole.sensors_of(SimulatedHeading)]
    added = {name: sheet for name, sheet in ADDED.items() if rng.random() < ADDED_RATIO}
    if whole.turn_joint is not None and not whole.sensors_of(SimulatedJoint).keys() & set(kept):
        # without the encoder nobody knows how the chassis moves against the cabin
        added = {name: sheet for name, sheet in added.items() if sheet["frame"] != BASE}
    sheets: dict[str, Any] = dict.fromkeys(name for name in whole.sensors if name not in kept) | added
    if rng.random() < HASTY_RATIO:
        inertial = whole.sensors_of(SimulatedInertial)
        hasty = [name for name in (*kept, *added) if name not in inertial]
        sheets |= {name: sheets.get(name, {}) | {"transport": _transport(rng)} for name in hasty}
    return sheets


def _fault(rng: np.random.Generator, kinds: dict[str, str]) -> dict[str, Any] | None:
    """Return a random fault of sensors, given by their kinds; None where it can happen to none of them."""
    kind = str(rng.choice(DRAWN))
    able = [name for name in kinds if can_happen(kind, kinds[name])]
    if kind == "swap" and list(kinds.values()).count("gnss") < 2:
        able = [name for name in able if kinds[name] != "gnss"]
    if not able:
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
        "offset_m": (_direction(rng) * log_uniform(rng, 0.02, 100.0)).tolist(),
        "yaw_deg": float(rng.uniform(-180.0, 180.0)),
        "rate_m_s": log_uniform(rng, 0.01, 5.0),
        "period_s": log_uniform(rng, 0.05, 5.0),
        "slip_ratio": float(rng.uniform(-1.0, 1.0)),
        "slip_m_s": float(rng.uniform(-1.0, 1.0)),
        "step_s": float(rng.choice([-1.0, 1.0])) * log_uniform(rng, 1e-3, 5.0),
    }
    if rng.random() < 0.5:
        fault["claim_growth_m_s"] = log_uniform(rng, 0.05, 5.0)
    return fault


def _transport(rng: np.random.Generator) -> dict[str, float]:
    return {
        "latency_s": log_uniform(rng, 1e-3, 1.0),
        "jitter_s": log_uniform(rng, 1e-4, 0.2),
        "loss_ratio": float(rng.uniform(0.0, 0.3)),
        "duplicate_ratio": float(rng.uniform(0.0, 0.1)),
    }


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two others, every factor as probable as any other."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
