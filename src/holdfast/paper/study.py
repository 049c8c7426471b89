"""The plan: jobs of one simulation each, on which tasks are run one after the other; quick and full."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from holdfast.paper.systems import SYSTEMS
from holdfast.trial.variations import VARIATIONS

Study = Literal["accuracy", "ablation", "sensitivity", "growth"]
TASKS = ("construction", "navigation")  # those of the paper


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A delay or a clock offset of the messages of one kind of sensor; `gnss` stands for antennas and their heading.

    Attributes:
        delay_s: they arrive so much later.
        clock_s: their stamps are so much late, which no configuration knows.
    """

    kind: str
    delay_s: float = 0.0
    clock_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Task:
    """One system on one recording.

    Attributes:
        system: its name in `SYSTEMS`.
        variation: name of the change of the configuration, in an ablation.
    """

    study: Study
    system: str
    variation: str = ""
    disturbance: Disturbance | None = None

    @property
    def name(self) -> str:
        """The name of its file within the job's folder."""
        parts = [self.study, self.system, self.variation]
        if self.disturbance is not None:
            d = self.disturbance
            parts += [d.kind, f"delay{d.delay_s * 1e3:g}ms" if d.delay_s else f"clock{d.clock_s * 1e3:g}ms"]
        return "-".join(part for part in parts if part)


@dataclass(frozen=True, slots=True)
class Job:
    """One simulation and what is run on it.

    Attributes:
        overrides: what differs from the shipped scenario.
        keep_curves: errors over time are kept, not only their statistics, and the poses, of which maps are made.
    """

    scenario: str
    seed: int
    tasks: tuple[Task, ...]
    overrides: Mapping[str, Any] = field(default_factory=dict)
    keep_curves: bool = False
    label: str = ""

    @property
    def name(self) -> str:
        """The name of its folder."""
        return f"{self.label or self.scenario}-{self.seed}"


# shorter and with earlier outages, so that a quick evaluation takes minutes
QUICK: dict[str, dict[str, Any]] = {
    "construction": {
        "duration_s": 42.0,
        "faults": [
            {
                "kind": "outage",
                "sensors": ["gnss", "gnss_right"],
                "start_s": 25.0,
                "end_s": 35.0,
                "claim_growth_m_s": 0.5,
            },
            {"kind": "outage", "sensors": ["heading"], "start_s": 25.0, "end_s": 35.0},
        ],
    },
    "navigation": {
        "duration_s": 42.0,
        "faults": [
            {
                "kind": "degraded",
                "sensors": ["gnss", "gnss_right"],
                "start_s": 25.0,
                "end_s": 35.0,
                "quality": "rtk_float",
            },
            {"kind": "outage", "sensors": ["heading"], "start_s": 25.0, "end_s": 35.0},
        ],
    },
    "tunnel": {
        "duration_s": 40.0,
        "faults": [{"kind": "outage", "sensors": ["gnss", "gnss_right", "heading"], "start_s": 15.0, "end_s": 37.0}],
    },
}
QUICK_ABLATIONS = ("single-graph", "relative-scans", "one-antenna", "no-lidar")
SENSITIVE = ("holdfast", "msf", "tsif")
GNSS_DELAYS_S = (0.1, 0.3, 1.0, 2.0)
ODOMETRY_DELAYS_S = (0.2, 0.5, 1.0, 2.0)
GNSS_CLOCKS_S = (0.002, 0.005, 0.01, 0.02, 0.05)
ODOMETRY_CLOCKS_S = (0.005, 0.01, 0.02, 0.05, 0.1)
SENSITIVITY_S = 180.0
QUICK_SENSITIVITY: dict[str, Any] = {"duration_s": 15.0, "faults": []}
GROWTH_SEEDS = 5


def plan(seeds: int, quick: bool) -> list[Job]:
    """Return the jobs, those first whose results matter most.

    Args:
        seeds: simulations of each of the paper's two tasks.
        quick: short recordings, few variations.
    """
    jobs = [accuracy_job(scenario, seed, quick) for seed in range(seeds) for scenario in TASKS]
    # the preset is among the systems, and all are compared with the default
    names = QUICK_ABLATIONS if quick else [name for name in VARIATIONS if name not in ("default", "paper")]
    ablation = tuple(Task("ablation", "holdfast", name) for name in names)
    jobs += [
        Job(scenario, 0, ablation, QUICK[scenario] if quick else {}, label=f"{scenario}-ablation")
        for scenario in TASKS[: 1 if quick else 2]
    ]
    growth = tuple(Task("growth", system) for system in SYSTEMS)
    jobs += [Job("tunnel", seed, growth, QUICK["tunnel"] if quick else {}) for seed in range(min(seeds, GROWTH_SEEDS))]
    disturbed = QUICK_SENSITIVITY if quick else {"duration_s": SENSITIVITY_S}
    jobs += [
        Job("construction", 0, tasks, disturbed, label=f"sensitivity-{name}")
        for name, tasks in _sensitivity(quick).items()
    ]
    return jobs


def accuracy_job(scenario: str, seed: int, quick: bool) -> Job:
    """Return the job that runs every system on one simulation of a task of the paper."""
    tasks = tuple(Task("accuracy", system) for system in SYSTEMS)
    return Job(scenario, seed, tasks, QUICK[scenario] if quick else {}, keep_curves=seed == 0)


def _sensitivity(quick: bool) -> dict[str, tuple[Task, ...]]:
    """Return tasks by their disturbance: jobs of their own, so that the last of all does not take long."""
    groups: dict[str, list[Disturbance | None]] = {"none": [None]}
    if quick:
        groups["some"] = [Disturbance("gnss", delay_s=0.3), Disturbance("odometry", clock_s=0.05)]
    else:
        groups["gnss-delay"] = [Disturbance("gnss", delay_s=value) for value in GNSS_DELAYS_S]
        groups["odometry-delay"] = [Disturbance("odometry", delay_s=value) for value in ODOMETRY_DELAYS_S]
        groups["gnss-clock"] = [Disturbance("gnss", clock_s=value) for value in GNSS_CLOCKS_S]
        groups["odometry-clock"] = [Disturbance("odometry", clock_s=value) for value in ODOMETRY_CLOCKS_S]
    return {
        name: tuple(Task("sensitivity", system, "", one) for one in disturbances for system in SENSITIVE)
        for name, disturbances in groups.items()
    }
