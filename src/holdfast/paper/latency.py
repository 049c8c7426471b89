"""Table II: how long each system takes from an IMU sample to its state, all in one program, in turn.

The paper's latency is the time from the arrival of an IMU sample until the propagated state is available (V-B.2). All
systems get the same message one after the other, in an order that rotates with every message, so that caches, clocks
and other programs affect them equally. Samples on which a system also takes in measurements are counted as updates, and
with the others once more among all samples: a user of the state waits for these, too. Beside the wall time there is the
CPU time, which other programs on the machine do not lengthen. The chassis, which no baseline estimates, is left out.

Ours is there twice: as the estimator, which optimises between two samples, and as the realtime engine, whose optimiser
is another process: there every sample counts, also one that continues from a new optimised state.
"""

from array import array
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter_ns, thread_time_ns
from typing import Any

import numpy as np

from holdfast.bench.realtime import without_chassis
from holdfast.evaluation.percentiles import percentiles
from holdfast.messages import ImuSample, Message
from holdfast.paper.results import Latency
from holdfast.paper.systems import ENGINE, SYSTEMS, configured
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import Localiser
from holdfast.sim.configuration import configuration_data
from holdfast.sim.recorder import write_recording
from holdfast.sim.scenario import load_scenario
from holdfast.sim.simulation import simulate

QUANTILES = (0.0, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 0.995, 0.999, 1.0)
WARM_UP_SAMPLES = 200


class Stopwatch:
    """Feeds one system and keeps how long it took.

    Args:
        localiser: the system.
        engine: the same, if its updates are done by another process, so that no sample waits for one.
    """

    def __init__(self, localiser: Localiser, engine: RealtimeEstimator | None = None) -> None:
        self._localiser = localiser
        self._engine = engine
        self._seen = 0
        self.imu_ns = array("q")
        self.imu_cpu_ns = array("q")
        self.every_cpu_ns = array("q")
        self.update_ns = array("q")

    def feed(self, message: Message) -> None:
        """Let the system process a message."""
        began_ns, began_cpu_ns = perf_counter_ns(), thread_time_ns()
        output = self._localiser.process(message)
        took_cpu_ns, took_ns = thread_time_ns() - began_cpu_ns, perf_counter_ns() - began_ns
        if self._localiser.events:
            self._localiser.take_events()
        if self._engine is not None and not self._engine.initialised:
            self._engine.flush()  # the messages come faster than on a machine, and would end before it starts
        is_sample = output.estimate is not None and isinstance(message, ImuSample)
        has_update = output.optimised is not None and self._engine is None
        self._seen += is_sample
        if has_update:
            self.update_ns.append(took_ns)
        if is_sample and self._seen > WARM_UP_SAMPLES:
            self.every_cpu_ns.append(took_cpu_ns)
            if not has_update:
                self.imu_ns.append(took_ns)
                self.imu_cpu_ns.append(took_cpu_ns)


def measure(scenario: str, overrides: Mapping[str, Any]) -> tuple[Latency, ...]:
    """Return the latencies of all systems on a scenario, seed 0, those of the realtime engine after the others.

    Raises:
        OSError: the recording cannot be written.
        EstimatorError: the optimiser process of the realtime engine does not answer.
    """
    loaded = load_scenario(scenario, dict(overrides))
    given = configuration_data(loaded, seed=0)
    configs = {name: without_chassis(configured(name, given)) for name in SYSTEMS}
    watches = {name: Stopwatch(SYSTEMS[name].make(config)) for name, config in configs.items()}
    with (
        TemporaryDirectory(prefix="holdfast-paper-") as folder,
        RealtimeEstimator(configs["holdfast"]) as engine,
    ):
        watches[ENGINE] = Stopwatch(engine, engine)
        recording = Path(folder) / "recording.mcap"
        write_recording(simulate(loaded, 0), recording, False, None)
        with open_recording(recording) as opened:
            messages = list(opened.read(subscriptions(configs["holdfast"])))
        engine.wait_until_ready()
        _interleave(list(watches.values()), messages)
        engine.flush()
        watches[ENGINE].update_ns.extend(engine.take_update_times())
    return tuple(_latency(name, watch) for name, watch in watches.items())


def _interleave(watches: list[Stopwatch], messages: list[Message]) -> None:
    twice = watches + watches
    for count, message in enumerate(messages):
        first = count % len(watches)
        for watch in islice(twice, first, first + len(watches)):
            watch.feed(message)


def _latency(name: str, watch: Stopwatch) -> Latency:
    imu_us = np.frombuffer(watch.imu_ns, dtype=np.int64) * 1e-3
    quantiles = np.quantile(imu_us, QUANTILES).tolist() if len(imu_us) else []
    return Latency(
        system=name,
        imu_us=percentiles(imu_us),
        imu_cpu_us=percentiles(np.frombuffer(watch.imu_cpu_ns, dtype=np.int64) * 1e-3),
        every_cpu_us=percentiles(np.frombuffer(watch.every_cpu_ns, dtype=np.int64) * 1e-3),
        update_ms=percentiles(np.frombuffer(watch.update_ns, dtype=np.int64) * 1e-6),
        quantiles_us=tuple(zip(QUANTILES, quantiles, strict=False)),
    )
