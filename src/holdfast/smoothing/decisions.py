"""Which measurements are believed, given all of them: graduated non-convexity.

A measurement enters with a weight between 0 and 1 that depends on its squared residual at the optimum, a truncated
quadratic loss that is approached from a smoother one (Yang et al., "Graduated Non-Convexity for Robust Spatial
Perception", RA-L 2020, Eq. 14). It starts from what the causal estimator believed in the end. One that its successors
contradict goes. What was refused, or came too late, is compared with the optimum of the others, given its covariance:
a fix that was right comes back.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np

from holdfast.events import Outcome
from holdfast.graph.batch import Batch
from holdfast.graph.sensor_parameters import with_parameters
from holdfast.graph.smoother import Smoother
from holdfast.graph.solver import Placed
from holdfast.messages import Array
from holdfast.sensors.clock import receiver_constants
from holdfast.sensors.coloured import NAV_SIZE, SlowError, coloured, coloured_factor, root_of
from holdfast.sensors.noise import UNBOUNDED, Colour, correlation_inflation
from holdfast.sensors.position import Motion, predicted_position
from holdfast.sensors.sensor import Innovation, Joint, Measurement, Role, Sensor, State

SHAPES = (1.0, 8.0, 64.0)
"""mu of one round after the other: from a loss that is almost quadratic to one that is truncated."""
CHANGE = 0.02  # of a weight, below which its factor stays
NO_DOUBT = np.zeros((9, 9))
IDENTITY = np.eye(3)
SILENT_S = 1e6  # since the measurement before, where there is none
TURNED_RAD = 5e-3  # by which an attitude may move until what is linear about it is made anew: 0.03 mm at 2 m


@dataclass(slots=True, eq=False)
class Candidate:
    """A measurement that one state explains, on its node.

    Attributes:
        keys: of the node and of the parameters.
        state: for what is known beside the node: angular velocity and joint.
        scale: factor on its covariance that the estimator has learnt.
        weight: of it in the estimate, 0 to 1.
        is_in_doubt: it is not in the estimate until it agrees with the optimum of the others.
        nis: its squared residual over its covariance; NaN where it cannot be compared.
        entered: weight and factor on the covariance with which it is in the problem now.
        slow: the slow part of its error, None where all of it is white.
        linear_at: the attitude about which its factor is linear, None where it is not linear.
    """

    measurement: Measurement
    sensor: Any
    keys: list[int]
    state: State
    scale: float
    weight: float = 0.0
    is_in_doubt: bool = False
    nis: float = float("nan")
    outcome: Outcome = Outcome.USED
    placed: Placed | None = None
    entered: tuple[float, float] = field(default=(0.0, 0.0))
    slow: "_Slow | None" = None
    linear_at: gtsam.Rot3 | None = None
    _inverse: Array | None = None  # of the covariance of a position

    @property
    def limit(self) -> float:
        """The bound of its NIS."""
        is_position = self.sensor.role is Role.POSITION
        return float(self.sensor.limit if is_position else self.sensor.settings.gate_sigma**2)

    @property
    def correlation_s(self) -> float:
        """The correlation time of its error, or of what is white of it."""
        if self.slow is not None:
            return self.slow.colour.white_correlation_s
        of = self.measurement if self.sensor.role is Role.POSITION else self.sensor.settings
        return float(of.correlation_s)  # type: ignore[union-attr]

    def compare(self, batch: Batch, covariance: Array | None = None) -> None:
        """Compare it with the estimate, whose covariance (9, 9) is taken into account; without it, the residual alone.

        A position is compared in short: there are thousands of them, and H is not asked for.
        """
        if covariance is None and self.sensor.role is Role.POSITION:
            position: Any = self.measurement
            state = self._state(batch)
            constants = receiver_constants(self.sensor, state.parameter)
            residual = position.p_W_P - predicted_position(Motion.of(state.nav, state.angular_velocity), *constants)
            if self.slow is not None:
                residual -= self.slow.error(batch, position.covariance * max(1.0, self.scale))
            self.nis = float(residual @ self._information() @ residual)
            return
        state = self._state(batch)._replace(covariance=NO_DOUBT if covariance is None else covariance)
        found = self.sensor.innovation(self.measurement, state)
        if isinstance(found, Outcome):
            self.nis, self.outcome = float("nan"), found
        else:
            found = found._replace(R=found.R * max(1.0, self.scale))
            if covariance is None and self.slow is not None:
                found = found._replace(y=found.y - self.slow.error(batch, found.R))
            self.nis = found.nis(state)

    def _information(self) -> Array:
        if self._inverse is None:
            position: Any = self.measurement
            self._inverse = np.linalg.inv(position.covariance * max(1.0, self.scale))
        return self._inverse

    def enter(self, batch: Batch, inflation: float) -> bool:
        """Put it into the problem as it weighs now; return whether that changes anything."""
        before, inflation_before = self.entered
        is_as_before = abs(before - self.weight) < CHANGE and inflation == inflation_before
        if self.placed is not None and is_as_before and not self._has_turned(batch):
            return False
        if self.placed is None and self.weight == 0.0:
            return False
        if self.placed is not None:
            batch.retract(self.placed)
            self.placed = None
        if self.weight > 0.0:
            self.placed = batch.add(self._factor(batch, inflation * self.scale / self.weight))
        self.entered = self.weight, inflation
        return True

    def _has_turned(self, batch: Batch) -> bool:
        """Whether the attitude is no longer that about which the factor is linear."""
        if self.linear_at is None:
            return False
        turned = self.linear_at.matrix().T @ batch.nav(self.keys[0]).attitude().matrix()
        return bool(np.abs(turned - IDENTITY).max() > TURNED_RAD)

    def _state(self, batch: Batch) -> State:
        state = self.state._replace(nav=batch.nav(self.keys[0]))
        if len(self.keys) > 1:
            value = np.concatenate([batch.vector(key) for key in self.keys[1:]])
            state = state._replace(parameter=value, parameter_covariance=np.zeros((len(value), len(value))))
        return state

    def _factor(self, batch: Batch, inflation: float) -> gtsam.NonlinearFactor:
        factor: gtsam.NonlinearFactor
        self.linear_at = None
        if self.slow is not None:
            factor = self._coloured_factor(batch, self.slow, inflation / self.scale)
        elif self.sensor.role is Role.POSITION:
            factor = self.sensor.factor(self.keys, self.measurement, inflation, self._state(batch))
        else:
            state = self._state(batch)
            innovation = self.sensor.innovation(self.measurement, state)
            factor = self.sensor.factor(self.keys, self.measurement, state, innovation, inflation)
        return factor

    def _coloured_factor(self, batch: Batch, slow: "_Slow", inflation: float) -> gtsam.NonlinearFactor:
        """Return the factor on node, parameters and slow error, the covariance of the white part times `inflation`."""
        state = self._state(batch)
        innovation: Innovation = self.sensor.innovation(self.measurement, state)
        innovation = innovation._replace(R=innovation.R * self.scale)
        size = NAV_SIZE + len(innovation.y)
        error = SlowError(slow.key, slow.block.start, batch.vector(slow.key), np.zeros((size, size)))
        compared = coloured(self.keys, state, innovation, slow.colour, error)
        self.linear_at = state.nav.attitude()
        loss = self.sensor.loss if self.sensor.role is Role.POSITION else UNBOUNDED
        return coloured_factor(self.sensor, self.measurement, compared, error, inflation, loss)


@dataclass(frozen=True, slots=True, eq=False)
class _Slow:
    """The slow part of the error of a measurement: a part of a variable, and how it adds to what is white."""

    key: int
    block: slice
    colour: Colour

    def error(self, batch: Batch, covariance: Array) -> Array:
        """Return the slow error (m,) as it is estimated, of a measurement that claims a covariance (m, m)."""
        error: Array = np.sqrt(self.colour.slow) * root_of(covariance) @ batch.vector(self.key)[self.block]
        return error


def candidate(
    smoother: Smoother,
    sensor: Sensor,
    measurement: Measurement,
    joint: Joint | None,
    scale: float,
    *,
    colour: Colour | None = None,
    is_right: bool = True,
) -> Candidate:
    """Return a measurement on its node, which exists, not in the problem yet.

    Args:
        smoother: that has the node.
        sensor: that measured.
        measurement: it.
        joint: the turn joint at its time.
        scale: factor on its covariance that the estimator has learnt.
        colour: how its error is composed, if its slow part is a state.
        is_right: whether it may be where it says; where not, the slow error does not depend on where that is.
    """
    model: Any = sensor
    stamp_ns = measurement.stamp_ns
    state, key = smoother.state_at(stamp_ns, joint), smoother.node(stamp_ns)
    assert key is not None
    start = None if model.role is Role.POSITION else model.first_parameter(measurement, state)
    keys = [key, *with_parameters(smoother, model, state, stamp_ns, start)[0]]
    if colour is None:
        return Candidate(measurement, model, keys, state, scale)
    at_W = getattr(measurement, "p_W_P", None) if is_right else None
    slow = smoother.slow_error(measurement.sensor, colour, stamp_ns, at_W)
    size = len(slow.covariance) - NAV_SIZE
    part = _Slow(slow.key, slice(slow.first, slow.first + size), colour)
    return Candidate(measurement, model, keys, state, max(1.0, scale), slow=part)


def weight_of(nis: float, limit: float, shape: float) -> float:
    """Return the weight of a residual under a truncated quadratic loss, its non-convexity `shape` the mu of Eq. 14."""
    if not nis < (shape + 1.0) / shape * limit:  # what cannot be compared is NaN
        return 0.0
    if nis <= shape / (shape + 1.0) * limit:
        return 1.0
    return float(np.sqrt(limit * shape * (shape + 1.0) / nis) - shape)


def enter_all(batch: Batch, candidates: Iterable[Candidate]) -> int:
    """Put measurements, in the order of stamps, into the problem as they weigh now; return how many have changed.

    Errors of one sensor that are alike for long are weighed by the time since the one before that is believed.
    """
    last_ns: dict[str, int] = {}
    changed = 0
    for one in candidates:
        name, stamp_ns = one.sensor.name, one.measurement.stamp_ns
        since_s = (stamp_ns - last_ns[name]) * 1e-9 if name in last_ns else SILENT_S
        changed += one.enter(batch, correlation_inflation(one.correlation_s, since_s))
        if one.weight > 0.5:
            last_ns[name] = stamp_ns
    return changed


def refused_runs(candidates: Sequence[Candidate], believed: float) -> list[list[Candidate]]:
    """Return the measurements, in the order of stamps, that weigh less than `believed`, in runs of one sensor each.

    A run ends where one of that sensor is believed.
    """
    runs: list[list[Candidate]] = []
    open_runs: dict[str, list[Candidate]] = {}
    for one in candidates:
        name = one.sensor.name
        if one.weight >= believed:
            open_runs.pop(name, None)
        elif name in open_runs:
            open_runs[name].append(one)
        else:
            runs.append([one])
            open_runs[name] = runs[-1]
    return runs
