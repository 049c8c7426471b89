"""Starting in motion: attitude, heading, velocity and biases from a stretch of GNSS and IMU, solved as one batch.

Heading has many local minima, so the batch is solved from several headings and the best solution must stand out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from holdfast.graph.nodes import to_grid
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import ImuNoise, preintegrate
from holdfast.sensors.sensor import Position, PositionSensor
from holdfast.state import OptimisedState

HEADINGS = 8
DISTINCT = 9.0  # difference of the objective (half a chi-square) by which the best heading must win
VELOCITY_SIGMA_M_S = 30.0  # no machine is faster


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The outcome of one batch.

    Attributes:
        state: at the last fix, or None where the heading is not yet certain.
        reason: what was found, in words.
        heading_sigma_rad: standard deviation of the heading, if a single best solution was found.
    """

    state: OptimisedState | None
    reason: str
    heading_sigma_rad: float | None = None


class BatchAligner:
    """Solves the batch; one instance per estimator."""

    def __init__(
        self,
        buffer: ImuBuffer,
        noise: ImuNoise,
        sensors: Mapping[str, PositionSensor],
        bias_sigmas: Array,
    ) -> None:
        self._buffer = buffer
        self._noise = noise
        self._sensors = sensors
        self._bias_sigmas = bias_sigmas  # (6,) accelerometer [m/s^2], gyroscope [rad/s]

    def solve(
        self,
        positions: Sequence[Position],
        bias: gtsam.imuBias.ConstantBias,
        motions: Sequence[gtsam.NonlinearFactor],
        max_heading_sigma_rad: float,
    ) -> Alignment:
        """Align the window that `positions` (sorted by stamp, within IMU coverage) span.

        `motions` are relative factors of odometries, if there are any, between keys x(0), x(1), ... of the stamps.
        """
        stamps = sorted({to_grid(position.stamp_ns) for position in positions})
        graph, deltas = self._graph(stamps, positions, bias)
        for factor in motions:
            graph.add(factor)
        solutions: list[tuple[float, gtsam.Values]] = []
        for k in range(HEADINGS):
            initial = self._initial(stamps, positions, deltas, bias, 2.0 * np.pi * k / HEADINGS)
            try:
                values = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
            except RuntimeError:
                continue
            solutions.append((graph.error(values), values))
        if not solutions:
            return Alignment(None, "the batch of GNSS and IMU has no solution")
        return self._judge(graph, stamps, sorted(solutions, key=lambda s: s[0]), max_heading_sigma_rad)

    def _judge(
        self,
        graph: gtsam.NonlinearFactorGraph,
        stamps: list[int],
        solutions: list[tuple[float, gtsam.Values]],
        max_heading_sigma_rad: float,
    ) -> Alignment:
        last = gtsam.symbol("x", len(stamps) - 1)
        error, best = solutions[0]
        nav = best.atNavState(last)
        for other_error, other in solutions[1:]:
            apart = abs(nav.attitude().between(other.atNavState(last).attitude()).rpy()[2])
            if apart > 3.0 * max_heading_sigma_rad and other_error - error < DISTINCT:
                return Alignment(None, "the motion so far fits more than one heading")
        per_fix = 2.0 * error / (3.0 * len(stamps))
        if per_fix > 25.0:
            return Alignment(None, f"GNSS and IMU disagree: squared residuals are {per_fix:.0f} times what they claim")
        try:
            joint = gtsam.Marginals(graph, best).jointMarginalCovariance([last, gtsam.symbol("b", 0)])
        except RuntimeError:
            return Alignment(None, "the motion so far does not determine the heading")
        covariance: Array = joint.fullMatrix()
        R = nav.attitude().matrix()
        sigma = float(np.sqrt((R @ covariance[:3, :3] @ R.T)[2, 2]))
        if sigma > max_heading_sigma_rad:
            known, needed = np.degrees(sigma), np.degrees(max_heading_sigma_rad)
            reason = f"heading is known to {known:.1f} deg, {needed:.1f} deg are needed"
            return Alignment(None, reason, sigma)
        bias = best.atConstantBias(gtsam.symbol("b", 0))
        rate = self._buffer.angular_velocity(stamps[-1]) - bias.gyroscope()
        return Alignment(OptimisedState(stamps[-1], nav, bias, covariance, rate), "heading from motion", sigma)

    def _graph(
        self, stamps: list[int], positions: Sequence[Position], bias: gtsam.imuBias.ConstantBias
    ) -> tuple[gtsam.NonlinearFactorGraph, list[gtsam.PreintegratedImuMeasurements]]:
        graph = gtsam.NonlinearFactorGraph()
        b0 = gtsam.symbol("b", 0)
        graph.add(gtsam.PriorFactorConstantBias(b0, bias, gtsam.noiseModel.Diagonal.Sigmas(self._bias_sigmas)))
        deltas = []
        for k in range(len(stamps) - 1):
            steps = self._buffer.steps(stamps[k], stamps[k + 1])
            pim = preintegrate(steps, self._noise, level_attitude(steps[0].specific_force), bias)
            graph.add(gtsam.ImuFactor2(gtsam.symbol("x", k), gtsam.symbol("x", k + 1), b0, pim))
            deltas.append(pim)
        index = {stamp: k for k, stamp in enumerate(stamps)}
        for position in positions:
            key = gtsam.symbol("x", index[to_grid(position.stamp_ns)])
            graph.add(self._sensors[position.sensor].factor(key, position, 1.0))
        weak = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([10.0, 1e6, VELOCITY_SIGMA_M_S], 3))
        graph.add(gtsam.PriorFactorNavState(gtsam.symbol("x", 0), gtsam.NavState(), weak))
        return graph, deltas

    def _initial(
        self,
        stamps: list[int],
        positions: Sequence[Position],
        deltas: list[gtsam.PreintegratedImuMeasurements],
        bias: gtsam.imuBias.ConstantBias,
        heading_rad: float,
    ) -> gtsam.Values:
        """Gravity gives roll and pitch, GNSS position and velocity, the gyroscope the rotations between."""
        attitudes = [gtsam.Rot3()]
        up = np.zeros(3)
        for pim in deltas:
            up += attitudes[-1].rotate(pim.deltaVij())  # mean specific force over the window is gravity
            attitudes.append(attitudes[-1].compose(pim.deltaRij()))
        level = level_attitude(up)
        first = gtsam.Rot3.Yaw(heading_rad).compose(level)
        t = np.array(stamps) * 1e-9 - stamps[0] * 1e-9
        t_fix = np.array([to_grid(p.stamp_ns) for p in positions]) * 1e-9 - stamps[0] * 1e-9
        p_fix = np.array([p.p_W_P for p in positions])
        track = np.column_stack([np.interp(t, t_fix, p_fix[:, axis]) for axis in range(3)])
        velocity = np.gradient(track, t, axis=0)
        values = gtsam.Values()
        values.insert(gtsam.symbol("b", 0), bias)
        for k, attitude in enumerate(attitudes):
            R_W_I = first.compose(attitude)
            arm = R_W_I.rotate(self._sensors[positions[0].sensor].p_I_P)
            values.insert(gtsam.symbol("x", k), gtsam.NavState(R_W_I, track[k] - arm, velocity[k]))
        return values


def level_attitude(specific_force: Array) -> gtsam.Rot3:
    """Return the attitude R_W_I with zero heading that puts the specific force (3,) upright."""
    fx, fy, fz = specific_force
    roll = np.arctan2(fy, fz)
    pitch = np.arctan2(-fx, np.hypot(fy, fz))
    return gtsam.Rot3.RzRyRx(roll, pitch, 0.0)
