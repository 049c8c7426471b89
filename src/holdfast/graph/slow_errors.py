"""The slow errors of sensors in one smoother: Gauss-Markov processes of unit variance in epochs of a second.

All are one variable per epoch, a block of it per sensor, so that an epoch costs one variable and one factor: (62) in
docs/math.md. What comes after a silence is joined to what was before, unless its error is another one.
"""

from collections.abc import Mapping
from copy import copy
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.graph.solver import Solver
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.noise import Colour

SLOW = "s"  # letter of the keys
EPOCH_NS = 1_000_000_000
LEAST_VARIANCE = 1e-6  # that enters between two epochs, which may begin at one instant


class Epoch(NamedTuple):
    """A second in which slow errors are constant: when it begins, and its key."""

    stamp_ns: int
    key: int


class Seen(NamedTuple):
    """Where a point was measured (3,) in W [m], and over which distance its error becomes another one [m]."""

    at_W: Array
    distance_constant_m: float


class Step(NamedTuple):
    """How an epoch follows from the one before: that decays by factors (n,), and noise of variances (n,) enters."""

    decay: Array
    variance: Array


class SlowErrors:
    """The slow errors in one smoother.

    Args:
        sizes: how many numbers that of each sensor has, by name.
    """

    def __init__(self, sizes: Mapping[str, int]) -> None:
        firsts = np.cumsum([0, *sizes.values()])
        self._blocks = {
            name: slice(int(a), int(a) + size) for (name, size), a in zip(sizes.items(), firsts, strict=False)
        }
        self.size = int(firsts[-1])
        self._epochs: list[Epoch] = []
        self._time_constants_s = np.ones(self.size)
        self._seen: dict[str, Seen] = {}  # by name: last, and when the newest epoch began
        self._begun_at: dict[str, Seen] = {}
        self._made = 0
        self._used_ns = NEVER_NS
        self._new: dict[int, Array] = {}  # values that the solver has not taken in yet, by key

    def copy(self) -> "SlowErrors":
        """Return an equal one that goes its own way."""
        other = copy(self)
        other._epochs, other._time_constants_s = list(self._epochs), self._time_constants_s.copy()
        other._new, other._seen = dict(self._new), dict(self._seen)
        return other

    def without_past(self) -> "SlowErrors":
        """Return one for the same graph whose errors have nothing to do with those before."""
        other = self.copy()
        other._epochs = []
        return other

    @property
    def newest(self) -> Epoch | None:
        """The newest epoch, if it is still in the window."""
        return self._epochs[-1] if self._epochs else None

    def block(self, name: str) -> slice:
        """Return which elements are those of a sensor."""
        return self._blocks[name]

    def use(
        self, solver: Solver, name: str, colour: Colour, stamp_ns: int, at_W: Array | None
    ) -> tuple[Epoch, Step | None]:
        """Return the epoch of a measurement, and how it follows from the one before if it was just made.

        A sensor whose time constant has changed has begun to err in another way.
        """
        while self._epochs and self._epochs[0].key not in solver:  # they leave in the order in which they came
            del self._epochs[0]
        self._used_ns = max(self._used_ns, stamp_ns)
        block, newest, time_constant_s = self._blocks[name], self.newest, colour.time_constant_s
        is_new_kind = self._time_constants_s[block.start] != time_constant_s
        if at_W is not None:
            self._seen[name] = Seen(at_W, colour.distance_constant_m)
        if newest is None:
            return self._begin(solver, block, time_constant_s, is_new_kind, stamp_ns)
        # one from before the first epoch is near enough to it
        at = next((epoch for epoch in reversed(self._epochs) if epoch.stamp_ns <= stamp_ns), self._epochs[0])
        if at is newest and (is_new_kind or stamp_ns - newest.stamp_ns >= EPOCH_NS):
            return self._begin(solver, block, time_constant_s, is_new_kind, stamp_ns)
        solver.keep(at.key, stamp_ns)
        return at, None

    def value(self, solver: Solver, epoch: Epoch) -> Array:
        """Return the estimate (n,) of an epoch."""
        new = self._new.get(epoch.key)
        return solver.vector(epoch.key) if new is None else new

    def is_solved(self, epoch: Epoch) -> bool:
        """Whether the solver has taken in an epoch."""
        return epoch.key not in self._new

    def mark_solved(self) -> None:
        """Note that the solver has taken in all that it was given."""
        self._new.clear()

    def keep(self, solver: Solver, now_ns: int) -> None:
        """Keep what is known for as long as it lasts, though nothing is measured."""
        newest = self.newest
        if newest is not None and newest.key in solver and now_ns - self._used_ns < 1e9 * self._time_constants_s.max():
            solver.keep(newest.key, now_ns)

    def _moved(self) -> Array:
        """Return by how many distance constants (n,) the sensors have moved since the newest epoch began."""
        moved = np.zeros(self.size)
        for name, seen in self._seen.items():
            begun = self._begun_at.get(name)
            if begun is not None:
                distance_m = float(np.linalg.norm(seen.at_W - begun.at_W))
                moved[self._blocks[name]] = distance_m / seen.distance_constant_m
        return moved

    def _begin(
        self, solver: Solver, block: slice, time_constant_s: float, is_new_kind: bool, stamp_ns: int
    ) -> tuple[Epoch, Step]:
        before = self.newest
        self._time_constants_s[block] = time_constant_s
        self._made += 1
        key: int = gtsam.symbol(SLOW, self._made)
        if before is None:
            decay = np.zeros(self.size)
        else:
            decay = np.exp(-1e-9 * (stamp_ns - before.stamp_ns) / self._time_constants_s - self._moved())
            if is_new_kind:
                decay[block] = 0.0
        self._begun_at = dict(self._seen)
        variance = np.maximum(1.0 - decay**2, LEAST_VARIANCE)
        value = np.zeros(self.size) if before is None else decay * self.value(solver, before)
        self._new[key] = value
        solver.insert(key, value, stamp_ns)
        solver.add(_step_factor(None if before is None else before.key, key, decay, variance))
        self._epochs.append(Epoch(stamp_ns, key))
        return self._epochs[-1], Step(decay, variance)


def _step_factor(before: int | None, key: int, decay: Array, variance: Array) -> gtsam.NonlinearFactor:
    """Return the factor that joins an epoch to the one before, u_k+1 = rho u_k + w; linear about zero."""
    size, sigmas = len(decay), np.sqrt(variance)
    if before is None:
        return gtsam.PriorFactorVector(key, np.zeros(size), gtsam.noiseModel.Diagonal.Sigmas(sigmas))
    at = gtsam.Values()
    at.insert(before, np.zeros(size))
    at.insert(key, np.zeros(size))
    unit = gtsam.noiseModel.Unit.Create(size)
    linear = gtsam.JacobianFactor(before, np.diag(-decay / sigmas), key, np.diag(1.0 / sigmas), np.zeros(size), unit)
    return gtsam.LinearContainerFactor(linear, at)


def sizes_of(config: Config) -> dict[str, int]:
    """Return how many numbers the slow error of each sensor has, by name."""
    return {name: size for name, section in config.sensors.items() if (size := getattr(section, "slow_size", 0))}
