"""Starting in motion: attitude, heading, velocity and biases from a stretch of GNSS and IMU, solved as one batch.

The first guess turns the increments of velocity that the IMU measured into those that GNSS saw (Wahba's problem).
Heading may have other minima, so the batch is solved from other headings as well, and the best must stand out.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, sqrt
from typing import NamedTuple, TypeVar

import gtsam
import numpy as np

from holdfast.graph.nodes import to_grid
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.noise import correlation_inflation, shared_inflation
from holdfast.sensors.preintegration import ImuNoise, preintegrate
from holdfast.sensors.sensor import Position, PositionSensor, Velocity, VelocitySensor
from holdfast.state import OptimisedState

HEADINGS = 3  # the first guess, and others evenly beside it
ITERATIONS = 15
DISTINCT = 9.0  # difference of the objective (half a chi-square) by which the best heading must win
VELOCITY_SIGMA_M_S = 30.0  # no machine is faster
MAX_EXCESS = 400.0  # of the squared residuals over their expectation: claims that are twenty times too small
LEAST_NOISE = 0.01  # of the variance that is claimed, where residuals show less
CLAIMED_DEGREES = 30.0  # of freedom, that residuals must have to count as much as a claim: neighbours err alike
REWEIGHTED = 2  # times: how residuals fall to positions and velocities depends on what they weigh
BUCKET_NS = 1_000_000_000  # of each sensor one measurement in so long: errors of neighbours are alike
FREE = 1e6
Point = TypeVar("Point", Position, Velocity)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The outcome of one batch.

    Attributes:
        state: at the last fix, or None where the heading is not yet certain.
        reason: what was found, in words.
        heading_sigma_rad: standard deviation of the heading, if a single best solution was found.
        excess: squared residuals over their expectation.
        misfit: the same, or how many times more than claimed the positions or the velocities vary, if that is more.
    """

    state: OptimisedState | None
    reason: str
    heading_sigma_rad: float | None = None
    excess: float = inf
    misfit: float = inf


class BiasPrior(NamedTuple):
    """What is known of the biases: their mean, and (6,) sigmas of accelerometer [m/s^2] and gyroscope [rad/s]."""

    bias: gtsam.imuBias.ConstantBias
    sigmas: Array


class Evidence(NamedTuple):
    """What a batch is made of.

    Attributes:
        positions: thinned, sorted by stamp.
        velocities: of antennas, thinned, within the span of the positions.
        motions: relative factors of odometries between keys x(0), x(1), ... of the stamps of the others.
    """

    positions: Sequence[Position]
    velocities: Sequence[Velocity]
    motions: Sequence[gtsam.NonlinearFactor] = ()

    @property
    def stamps(self) -> list[int]:
        """The stamps of the nodes."""
        return sorted({to_grid(one.stamp_ns) for series in (self.positions, self.velocities) for one in series})

    @property
    def freedom(self) -> int:
        """How many numbers there are more than unknowns."""
        return 3 * (len(self.positions) + len(self.velocities)) + 6 * len(self.motions) - 9


class Noise(NamedTuple):
    """Factors on the variances that positions and velocities claim.

    A receiver may be better than it claims, for a slow error moves a whole stretch and turns nothing; or worse.
    """

    of_positions: float = 1.0
    of_velocities: float = 1.0


class Problem(NamedTuple):
    """The graph of a batch, and which of its factors are those of positions and velocities."""

    graph: gtsam.NonlinearFactorGraph
    positions: range
    velocities: range

    def noise(self, values: gtsam.Values, used: Noise, freedom: int) -> Noise:
        """Return what residuals say of the noise, given that with which the values were found: (71) in docs/math.md."""
        measured = max(len(self.positions) + len(self.velocities), 1)
        share = max(freedom, 1) / (3 * measured)  # of the residuals, what is not used up by unknowns

        def factor(indices: range, before: float) -> float:
            if not indices:
                return 1.0
            degrees = max(3 * len(indices) * share, 1.0)
            found = before * sum(2.0 * self.graph.at(k).error(values) for k in indices) / degrees
            if found < 1.0:
                found **= degrees / (degrees + CLAIMED_DEGREES)
            return float(np.clip(found, LEAST_NOISE, MAX_EXCESS))

        return Noise(factor(self.positions, used.of_positions), factor(self.velocities, used.of_velocities))


class BatchAligner:
    """Solves the batch again and again while its window moves on; one instance per start.

    Args:
        buffer: of the IMU's samples.
        noise: of the IMU.
        positions: their sensors, by name.
        velocities: their sensors, by name.
    """

    def __init__(
        self,
        buffer: ImuBuffer,
        noise: ImuNoise,
        positions: Mapping[str, PositionSensor],
        velocities: Mapping[str, VelocitySensor],
    ) -> None:
        self._buffer = buffer
        self._noise = noise
        self._positions, self._velocities = positions, velocities
        estimated = [(name, one.parameter) for name, one in positions.items() if one.parameter is not None]
        self._arms = {name: (gtsam.symbol("a", k), prior) for k, (name, prior) in enumerate(estimated)}
        self._deltas: dict[tuple[int, int], gtsam.PreintegratedImuMeasurements] = {}

    def solve(self, evidence: Evidence, prior: BiasPrior, max_heading_sigma_rad: float) -> Alignment:
        """Align the window that measurements span.

        Args:
            evidence: measurements while the IMU measured, of at least two positions.
            prior: of the biases.
            max_heading_sigma_rad: what is wanted.
        """
        deltas, noise = self._preintegrate(evidence.stamps, prior.bias), Noise()
        problem = self._problem(evidence, deltas, prior, noise)
        solutions = _solved(problem.graph, list(self._starts(evidence, deltas, prior.bias)))
        for _ in range(REWEIGHTED if solutions else 0):
            noise = problem.noise(solutions[0][1], noise, evidence.freedom)
            problem = self._problem(evidence, deltas, prior, noise)
            solutions = _solved(problem.graph, [values for _, values in solutions])
        if not solutions:
            return Alignment(None, "the batch of GNSS and IMU has no solution")
        return self._judge(problem.graph, evidence, solutions, noise, max_heading_sigma_rad)

    def _starts(
        self,
        evidence: Evidence,
        deltas: Sequence[gtsam.PreintegratedImuMeasurements],
        bias: gtsam.imuBias.ConstantBias,
    ) -> Iterator[gtsam.Values]:
        """Yield where the search begins: the first guess of the heading, and others evenly beside it."""
        track, speeds = _course(evidence)
        first, attitudes = _first_attitude(evidence.stamps, deltas, speeds, self._noise.gravity)
        arm = self._positions[evidence.positions[0].sensor].p_I_P
        for k in range(HEADINGS):
            turned = gtsam.Rot3.Yaw(2.0 * np.pi * k / HEADINGS).compose(first)
            values = gtsam.Values()
            values.insert(gtsam.symbol("b", 0), bias)
            for i, attitude in enumerate(attitudes):
                R_W_I = turned.compose(attitude)
                values.insert(gtsam.symbol("x", i), gtsam.NavState(R_W_I, track[i] - R_W_I.rotate(arm), speeds[i]))
            for key, prior in self._arms.values():
                values.insert(key, prior.mean)
            yield values

    def _judge(
        self,
        graph: gtsam.NonlinearFactorGraph,
        evidence: Evidence,
        solutions: Sequence[tuple[float, gtsam.Values]],
        noise: Noise,
        max_heading_sigma_rad: float,
    ) -> Alignment:
        stamps = evidence.stamps
        last = gtsam.symbol("x", len(stamps) - 1)
        error, best = solutions[0]
        nav = best.atNavState(last)
        excess = 2.0 * error / max(evidence.freedom, 1)
        scale = max(1.0, excess)
        if max(excess, *noise) >= MAX_EXCESS:
            times = sqrt(max(excess, *noise))
            why = f"GNSS and IMU disagree: the residuals are {times:.0f} times what they claim"
            return Alignment(None, f"{why}; `holdfast config init` finds axes, units and clocks that are wrong")
        for other_error, other in solutions[1:]:
            apart = abs(nav.attitude().between(other.atNavState(last).attitude()).rpy()[2])
            if apart > 3.0 * max_heading_sigma_rad and other_error - error < DISTINCT * scale:
                return Alignment(None, "the motion so far fits more than one heading")
        try:
            joint = gtsam.Marginals(graph, best).jointMarginalCovariance([last, gtsam.symbol("b", 0)])
        except RuntimeError:
            return Alignment(None, "the motion so far does not determine the heading")
        covariance: Array = joint.fullMatrix() * scale
        R = nav.attitude().matrix()
        sigma = float(np.sqrt((R @ covariance[:3, :3] @ R.T)[2, 2]))
        if sigma > max_heading_sigma_rad:
            known, needed = np.degrees(sigma), np.degrees(max_heading_sigma_rad)
            reason = f"heading is known to {known:.1f} deg, {needed:.1f} deg are needed"
            return Alignment(None, reason, sigma, excess)
        # a slow error of the positions is still that of the newest
        covariance[3:6, 3:6] += R.T @ evidence.positions[-1].covariance @ R * max(0.0, 1.0 - noise.of_positions)
        bias = best.atConstantBias(gtsam.symbol("b", 0))
        rate = self._buffer.angular_velocity(stamps[-1]) - bias.gyroscope()
        state = OptimisedState(stamps[-1], nav, bias, covariance, rate)
        return Alignment(state, f"heading from motion, {np.degrees(sigma):.1f} deg", sigma, excess, max(excess, *noise))

    def _preintegrate(
        self, stamps: Sequence[int], bias: gtsam.imuBias.ConstantBias
    ) -> list[gtsam.PreintegratedImuMeasurements]:
        """Return what leads from each stamp to the next; most of it is known from the attempt before."""
        known, self._deltas = self._deltas, {}
        for start, end in pairwise(stamps):
            pim = known.get((start, end))
            if pim is None:
                steps, seen = self._buffer.steps(start, end), self._buffer.density(start, end)
                pim = preintegrate(steps, self._noise, level_attitude(steps[0].specific_force), bias, seen)
            self._deltas[start, end] = pim
        return list(self._deltas.values())

    def _problem(
        self,
        evidence: Evidence,
        deltas: Sequence[gtsam.PreintegratedImuMeasurements],
        prior: BiasPrior,
        noise: Noise,
    ) -> Problem:
        graph, stamps = gtsam.NonlinearFactorGraph(), evidence.stamps
        keys = {stamp: gtsam.symbol("x", k) for k, stamp in enumerate(stamps)}
        for (start, end), pim in zip(pairwise(stamps), deltas, strict=True):
            graph.add(gtsam.ImuFactor2(keys[start], keys[end], gtsam.symbol("b", 0), pim))
        first = graph.size()
        for name, sensor in self._positions.items():
            own = [one for one in evidence.positions if one.sensor == name]
            arm_keys = [self._arms[name][0]] if name in self._arms else []
            gaps_s = [(b.stamp_ns - a.stamp_ns) * 1e-9 for a, b in pairwise(own)]
            correlation_s = max((one.correlation_s for one in own), default=0.0)
            inflation = shared_inflation(correlation_s, [inf, *gaps_s]) * noise.of_positions
            for one in own:
                graph.add(sensor.factor([keys[to_grid(one.stamp_ns)], *arm_keys], one, inflation))
        of_positions = range(first, graph.size())
        for velocity in evidence.velocities:
            graph.add(self._velocity_factor(keys[to_grid(velocity.stamp_ns)], velocity, noise.of_velocities))
        of_velocities = range(of_positions.stop, graph.size())
        for key, of_arm in self._arms.values():
            graph.add(gtsam.PriorFactorVector(key, of_arm.mean, gtsam.noiseModel.Diagonal.Sigmas(of_arm.sigmas)))
        for motion in evidence.motions:
            graph.add(motion)
        weak = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([10.0, FREE, VELOCITY_SIGMA_M_S], 3))
        graph.add(gtsam.PriorFactorNavState(keys[stamps[0]], gtsam.NavState(), weak))
        of_biases = gtsam.noiseModel.Diagonal.Sigmas(prior.sigmas)
        graph.add(gtsam.PriorFactorConstantBias(gtsam.symbol("b", 0), prior.bias, of_biases))
        return Problem(graph, of_positions, of_velocities)

    def _velocity_factor(self, key: int, velocity: Velocity, noise: float) -> gtsam.NonlinearFactor:
        """Return a prior on the velocity of I; while the heading is unknown, the lever arm adds to the noise."""
        sensor = self._velocities[velocity.sensor]
        turning = np.cross(self._buffer.angular_velocity(velocity.stamp_ns), sensor.p_I_P)
        correlated = correlation_inflation(sensor.settings.correlation_s, BUCKET_NS * 1e-9)
        variance = np.diag(velocity.covariance) * correlated * noise
        sigmas = np.sqrt(np.minimum(variance + turning @ turning, FREE**2))
        model = gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([np.full(6, FREE), sigmas]))
        return gtsam.PriorFactorNavState(key, gtsam.NavState(gtsam.Pose3(), velocity.v_W_P), model)


def _solved(graph: gtsam.NonlinearFactorGraph, starts: Sequence[gtsam.Values]) -> list[tuple[float, gtsam.Values]]:
    """Return the objective and the values that are found from each start, the best first."""
    parameters, found = gtsam.LevenbergMarquardtParams(), []
    parameters.setMaxIterations(ITERATIONS)
    for values in starts:
        try:
            solved = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        except RuntimeError:
            continue
        found.append((graph.error(solved), solved))
    return sorted(found, key=lambda one: one[0])


def thin(measurements: Sequence[Point]) -> list[Point]:
    """Return, of measurements that are sorted by stamp, each sensor's first in every second, and the newest."""
    kept: list[Point] = []
    known: set[tuple[str, int]] = set()
    for one in measurements:
        bucket = one.sensor, one.stamp_ns // BUCKET_NS
        if bucket not in known or one is measurements[-1]:
            known.add(bucket)
            kept.append(one)
    return kept


def _course(evidence: Evidence) -> tuple[Array, Array]:
    """Return position and velocity (N, 3) at the nodes, interpolated; velocities from positions if there are none."""
    stamps, positions = evidence.stamps, evidence.positions
    t = _seconds(stamps, stamps[0])
    track = _interpolate(t, _seconds([one.stamp_ns for one in positions], stamps[0]), [one.p_W_P for one in positions])
    measured = [one for one in evidence.velocities if one.covariance.diagonal().max() < VELOCITY_SIGMA_M_S**2]
    if len(measured) < 2:
        return track, np.gradient(track, t, axis=0)
    at = _seconds([one.stamp_ns for one in measured], stamps[0])
    return track, _interpolate(t, at, [one.v_W_P for one in measured])


def _seconds(stamps: Sequence[int], origin_ns: int) -> Array:
    return np.array([stamp - origin_ns for stamp in stamps]) * 1e-9


def _interpolate(at: Array, times: Array, values: Sequence[Array]) -> Array:
    rows = np.array(values)
    return np.column_stack([np.interp(at, times, rows[:, axis]) for axis in range(3)])


def _first_attitude(
    stamps: Sequence[int], deltas: Sequence[gtsam.PreintegratedImuMeasurements], speeds: Array, gravity: float
) -> tuple[gtsam.Rot3, list[gtsam.Rot3]]:
    """Return R_W_I at the first node, and the attitudes at all nodes relative to it, by the gyroscope.

    The specific force that was integrated between nodes, turned into I at the first, must be the change of velocity
    without gravity: the rotation between these two sets of vectors.
    """
    attitudes = [gtsam.Rot3()]
    sensed = []
    for pim in deltas:
        sensed.append(attitudes[-1].rotate(pim.deltaVij()))
        attitudes.append(attitudes[-1].compose(pim.deltaRij()))
    expected = np.diff(speeds, axis=0)
    expected[:, 2] += gravity * np.diff(_seconds(stamps, stamps[0]))
    return gtsam.Rot3.ClosestTo(expected.T @ np.array(sensed)), attitudes


def level_attitude(specific_force: Array) -> gtsam.Rot3:
    """Return the attitude R_W_I with zero heading that puts the specific force (3,) upright."""
    fx, fy, fz = specific_force
    roll = np.arctan2(fy, fz)
    pitch = np.arctan2(-fx, np.hypot(fy, fz))
    return gtsam.Rot3.RzRyRx(roll, pitch, 0.0)
