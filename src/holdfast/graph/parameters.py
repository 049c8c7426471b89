"""The constants of sensors, such as a scale factor, among the variables of a window.

A constant is known for longer than a window lives: one that is begun anew takes what the last one knew as its prior.
"""

from copy import copy
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.solver import Solver
from holdfast.messages import Array
from holdfast.sensors.sensor import Parameter

MAX_SIZE = 12
REFRESHED_NS = 1_000_000_000  # a marginal is read this often


class Known(NamedTuple):
    """A parameter: its key, estimate (p,) and covariance (p, p), and whether the solver has solved it."""

    key: int
    value: Array
    covariance: Array
    is_solved: bool
    read_ns: int


class Parameters:
    """The parameters by the name of their sensor."""

    def __init__(self) -> None:
        self._known: dict[str, Known] = {}
        self._made = 0

    def copy(self) -> "Parameters":
        """Return an equal one that goes its own way."""
        other = copy(self)
        other._known = dict(self._known)
        return other

    def use(self, solver: Solver, name: str, prior: Parameter, stamp_ns: int, start: Array | None = None) -> Known:
        """Return the parameter of a sensor for a factor at a time, made a variable of the solver if it is none.

        `start` (p,) is where it is linearised first; without it at the mean of the prior.
        """
        known = self._known.get(name)
        if known is None or known.key not in solver:
            known = self._insert(solver, known, prior, stamp_ns, start)
        elif known.is_solved:
            covariance, read_ns = known.covariance, known.read_ns
            if stamp_ns - read_ns >= REFRESHED_NS:
                covariance, read_ns = solver.covariance(known.key), stamp_ns
            known = Known(known.key, solver.vector(known.key), covariance, True, read_ns)
        solver.keep(known.key, stamp_ns)
        self._known[name] = known
        return known

    def estimate(self, name: str) -> tuple[Array, Array] | None:
        """Return the estimate (p,) of a sensor's parameter and its sigmas (p,), None while there is none."""
        known = self._known.get(name)
        return None if known is None else (known.value, np.sqrt(np.diag(known.covariance)))

    def mark_solved(self) -> None:
        """Note that the solver has taken in all that it was given."""
        self._known = {name: known._replace(is_solved=True) for name, known in self._known.items()}

    def _insert(
        self, solver: Solver, before: Known | None, prior: Parameter, stamp_ns: int, start: Array | None
    ) -> Known:
        mean, covariance = prior.mean, np.diag(prior.sigmas**2)
        value = mean if start is None else start
        if before is not None:
            value, mean, covariance = before.value, before.value, before.covariance
        self._made += 1
        key: int = gtsam.symbol(parameter_letter(len(mean)), self._made)
        solver.insert(key, value, stamp_ns)
        solver.add(gtsam.PriorFactorVector(key, mean, gtsam.noiseModel.Gaussian.Covariance(covariance)))
        return Known(key, value, covariance, False, stamp_ns)


def parameter_letter(size: int) -> str:
    """Return the letter of the keys of parameters of a size: iSAM2 takes its thresholds, of that size, by letter."""
    return chr(ord("A") + size)
