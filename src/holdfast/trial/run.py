"""One trial: a scenario simulated with a seed, estimated under a configuration, and judged by its truth.

Importing it needs the simulator's packages: the extra `sim`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np

from holdfast.config.load import resolved_yaml
from holdfast.config.model import Config
from holdfast.evaluation.scenario import Verdict, judge
from holdfast.lidar_odometry.replayed import ReplayedScans
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import PublishedRecorder
from holdfast.sim.configuration import configuration
from holdfast.sim.recorder import write_recording
from holdfast.sim.scenario import Scenario
from holdfast.sim.simulation import START_NS, Simulation, simulate
from holdfast.trial.truth import truth

RECORDING, CONFIG = "recording.mcap", "config.yaml"


@dataclass(frozen=True, slots=True)
class Trial:
    """The results of one scenario, seed and configuration.

    Attributes:
        outcomes: number of each sensor's measurements by outcome.
        events: (seconds since the start, kind, sensor, reason) of what happened, but for single rejected measurements.
    """

    seed: int
    verdict: Verdict
    real_time_factor: float
    outcomes: dict[str, dict[str, int]]
    events: tuple[tuple[float, str, str, str], ...]


def write_simulation(scenario: Scenario, seed: int, folder: Path) -> Simulation:
    """Simulate, and write recording and configuration into a folder; `holdfast simulate` writes more.

    Raises:
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    simulation = simulate(scenario, seed)
    write_recording(simulation, folder / RECORDING, False, None)
    (folder / CONFIG).write_text(resolved_yaml(configuration(scenario, seed), given_only=True), encoding="utf-8")
    return simulation


def estimate(folder: Path, config: Config, progress: Callable[[int], None] | None = None) -> PublishedRecorder:
    """Run the estimator over the recording in a folder.

    Raises:
        RecordingError: the recording cannot be read.
    """
    recorder = PublishedRecorder(config)
    with (
        open_recording(folder / RECORDING) as recording,
        ReplayedScans(config, recording.read(subscriptions(config))) as messages,
    ):
        recorder.run(messages, progress)
    return recorder


def judged(simulation: Simulation, recorder: PublishedRecorder) -> Trial:
    """Judge what an estimator published about a simulation.

    Raises:
        EstimatorError: it published nothing.
    """
    published = recorder.published()
    config = recorder.estimator.config
    verdict = judge(published, truth(simulation, config, published.world.poses.stamps_ns))
    timing = recorder.timing
    verdict.scores["update_ms"] = float(np.median(timing.update_ns)) * 1e-6 if timing.update_ns else nan
    return Trial(
        seed=simulation.seed,
        verdict=verdict,
        real_time_factor=timing.real_time_factor or nan,
        outcomes=recorder.outcomes(),
        events=recorder.event_rows(START_NS),
    )


def trials_of(scenario: Scenario, seed: int, folder: Path, configs: Sequence[Config]) -> list[Trial]:
    """Simulate once and run one trial per configuration."""
    simulation = write_simulation(scenario, seed, folder)
    return [judged(simulation, estimate(folder, config)) for config in configs]
