"""An ablation: every variation of the configuration on every seed of one scenario.

Importing it needs the simulator's packages: the extra `sim`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from holdfast.config.load import config_of
from holdfast.errors import EstimatorError
from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import Scenario
from holdfast.sim.simulation import simulate
from holdfast.trial.pool import processes, run_all
from holdfast.trial.run import estimate, judged, write_simulation
from holdfast.trial.variations import VARIATIONS, changed


@dataclass(frozen=True, slots=True)
class Row:
    """One variation with one seed; where the estimator never started, there are a `failure` and no scores."""

    variation: str
    seed: int
    scores: dict[str, float]
    failure: str = ""


def run_ablation(  # noqa: PLR0917 (what the command line asks for)
    scenario: Scenario,
    output: Path,
    seeds: Sequence[int],
    variations: Sequence[str],
    jobs: int,
    progress: Callable[[int, int], None] | None = None,
) -> list[Row]:
    """Simulate every seed, then run every variation on it; return them by variation, then by seed.

    Args:
        scenario: what is simulated.
        output: folder for the recordings.
        seeds: of the simulations.
        variations: their names.
        jobs: processes at a time.
        progress: called with how many runs are done, and how many there are.

    Raises:
        OSError: a file cannot be written.
        HoldfastError: a process was killed.
    """
    total = len(seeds) * (1 + len(variations))
    came: list[Row | None] = []

    def take(results: list[Row | None]) -> None:
        came.extend(results)
        if progress is not None:
            progress(len(came), total)

    with processes(jobs, f"{output}: a process of the ablation was killed (out of memory?)") as pool:
        run_all(pool, [partial(_simulate, scenario, seed, output) for seed in seeds], take)
        run_all(pool, [partial(_run, scenario, seed, output, name) for name in variations for seed in seeds], take)
    order = list(VARIATIONS)
    return sorted((row for row in came if row is not None), key=lambda row: (order.index(row.variation), row.seed))


def _folder(output: Path, seed: int) -> Path:
    return output / f"seed-{seed}"


def _simulate(scenario: Scenario, seed: int, output: Path) -> None:
    write_simulation(scenario, seed, _folder(output, seed))


def _run(scenario: Scenario, seed: int, output: Path, name: str) -> Row:
    config = config_of(changed(configuration_data(scenario, seed), VARIATIONS[name]), name)
    recorder = estimate(_folder(output, seed), config)
    try:
        trial = judged(simulate(scenario, seed), recorder)
    except EstimatorError:
        return Row(name, seed, {}, f"never started: {recorder.estimator.waiting_for}")
    return Row(name, seed, trial.verdict.scores)
