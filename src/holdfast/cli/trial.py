"""One trial: a scenario simulated with a seed, estimated under a configuration, and judged by its truth.

Importing it needs the simulator's packages: `holdfast[sim]`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from holdfast.config.load import resolved_yaml
from holdfast.config.model import Config
from holdfast.evaluation import quaternions
from holdfast.evaluation.evidence import Chassis, Fixes, Truth
from holdfast.evaluation.scenario import Verdict, judge
from holdfast.evaluation.states import States
from holdfast.recording.source import open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import PublishedRecorder
from holdfast.sim.configuration import configuration
from holdfast.sim.gnss import Quality
from holdfast.sim.recorder import write_recording
from holdfast.sim.scenario import BASE, Scenario
from holdfast.sim.simulation import START_NS, Simulation, simulate
from holdfast.state import Trajectory

RECORDING, CONFIG = "recording.mcap", "config.yaml"
SLEWING_RAD_S = 0.5


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of one scenario, seed and configuration.

    Attributes:
        outcomes: how often each sensor's measurements came to what.
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
    (folder / CONFIG).write_text(resolved_yaml(configuration(scenario), given_only=True), encoding="utf-8")
    return simulation


def estimate(folder: Path, config: Config, progress: Callable[[int], None] | None = None) -> PublishedRecorder:
    """Run the estimator over the recording in a folder.

    Raises:
        RecordingError: the recording cannot be read.
    """
    recorder = PublishedRecorder(config)
    with open_recording(folder / RECORDING) as recording:
        recorder.run(recording.read(subscriptions(config)), progress)
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
    verdict.scores["update_ms"] = float(np.median(timing.update_ns)) * 1e-6
    outcomes: dict[str, dict[str, int]] = {}
    for (sensor, outcome), count in sorted(recorder.estimator.counts.items()):
        if count:
            outcomes.setdefault(sensor, {})[str(outcome)] = count
    told = [event for event in recorder.events if event.kind not in ("rejected", "late")]
    return Trial(
        seed=simulation.seed,
        verdict=verdict,
        real_time_factor=timing.recorded_s / timing.wall_s,
        outcomes=outcomes,
        events=tuple(((e.stamp_ns - START_NS) * 1e-9, str(e.kind), e.sensor, e.reason) for e in told),
    )


def truth(simulation: Simulation, config: Config, stamps_ns: NDArray[np.int64]) -> Truth:
    """Return the truth about a simulation at the stamps (N,) of an estimate."""
    poses, velocities = _true_states(simulation, stamps_ns)
    antennas = [
        _fixes(simulation, name, config.T_I(sensor.frame)[:3, 3])
        for name, sensor in simulation.scenario.sensors.present().items()
        if name in ("gnss", "gnss_right") and config.reaches(sensor.frame)
    ]
    lidar = _lidar(simulation, config)
    return Truth(
        start_ns=START_NS,
        states=States(poses, velocities),
        antennas=antennas,
        lidar=lidar,
        at_lidar=None if lidar is None else _true_states(simulation, lidar.stamps_ns)[0],
        chassis=_true_chassis(simulation, poses),
        slewing=abs(simulation.motion.joint(_times_s(simulation, stamps_ns))[1]) >= SLEWING_RAD_S,
    )


def _true_states(simulation: Simulation, stamps_ns: NDArray[np.int64]) -> tuple[Trajectory, NDArray[np.float64]]:
    """Return poses and velocities of I in W."""
    moving = simulation.motion.frame(simulation.scenario.sensors.imu.frame, _times_s(simulation, stamps_ns))
    return Trajectory(stamps_ns, moving.p_W, _quaternions(moving.R_W_F)), moving.v_W


def _true_chassis(simulation: Simulation, imu: Trajectory) -> Chassis:
    """Return T_I_B and the yaw rate of B, from the true poses of I."""
    moving = simulation.motion.frame(BASE, _times_s(simulation, imu.stamps_ns))
    into_imu = quaternions.conjugate(imu.quaternions)
    positions = quaternions.rotate(into_imu, moving.p_W - imu.positions)
    turned = quaternions.multiply(into_imu, _quaternions(moving.R_W_F))
    return Chassis(Trajectory(imu.stamps_ns, positions, turned), moving.angular_velocity[:, 2])


def _times_s(simulation: Simulation, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return stamps (N,) in seconds of the scenario; beyond its ends those of its ends."""
    times: NDArray[np.float64] = ((stamps_ns - START_NS) * np.float64(1e-9)).clip(0.0, simulation.motion.duration_s)
    return times


def _fixes(simulation: Simulation, name: str, p_I_G: NDArray[np.float64]) -> Fixes:
    rows, stamps_ns = _by_true_time(simulation, name)
    honest = ~rows["lying"]
    return Fixes(
        stamps_ns=stamps_ns,
        positions=rows["position"],
        errors=rows["error"],
        good=honest & (rows["quality"] == Quality.RTK_FIXED),
        lying=rows["lying"],
        lever_arm=p_I_G,
    )


def _lidar(simulation: Simulation, config: Config) -> Trajectory | None:
    """Return T_I0_I = T_I_L T_L0_L T_I_L^-1 of the lidar odometry as it was measured, at its true times."""
    sheet = simulation.scenario.sensors.lidar
    if sheet is None or len(simulation.delivered["lidar"].stamps_ns) < 2:
        return None
    rows, stamps_ns = _by_true_time(simulation, "lidar")
    T_I_L = config.T_I(sheet.frame)
    mount = _quaternions(T_I_L[None, :3, :3])[0]
    q = quaternions.multiply(quaternions.multiply(mount, rows["quaternion"]), quaternions.conjugate(mount))
    positions = T_I_L[:3, 3] + quaternions.rotate(mount, rows["position"]) - quaternions.rotate(q, T_I_L[:3, 3])
    return Trajectory(stamps_ns, positions, q)


def _by_true_time(simulation: Simulation, name: str) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Return the columns of a sensor's delivered messages and their true stamps (M,), each message once."""
    readings = simulation.delivered[name].readings
    stamps_ns, first = np.unique(START_NS + np.rint(readings.times_s * 1e9).astype(np.int64), return_index=True)
    return {column: values[first] for column, values in readings.values.items()}, stamps_ns


def _quaternions(R: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(Rotation.from_matrix(R).as_quat(), dtype=np.float64)


def trials_of(scenario: Scenario, seed: int, folder: Path, configs: Sequence[Config]) -> list[Trial]:
    """Simulate once and run one trial per configuration."""
    simulation = write_simulation(scenario, seed, folder)
    return [judged(simulation, estimate(folder, config)) for config in configs]
