"""What is true about a simulation, in the frames of an estimate.

Importing it needs the simulator's packages: the extra `sim`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from holdfast.config.model import Config
from holdfast.evaluation import quaternions
from holdfast.evaluation.evidence import Chassis, Fixes, Truth
from holdfast.evaluation.states import States
from holdfast.sim.scenario import BASE
from holdfast.sim.sensors.gnss import Quality, SimulatedGnss
from holdfast.sim.sensors.odometry import SimulatedOdometry
from holdfast.sim.simulation import START_NS, Simulation
from holdfast.state import Trajectory

SLEWING_RAD_S = 0.5


def truth(simulation: Simulation, config: Config, stamps_ns: NDArray[np.int64]) -> Truth:
    """Return the truth about a simulation at the stamps (N,) of an estimate."""
    poses, velocities = true_states(simulation, stamps_ns)
    antennas = [
        _fixes(simulation, name, config.T_I(sensor.frame)[:3, 3])
        for name, sensor in simulation.scenario.sensors_of(SimulatedGnss).items()
        if config.reaches(sensor.frame)
    ]
    odometry = _odometry(simulation, config)
    return Truth(
        start_ns=START_NS,
        states=States(poses, velocities),
        antennas=antennas,
        odometry=odometry,
        at_odometry=None if odometry is None else true_states(simulation, odometry.stamps_ns)[0],
        chassis=_true_chassis(simulation, poses),
        slewing=abs(simulation.motion.joint(_times_s(simulation, stamps_ns))[1]) >= SLEWING_RAD_S,
    )


def true_states(simulation: Simulation, stamps_ns: NDArray[np.int64]) -> tuple[Trajectory, NDArray[np.float64]]:
    """Return poses and velocities (N, 3) [m/s] of I in W at stamps (N,)."""
    moving = simulation.motion.frame(simulation.scenario.imu.frame, _times_s(simulation, stamps_ns))
    return Trajectory(stamps_ns, moving.p_W, _quaternions(moving.R_W_F)), moving.v_W


def _true_chassis(simulation: Simulation, imu: Trajectory) -> Chassis:
    """Return T_I_B and the yaw rate of B, from the true poses of I."""
    moving = simulation.motion.frame(BASE, _times_s(simulation, imu.stamps_ns))
    into_imu = quaternions.conjugate(imu.quaternions)
    positions = quaternions.rotate(into_imu, moving.p_W - imu.positions)
    attitudes = quaternions.multiply(into_imu, _quaternions(moving.R_W_F))
    return Chassis(Trajectory(imu.stamps_ns, positions, attitudes), moving.angular_velocity[:, 2])


def _times_s(simulation: Simulation, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return stamps (N,) in seconds of the scenario; beyond its ends those of its ends."""
    times: NDArray[np.float64] = ((stamps_ns - START_NS) * np.float64(1e-9)).clip(0.0, simulation.motion.duration_s)
    return times


def _fixes(simulation: Simulation, name: str, p_I_G: NDArray[np.float64]) -> Fixes:
    rows, stamps_ns = _by_true_time(simulation, name)
    faultless = ~rows["faulty"]
    return Fixes(
        stamps_ns=stamps_ns,
        positions=rows["position"],
        errors=rows["error"],
        good=faultless & (rows["quality"] == Quality.RTK_FIXED),
        faulty=rows["faulty"],
        lever_arm=p_I_G,
    )


def _odometry(simulation: Simulation, config: Config) -> Trajectory | None:
    """Return T_I0_I = T_I_L T_L0_L T_I_L^-1 of the first odometry as it was measured, at its true times."""
    name, sheet = next(iter(simulation.scenario.sensors_of(SimulatedOdometry).items()), (None, None))
    if name is None or sheet is None or len(simulation.delivered[name].stamps_ns) < 2:
        return None
    rows, stamps_ns = _by_true_time(simulation, name)
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
