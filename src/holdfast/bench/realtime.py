"""Measures the realtime engine as it would run on a machine: samples come at their own pace, another process optimises.

Times depend on the machine and its load, and after a pause every cache is cold. So the floor, GTSAM alone integrating
and predicting one sample, is measured in the same loop, midway between two samples: compare ratios.
"""

import gc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from time import perf_counter, perf_counter_ns, process_time, sleep
from typing import Any, Literal

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import BaseImuConfig, JointConfig
from holdfast.errors import EstimatorError
from holdfast.evaluation.percentiles import percentiles
from holdfast.messages import ImuSample, Message
from holdfast.realtime.engine import RealtimeEstimator

WARM_UP_ESTIMATES = 50
SPIN_S = 0.002  # a caller that spins does not sleep for so long before an arrival

Result = dict[str, Any]
Pace = Literal["sleep", "spin", "none"]


@dataclass(slots=True)
class Measured:
    """Times of one run: `imu` from a sample to its estimate, `fresh` of these with a new optimised state.

    `late` counts the estimates that were not there when the next sample was due, for whatever reason; `slow` the calls
    that took longer than from a sample to the next.
    """

    imu_ns: list[int] = field(default_factory=list)
    fresh_ns: list[int] = field(default_factory=list)
    floor_ns: list[int] = field(default_factory=list)
    update_ns: list[int] = field(default_factory=list)
    age_ns: list[int] = field(default_factory=list)
    late: int = 0
    slow: int = 0
    wall_s: float = 0.0
    cpu_s: float = 0.0
    optimiser_cpu_s: float | None = None  # from the first estimate on


class Floor:
    """GTSAM alone: one sample in, one state out, no covariance, nothing checked."""

    def __init__(self) -> None:
        params = gtsam.PreintegrationParams.MakeSharedU(9.81)
        self._bias, self._start = gtsam.imuBias.ConstantBias(), gtsam.NavState()
        self._pim = gtsam.PreintegratedImuMeasurements(params, self._bias)

    def measure(self, sample: ImuSample) -> int:
        """Return how long a sample took [ns]."""
        if self._pim.deltaTij() > 1.0:
            self._pim.resetIntegration()
        began_ns = perf_counter_ns()
        self._pim.integrateMeasurement(sample.specific_force, sample.angular_velocity, 0.01)
        self._pim.predict(self._start, self._bias)
        return perf_counter_ns() - began_ns


def without_chassis(config: Config) -> Config:
    """Return the configuration of the same machine of which only the cabin is estimated."""
    on_chassis = {*config.sensors_of(JointConfig), *config.sensors_of(BaseImuConfig)}
    on_chassis |= {name for name in config.sensors if config.is_beyond_joint(config.frame_of(name))}
    sensors = {name: sensor for name, sensor in config.sensors.items() if name not in on_chassis}
    frames = config.frames.model_copy(update={"base": config.imu_frame})
    return config.model_copy(update={"sensors": sensors, "frames": frames, "turn_joint": None})


def measure_realtime(
    config: Config,
    messages: Sequence[Message],
    pace: Pace,
    *,
    is_idle: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Measured:
    """Play messages through the engine.

    Args:
        config: of the estimator.
        messages: in the order of arrival; those of sensors that are not configured are left out.
        pace: how to wait for the next arrival; `none` gives the samples back to back.
        is_idle: after the start, keep measurements from the optimiser.
        progress: called with the arrival [ns] every now and then.

    Raises:
        EstimatorError: it never started, or too little came to measure.
    """
    measured, floor = Measured(), Floor()
    messages = [message for message in messages if message.sensor in config.sensors]
    with RealtimeEstimator(config) as engine:
        engine.wait_until_ready()
        gc.collect()
        gc.freeze()  # existing objects are not scanned again
        try:
            began_s, cpu_s = perf_counter(), process_time()
            for count, (message, is_floor, due_s, next_s) in enumerate(_paced(messages, pace, config.imu_name)):
                if is_floor and isinstance(message, ImuSample):
                    measured.floor_ns.append(floor.measure(message))
                elif isinstance(message, ImuSample) or not (is_idle and engine.initialised):
                    took_s = _step(engine, message, measured)
                    if took_s is not None:
                        measured.late += perf_counter() > next_s
                        measured.slow += took_s > next_s - due_s
                    if pace == "none" and not engine.initialised:
                        engine.flush()  # otherwise the messages end before the estimator has started
                if progress is not None and count % 500 == 0:
                    progress(message.arrival_ns)
            measured.wall_s, measured.cpu_s = perf_counter() - began_s, process_time() - cpu_s
        finally:
            gc.unfreeze()
        engine.flush()
        measured.update_ns = engine.take_update_times()
        measured.optimiser_cpu_s = engine.optimiser_cpu_s - (measured.optimiser_cpu_s or 0.0)
        if len(measured.imu_ns) <= 2 * WARM_UP_ESTIMATES:
            raise EstimatorError(f"too short to measure: {len(measured.imu_ns)} estimates ({engine.waiting_for})")
    return measured


def _step(engine: RealtimeEstimator, message: Message, measured: Measured) -> float | None:
    """Give a message to the engine; return how long an estimate took [s], None where there is none."""
    began_ns = perf_counter_ns()
    output = engine.process(message)
    took_ns = perf_counter_ns() - began_ns
    if output.estimate is not None and engine.newest_state is not None:
        if measured.optimiser_cpu_s is None:
            measured.optimiser_cpu_s = engine.optimiser_cpu_s  # what the start took
        measured.imu_ns.append(took_ns)
        measured.age_ns.append(output.estimate.stamp_ns - engine.newest_state.stamp_ns)
        if output.optimised is not None:
            measured.fresh_ns.append(took_ns)
    return None if output.estimate is None else took_ns * 1e-9


def _paced(messages: Sequence[Message], pace: Pace, imu_name: str) -> Iterator[tuple[Message, bool, float, float]]:
    """Yield each message when it arrives, and each IMU sample once more for the floor, midway from the one before.

    With each comes whether it is for the floor, when it is due and when the next sample of the IMU is [s].
    """
    schedule: list[tuple[int, int, Message, bool, float]] = []
    imu_ns = [message.arrival_ns for message in messages if message.sensor == imu_name]
    last_ns, samples = None, 0
    for order, message in enumerate(messages):
        if message.sensor == imu_name:
            if last_ns is not None:
                schedule.append(((last_ns + message.arrival_ns) // 2, order, message, True, inf))
            last_ns, samples = message.arrival_ns, samples + 1
        next_ns = imu_ns[samples] if samples < len(imu_ns) else inf
        schedule.append((message.arrival_ns, order, message, False, next_ns))
    schedule.sort(key=lambda row: row[:2])
    began, first_ns = perf_counter(), schedule[0][0]
    for arrival_ns, _, message, is_floor, next_ns in schedule:
        due = began + (arrival_ns - first_ns) * 1e-9
        if pace != "none":
            _wait_until(due, SPIN_S if pace == "spin" else 0.0)
        yield message, is_floor, due, began + (next_ns - first_ns) * 1e-9


def _wait_until(due: float, spin_s: float) -> None:
    ahead_s = due - perf_counter() - spin_s
    if ahead_s > 0.0:
        sleep(ahead_s)
    while spin_s and perf_counter() < due:
        pass


def summarise_measured(measured: Measured) -> Result:
    """Return the percentiles of a run, ratios to its floor, and the fraction of a core that each process used.

    `cpu.imu_samples` is what the calls with samples took, `cpu.imu_path` their process with its waiting and the floor.
    """
    floor = percentiles(np.array(measured.floor_ns) * 1e-3)
    imu = percentiles(np.array(measured.imu_ns[WARM_UP_ESTIMATES:]) * 1e-3)
    assert imu is not None
    ratios = {key: imu[key] / floor[key] for key in ("median", "p99")} if floor else {}
    return {
        "imu_us": imu,
        "fresh_us": percentiles(np.array(measured.fresh_ns) * 1e-3),
        "floor_us": floor,
        "ratio_to_floor": ratios,
        "age_ms": percentiles(np.array(measured.age_ns[WARM_UP_ESTIMATES:]) * 1e-6),
        "update_ms": percentiles(np.array(measured.update_ns) * 1e-6),
        "late": measured.late,
        "slow": measured.slow,
        "cpu": {
            "imu_samples": sum(measured.imu_ns) * 1e-9 / measured.wall_s,
            "imu_path": measured.cpu_s / measured.wall_s,
            "optimiser": (measured.optimiser_cpu_s or 0.0) / measured.wall_s,
        },
        "wall_s": measured.wall_s,
    }
