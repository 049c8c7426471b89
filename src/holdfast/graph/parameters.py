"""The constants of sensors, such as a scale factor, among the variables of a window.

A constant is known for longer than a window lives: one that is begun anew takes what the last one knew as its prior.
"""

from collections.abc import Callable, Mapping
from copy import copy
from math import log, sqrt
from types import MappingProxyType
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.graph.solver import Placed, Solver
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.constants import Constant
from holdfast.sensors.noise import FREE_VARIANCE
from holdfast.sensors.sensor import Parameter

MAX_SIZE = 12
RIGHT = 0.0  # log ratio of the densities under what was configured and under the prior, beyond which it is held again
TOLD, NEAR = 0.25, 6.0  # of the sigmas if it is off and if it is right, to the greater of which one must be told
REFUTED = 3.0  # sigmas of what was learnt before a restart
REFRESHED_NS = 1_000_000_000  # a marginal is read this often
DOUBTED_NS = 100_000_000  # and this often while a measurement contradicts what is held
TIME_TO_TELL_NS = 10_000_000_000  # after one was let go, before another is
WALK_NS = 10_000_000_000  # a parameter that walks is another variable after so long
NOT_HELD: Array = np.zeros(1)
NOT_AGAIN_NS = 1 << 62  # when it is read next, where whoever solves asks for it


class Known(NamedTuple):
    """A parameter: its key, estimate (p,) and covariance (p, p), and whether the solver has solved it.

    `is_right` where it is believed to be as configured. `hold` is the factor that holds it there, or those elements of
    one that is off of which nothing is known; `holding` (p,) is the information in that. `carried` is the factor that
    says what was learnt of it before a restart. `begun_ns` is when it became a variable.
    """

    key: int
    value: Array
    covariance: Array
    is_solved: bool
    read_ns: int
    begun_ns: int
    is_right: bool = False
    hold: Placed | None = None
    holding: Array = NOT_HELD
    carried: Placed | None = None


class Belief(NamedTuple):
    """Which elements (p,) of a parameter are to be let go and held again; `worst` is below zero by how surely."""

    goes: NDArray[np.bool_]
    returns: NDArray[np.bool_]
    worst: float


class Parameters:
    """The parameters by the name of their sensor.

    Args:
        refreshed_ns: a marginal is read so often; of a solver that holds minutes it costs the whole problem.
        carried: priors by name that stand in for those of the sensors, as they were learnt before.
        found: priors by name that stand in for those of the sensors for good.
    """

    def __init__(
        self,
        refreshed_ns: int = REFRESHED_NS,
        carried: Mapping[str, Parameter] = MappingProxyType({}),
        found: Mapping[str, Parameter] = MappingProxyType({}),
    ) -> None:
        self._refreshed_ns, self._anew = refreshed_ns, found
        self._carried = {name: one for name, one in carried.items() if name not in found}
        self._known: dict[str, Known] = {}
        self._let_go: Mapping[str, Array] = MappingProxyType({})  # begin there, held by nothing
        self._made = 0
        self._may_be_right: dict[str, Parameter] = {}  # priors of what is held until it proves off
        self._mistaken = frozenset[str]()
        self._gone_ns = self._doubted_ns = NEVER_NS  # when one of them was let go last, and all contradicted

    def copy(self, solver: Solver, counterpart: Callable[[Placed], Placed]) -> "Parameters":
        """Return an equal one for a copy of the solver, in which each factor has a counterpart."""
        other = copy(self)
        other._known = {
            name: known._replace(
                hold=known.hold and counterpart(known.hold), carried=known.carried and counterpart(known.carried)
            )
            if known.key in solver
            else known
            for name, known in self._known.items()
        }
        return other

    def use(self, solver: Solver, name: str, prior: Parameter, stamp_ns: int, start: Array | None = None) -> Known:
        """Return the parameter of a sensor for a factor at a time, made a variable of the solver if it is none.

        `start` (p,) is where it is linearised first; without it at the mean of the prior.
        """
        configured = self._anew.get(name, prior)
        prior = self.prior(name, prior)
        if prior.if_right is not None:
            self._may_be_right[name] = prior
        if name in self._carried or name in self._anew:
            start = None
        known = self._known.get(name)
        if known is None or known.key not in solver:
            known = self._insert(solver, name, prior, stamp_ns, start)
        elif known.is_solved:
            known = known._replace(value=solver.vector(known.key))
            if stamp_ns - known.read_ns >= (DOUBTED_NS if self._is_doubted(known, stamp_ns) else self._refreshed_ns):
                known = _read(solver, known, stamp_ns)
                known = self._reviewed(solver, name, known, prior)
                known = self._unless_refuted(solver, name, known, configured)
        if prior.walk is not None and stamp_ns - known.begun_ns >= WALK_NS:
            known = self._walked(solver, known, prior.walk, stamp_ns)
        solver.keep(known.key, stamp_ns)
        self._known[name] = known
        return known

    def doubt(self, stamp_ns: int) -> None:
        """Know that a measurement contradicts what is estimated: what is held may be the reason."""
        self._doubted_ns = stamp_ns

    def newly_mistaken(self) -> frozenset[str]:
        """Return what was let go since this was asked last while measurements contradicted what had rested on it."""
        found, self._mistaken = self._mistaken, frozenset()
        return found

    def begin_anew(self, name: str, prior: Parameter) -> None:
        """Forget what is known of a sensor's parameter; this prior stands in for that of the configuration."""
        self._forget(name)
        self._anew = {**self._anew, name: prior}

    def let_go(self, name: str, start: Array) -> None:
        """Forget what is known of a sensor's parameter; begin at a value (p,), held nowhere until it proves right."""
        self._forget(name)
        self._let_go = {**self._let_go, name: start}

    def _forget(self, name: str) -> None:
        self._known.pop(name, None)
        self._forget_carried(name)

    def _forget_carried(self, name: str) -> None:
        self._carried = {other: one for other, one in self._carried.items() if other != name}

    def estimate(self, name: str) -> tuple[Array, Array] | None:
        """Return the estimate (p,) of a sensor's parameter and its sigmas (p,), None while there is none."""
        known = self._known.get(name)
        return None if known is None else (known.value, np.sqrt(np.diag(known.covariance)))

    def belief(self, name: str, prior: Parameter) -> tuple[Array, Array]:
        """Return the estimate (p,) and covariance (p, p) of a parameter: those of its prior while there is none."""
        known = self._known.get(name)
        if known is not None:
            return known.value, known.covariance
        prior = self.prior(name, prior)
        return prior.mean, np.diag(prior.sigmas**2)

    def unheld(self, name: str, prior: Parameter) -> tuple[Array, Array]:
        """Return the estimate (p,) and covariance (p, p) of a parameter as if it were not believed to be right."""
        known = self._known.get(name)
        prior = self.prior(name, prior)
        return (prior.mean, np.diag(prior.sigmas**2)) if known is None else _unheld(known, prior.mean)

    def prior(self, name: str, configured: Parameter) -> Parameter:
        """Return the prior that a parameter began with."""
        return self._carried.get(name, self._anew.get(name, configured))

    def review(self, solver: Solver, priors: Mapping[str, Parameter]) -> bool:
        """Read the parameters of some names from a solver that has converged; return whether it must once more.

        It must where a parameter is let go, or held again. From now on nobody else reads them.
        """
        has_changed = False
        for name, configured in priors.items():
            known, prior = self._known.get(name), self.prior(name, configured)
            if known is None or known.key not in solver:
                continue
            read = _read(solver, known, NOT_AGAIN_NS)
            self._known[name] = _believed(solver, read, prior, _belief(read, prior))
            has_changed |= self._known[name].hold is not known.hold
        return has_changed

    def constant(self, name: str, prior: Parameter) -> Constant | None:
        """Return what is known of a parameter, None while there is none."""
        known = self._known.get(name)
        if known is None:
            return None
        sigmas = np.sqrt(np.diag(known.covariance))
        is_off = prior.if_right is not None and not known.is_right
        return Constant(known.value, sigmas, *_unheld(known, self.prior(name, prior).mean), prior, is_off)

    def mark_solved(self) -> None:
        """Note that the solver has taken in all that it was given."""
        for name, known in self._known.items():
            if not known.is_solved:
                self._known[name] = known._replace(is_solved=True)

    def _reviewed(self, solver: Solver, name: str, known: Known, prior: Parameter) -> Known:
        """Return a parameter that was read just now, let go or held again if that is more plausible.

        What measurements contradict that rest on one that is held contradicts others, too: the least plausible goes,
        and is given time to tell.
        """
        belief, now_ns = _belief(known, prior), known.read_ns
        if not (belief.goes.any() and self._is_doubted(known, now_ns)):
            return _believed(solver, known, prior, belief)
        stays = belief._replace(goes=np.zeros_like(belief.goes))
        if now_ns - self._gone_ns < TIME_TO_TELL_NS:
            return _believed(solver, known, prior, stays)
        others = [other for other in self._may_be_right if other != name and self._is_held(solver, other)]
        read = {name: known} | {other: _read(solver, self._known[other], now_ns) for other in others}
        beliefs = {one: _belief(read[one], self._may_be_right[one]) for one in read}
        worst = min(beliefs, key=lambda one: beliefs[one].worst)
        self._gone_ns, self._mistaken = now_ns, self._mistaken | {worst}
        if worst == name:
            return _believed(solver, known, prior, belief)
        self._known[worst] = _believed(solver, read[worst], self._may_be_right[worst], beliefs[worst])
        return _believed(solver, known, prior, stays)

    def _is_doubted(self, known: Known, stamp_ns: int) -> bool:
        """Whether a parameter is held while measurements contradict what rests on those that are."""
        return known.hold is not None and stamp_ns - self._doubted_ns < self._refreshed_ns

    def _is_held(self, solver: Solver, name: str) -> bool:
        """Whether a parameter is held in a solver that has solved it."""
        known = self._known.get(name)
        return known is not None and known.hold is not None and known.is_solved and known.key in solver

    def _unless_refuted(self, solver: Solver, name: str, known: Known, configured: Parameter) -> Known:
        """Return a parameter; what was learnt of it before a restart is dropped where it holds no more."""
        prior = self._carried.get(name)
        if prior is None or known.carried is None or (abs(known.value - prior.mean) <= REFUTED * prior.sigmas).all():
            return known
        self._forget_carried(name)
        solver.retract(known.carried)
        solver.add(
            gtsam.PriorFactorVector(known.key, configured.mean, gtsam.noiseModel.Diagonal.Sigmas(configured.sigmas))
        )
        return known._replace(carried=None)

    def _new_key(self, size: int) -> int:
        self._made += 1
        key: int = gtsam.symbol(parameter_letter(size), self._made)
        return key

    def _walked(self, solver: Solver, known: Known, walk: Array, stamp_ns: int) -> Known:
        """Return a parameter as it is after it has walked on."""
        key = self._new_key(len(walk))
        sigmas = walk * sqrt((stamp_ns - known.begun_ns) * 1e-9)
        solver.insert(key, known.value, stamp_ns)
        solver.keep(known.key, stamp_ns)
        model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        solver.add(gtsam.BetweenFactorVector(known.key, key, np.zeros(len(walk)), model))
        return Known(key, known.value, known.covariance + np.diag(sigmas**2), False, stamp_ns, stamp_ns)

    def _insert(self, solver: Solver, name: str, prior: Parameter, stamp_ns: int, start: Array | None) -> Known:
        before = self._known.get(name)
        mean, covariance = prior.mean, np.diag(prior.sigmas**2)
        value = mean if start is None else start
        if before is not None:
            value, mean, covariance = before.value, *_unheld(before, prior.mean)
        elif name in self._let_go:
            value = mean = self._let_go[name]
        key = self._new_key(len(mean))
        solver.insert(key, value, stamp_ns)
        placed = solver.add(gtsam.PriorFactorVector(key, mean, gtsam.noiseModel.Gaussian.Covariance(covariance)))
        known = Known(key, value, covariance, False, stamp_ns, stamp_ns)
        if before is None and prior is self._carried.get(name):
            known = known._replace(carried=placed)
        if prior.if_right is None:
            return known
        if before is None:
            return _held(solver, known, prior, np.isfinite(prior.if_right) & (name not in self._let_go))
        return _held(solver, known, prior, _is_held(before))


def _read(solver: Solver, known: Known, stamp_ns: int) -> Known:
    """Return a parameter as a solver knows it, read at a time."""
    value, covariance = solver.vector(known.key), solver.covariance(known.key)
    return known._replace(value=value, covariance=covariance, read_ns=stamp_ns)


def _belief(known: Known, prior: Parameter) -> Belief:
    """Return what is more plausibly off than as configured, and the other way round: (54) in docs/math.md."""
    if prior.if_right is None:
        return Belief(NOT_HELD > 0.0, NOT_HELD > 0.0, 0.0)
    log_ratio, held = _evidence(known, prior, prior.if_right), _is_held(known)
    goes = held & (log_ratio < -log(prior.odds))
    return Belief(goes, ~held & (log_ratio > RIGHT), float(np.where(goes, log_ratio + log(prior.odds), 0.0).min()))


def _believed(solver: Solver, known: Known, prior: Parameter, belief: Belief) -> Known:
    """Let go what is off, and hold again what is as configured."""
    if not (belief.goes | belief.returns).any():
        return known
    changed = _held(solver, known, prior, (_is_held(known) & ~belief.goes) | belief.returns)
    # what is let go stays where it is until it is solved
    return changed if belief.returns.any() else changed._replace(value=known.value, is_solved=known.is_solved)


def _evidence(known: Known, prior: Parameter, if_right: Array) -> Array:
    """Return how much more plausible it is that each element (p,) is right than that it is off, as a logarithm.

    Zero where the measurements say too little beside the prior, or where there is no telling.
    """
    precision = 1.0 / known.covariance.diagonal() - 1.0 / prior.sigmas**2 - known.holding
    told = np.where(np.isfinite(if_right), np.maximum(TOLD * prior.sigmas, NEAR * if_right), 0.0)
    is_told = precision * told**2 >= 1.0
    variance = 1.0 / np.maximum(precision, 1e-6 / prior.sigmas**2)  # of what the measurements say alone
    off = (known.value - prior.mean) * variance / known.covariance.diagonal()
    ratio = _log_density(off, variance + if_right**2) - _log_density(off, variance + prior.sigmas**2)
    return np.where(is_told, ratio, 0.0)


def _held(solver: Solver, known: Known, prior: Parameter, which: NDArray[np.bool_]) -> Known:
    """Hold those elements of a parameter that `which` (p,) says where they were configured, and no others."""
    assert prior.if_right is not None
    if known.hold is not None:
        solver.retract(known.hold)
    value, covariance = _unheld(known, prior.mean)
    if not which.any():
        return known._replace(covariance=covariance, is_right=False, hold=None, holding=NOT_HELD)
    sigmas = np.where(which, prior.held * prior.if_right, FREE_VARIANCE**0.5)
    placed = solver.add(gtsam.PriorFactorVector(known.key, prior.mean, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
    holding = np.where(which, sigmas**-2.0, 0.0)
    free = np.linalg.inv(covariance)
    covariance = np.linalg.inv(free + np.diag(holding))
    value = prior.mean + covariance @ free @ (value - prior.mean)
    is_right = bool((which == np.isfinite(prior.if_right)).all())
    return known._replace(
        value=value, covariance=covariance, is_solved=False, is_right=is_right, hold=placed, holding=holding
    )


def _is_held(known: Known) -> NDArray[np.bool_]:
    """Return which elements (p,) of a parameter are held where they were configured."""
    return np.broadcast_to(known.holding > 0.0, known.value.shape)


def _unheld(known: Known, mean: Array) -> tuple[Array, Array]:
    """Return the estimate (p,) and covariance (p, p) of a parameter as they are if nothing holds it at a mean (p,)."""
    if known.hold is None:
        return known.value, known.covariance
    information = np.linalg.inv(known.covariance)
    covariance = np.linalg.inv(information - np.diag(known.holding))
    off: Array = covariance @ information @ (known.value - mean)
    return mean + off, covariance


def _log_density(off: Array, variance: Array) -> Array:
    """Return the logarithm of the normal density, up to a constant."""
    density: Array = -0.5 * (off**2 / variance + np.log(variance))
    return density


def parameter_letter(size: int) -> str:
    """Return the letter of the keys of parameters of a size: iSAM2 takes its thresholds, of that size, by letter."""
    return chr(ord("A") + size)
