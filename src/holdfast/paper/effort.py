"""How long an evaluation is going to take, from what is left to do; an estimate, and told as one."""

import os
from dataclasses import dataclass
from pathlib import Path

from holdfast.paper.job import is_done
from holdfast.paper.study import plan
from holdfast.sim.scenario import load_scenario

# time of a processor per second of a recording, simulation, judging and maps included: from a fast, quiet machine to a
# slow one; `holdfast paper` tells at its end what it was
COST = (0.08, 0.19)


@dataclass(frozen=True, slots=True)
class Effort:
    """What is left to do.

    Attributes:
        runs: of a system on a recording.
        recorded_s: length of all these recordings together.
        at_once: processes that can run side by side here.
        crowding: by how much other work on this machine slows them down, 1 where it is idle.
    """

    runs: int
    recorded_s: float
    at_once: int
    crowding: float

    def range_s(self) -> tuple[float, float]:
        """Return the shortest and the longest time that it may reasonably take [s]."""
        low, high = (cost * self.recorded_s * self.crowding / self.at_once for cost in COST)
        return low, high


def effort(output: Path, seeds: int, quick: bool, jobs: int) -> Effort:
    """Return what an evaluation has still to do; arguments as those of `holdfast.paper.evaluation.evaluate`."""
    recorded_s, runs = 0.0, 0
    for job in plan(seeds, quick):
        todo = sum(not is_done(output, job, task) for task in job.tasks)
        runs += todo
        recorded_s += todo * load_scenario(job.scenario, dict(job.overrides)).duration_s if todo else 0.0
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    at_once = min(jobs, cores)
    return Effort(runs, recorded_s, at_once, max(1.0, (os.getloadavg()[0] + at_once) / cores))
