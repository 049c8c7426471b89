"""The batch of a start in motion as a graph: what it is made of, and what its residuals say of the noise."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf
from typing import NamedTuple, TypeVar

import gtsam
import numpy as np

from holdfast.graph.first_guess import FASTEST_M_S, level_attitude
from holdfast.graph.nodes import to_grid
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lever_arm import is_in_doubt
from holdfast.sensors.noise import correlation_inflation, shared_inflation
from holdfast.sensors.position import arm_factor
from holdfast.sensors.preintegration import ImuNoise, preintegrate
from holdfast.sensors.sensor import Position, PositionSensor, Velocity, VelocitySensor

MAX_EXCESS = 400.0  # of the squared residuals over their expectation: claims that are twenty times too small
CLAIMED_DEGREES = 30.0  # of freedom, that residuals must have to count as much as a claim: neighbours err alike
BUCKET_NS = 1_000_000_000  # of each sensor one measurement in so long: errors of neighbours are alike
FAR_RAD_S = 0.02  # over a second what is linear about a bias is right to 2e-4 rad
FREE = 1e6
TIED_M = 1e-4  # by which two arms that have one shift may differ otherwise
Point = TypeVar("Point", Position, Velocity)


class BiasPrior(NamedTuple):
    """What is known of the biases: their mean, and (6,) sigmas of accelerometer [m/s^2] and gyroscope [rad/s]."""

    bias: gtsam.imuBias.ConstantBias
    sigmas: Array


class Spell(NamedTuple):
    """From a stamp on [ns], the biases are constant."""

    since_ns: int
    prior: BiasPrior


class Evidence(NamedTuple):
    """What a batch is made of.

    Attributes:
        positions: thinned, sorted by stamp.
        velocities: of antennas, thinned, since the first of the positions.
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


class Belief(NamedTuple):
    """How far a claim is believed where residuals show less noise.

    Attributes:
        degrees: of freedom, that residuals must have to count as much.
        least: of the variance that is claimed, whatever they show.
    """

    degrees: float
    least: float


class Problem(NamedTuple):
    """The graph of a batch, which factors are those of positions and velocities, and the key of the newest bias.

    `of_positions` are what the factors of positions are of.
    """

    graph: gtsam.NonlinearFactorGraph
    positions: range
    velocities: range
    last_bias: int
    of_positions: Sequence[Position]

    def worst(self, values: gtsam.Values) -> Position:
        """Return the position that is furthest from where values have it, beside what it claims."""
        left = [self.graph.at(k).error(values) for k in self.positions]
        return self.of_positions[left.index(max(left))]

    def noise(self, values: gtsam.Values, used: Noise, freedom: int, claims: Belief) -> Noise:
        """Return what residuals say of the noise, given that with which the values were found: (71) in docs/math.md."""
        measured = max(len(self.positions) + len(self.velocities), 1)
        share = max(freedom, 1) / (3 * measured)  # of the residuals, what is not used up by unknowns

        def factor(indices: range, before: float) -> float:
            if not indices:
                return 1.0
            degrees = max(3 * len(indices) * share, 1.0)
            found = before * sum(2.0 * self.graph.at(k).error(values) for k in indices) / degrees
            if found < 1.0:
                found **= degrees / (degrees + claims.degrees)
            return float(np.clip(found, claims.least, MAX_EXCESS))

        return Noise(factor(self.positions, used.of_positions), factor(self.velocities, used.of_velocities))


class Problems:
    """Makes the graph of a batch again and again while its window moves on; one instance per start.

    Args:
        buffer: of the IMU's samples.
        noise: of the IMU.
        positions: their sensors, by name.
        velocities: their sensors, by name.

    Attributes:
        buffer: as given, as are `noise` and `positions`.
        arms: key of each lever arm that is in doubt, by receiver.
    """

    def __init__(
        self,
        buffer: ImuBuffer,
        noise: ImuNoise,
        positions: Mapping[str, PositionSensor],
        velocities: Mapping[str, VelocitySensor],
    ) -> None:
        self.buffer, self.noise = buffer, noise
        self.positions, self._velocities = positions, velocities
        doubted = [name for name, one in positions.items() if is_in_doubt(one.parameters)]
        self.arms = {name: gtsam.symbol("a", k) for k, name in enumerate(doubted)}
        self._deltas: dict[tuple[int, int], gtsam.PreintegratedImuMeasurements] = {}
        self._bias = gtsam.imuBias.ConstantBias()  # about which they are linear

    def preintegrate(
        self, stamps: Sequence[int], bias: gtsam.imuBias.ConstantBias
    ) -> list[gtsam.PreintegratedImuMeasurements]:
        """Return what leads from each stamp to the next, linear about a bias or one near it.

        Most of it is known from the attempt before.
        """
        is_far = np.abs(bias.gyroscope() - self._bias.gyroscope()).max() > FAR_RAD_S
        known, self._deltas = {} if is_far else self._deltas, {}
        if not known:
            self._bias = bias
        for start, end in pairwise(stamps):
            pim = known.get((start, end))
            if pim is None:
                steps, seen = self.buffer.steps(start, end), self.buffer.density(start, end)
                attitude = level_attitude(steps[0].specific_force)
                pim = preintegrate(steps, self.noise, attitude, self._bias, seen)
            self._deltas[start, end] = pim
        return list(self._deltas.values())

    def problem(
        self,
        evidence: Evidence,
        deltas: Sequence[gtsam.PreintegratedImuMeasurements],
        spells: Sequence[Spell],
        noise: Noise,
    ) -> Problem:
        """Return the graph.

        Args:
            evidence: of which it is made.
            deltas: what the IMU measured between the stamps of the evidence.
            spells: of the biases, in order, the first from the beginning.
            noise: on what is claimed.
        """
        graph, stamps = gtsam.NonlinearFactorGraph(), evidence.stamps
        keys = {stamp: gtsam.symbol("x", k) for k, stamp in enumerate(stamps)}
        for (start, end), pim in zip(pairwise(stamps), deltas, strict=True):
            spell = sum(one.since_ns <= start for one in spells) - 1
            graph.add(gtsam.ImuFactor2(keys[start], keys[end], gtsam.symbol("b", spell), pim))
        first, placed = graph.size(), list[Position]()
        for name, sensor in self.positions.items():
            own = [one for one in evidence.positions if one.sensor == name]
            placed += own
            arm_key = self.arms.get(name)
            gaps_s = [(b.stamp_ns - a.stamp_ns) * 1e-9 for a, b in pairwise(own)]
            correlation_s = max((one.correlation_s for one in own), default=0.0)
            inflation = shared_inflation(correlation_s, [inf, *gaps_s]) * noise.of_positions
            for one in own:
                key = keys[to_grid(one.stamp_ns)]
                if arm_key is None:
                    graph.add(sensor.factor([key], one, inflation))
                else:
                    graph.add(arm_factor(key, arm_key, one, sensor.loss, inflation))
        of_positions = range(first, graph.size())
        for velocity in evidence.velocities:
            graph.add(self._velocity_factor(keys[to_grid(velocity.stamp_ns)], velocity, noise.of_velocities))
        of_velocities = range(of_positions.stop, graph.size())
        for factor in self._of_arms():
            graph.add(factor)
        for motion in evidence.motions:
            graph.add(motion)
        weak = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([10.0, FREE, FASTEST_M_S], 3))
        graph.add(gtsam.PriorFactorNavState(keys[stamps[0]], gtsam.NavState(), weak))
        for k, (_, prior) in enumerate(spells):
            of_biases = gtsam.noiseModel.Diagonal.Sigmas(prior.sigmas)
            graph.add(gtsam.PriorFactorConstantBias(gtsam.symbol("b", k), prior.bias, of_biases))
        return Problem(graph, of_positions, of_velocities, gtsam.symbol("b", len(spells) - 1), placed)

    def shifts(self) -> dict[str, tuple[int, PositionSensor]]:
        """Return the key of the lever arm that tells each shift, by its name, and whose arm it is."""
        found: dict[str, tuple[int, PositionSensor]] = {}
        for name, key in self.arms.items():
            found.setdefault(self.positions[name].parameters[0].name(name), (key, self.positions[name]))
        return found

    def _of_arms(self) -> Iterator[gtsam.NonlinearFactor]:
        """Yield the priors of lever arms; those that share a shift are tied to the first of them."""
        first = self.shifts()
        for name, key in self.arms.items():
            sensor = self.positions[name]
            prior = sensor.parameters[0]
            other_key, other = first[prior.name(name)]
            if other is sensor:
                model = gtsam.noiseModel.Diagonal.Sigmas(prior.sigmas)
                yield gtsam.PriorFactorVector(key, sensor.p_I_P, model)
            else:
                between = sensor.p_I_P - other.p_I_P
                yield gtsam.BetweenFactorVector(other_key, key, between, gtsam.noiseModel.Isotropic.Sigma(3, TIED_M))

    def _velocity_factor(self, key: int, velocity: Velocity, noise: float) -> gtsam.NonlinearFactor:
        """Return a prior on the velocity of I; while the heading is unknown, the lever arm adds to the noise."""
        sensor = self._velocities[velocity.sensor]
        turning = np.cross(self.buffer.angular_velocity(velocity.stamp_ns), sensor.p_I_P)
        correlated = correlation_inflation(sensor.settings.correlation_s, BUCKET_NS * 1e-9)
        variance = np.diag(velocity.covariance) * correlated * noise
        sigmas = np.sqrt(np.minimum(variance + turning @ turning, FREE**2))
        model = gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([np.full(6, FREE), sigmas]))
        return gtsam.PriorFactorNavState(key, gtsam.NavState(gtsam.Pose3(), velocity.v_W_P), model)


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
