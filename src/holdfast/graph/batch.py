"""The variables and factors of a long stretch of time, solved to the optimum: Levenberg-Marquardt over all of them.

What is marginalised leaves its exact Gaussian on the variables that it touched, linear about the optimum. A stretch
that begins where another one ended knows so all that was measured before.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.solver import Placed, Value
from holdfast.messages import Array

MAX_ITERATIONS = 30  # of one call of `converge`
RELATIVE_TOLERANCE = 1e-5  # of the cost, at which an iteration was the last
MAX_LINEARISATIONS = 3  # of factors in Python, in one call
RELINEARISE = 1e-3  # of the cost: if no more is gained, they are linearised where they should be
MOVED = 1e-3  # of a variable, in its units: what is linear about it is off by the square
FIRST_LAMBDA = 1e-9  # the start is the estimate of a filter: almost Gauss-Newton


class Solved(NamedTuple):
    """What one call of `converge` did: the cost before and after, half the sum of weighted squares, and iterations."""

    before: float
    after: float
    iterations: int


class Batch:
    """A least-squares problem over a stretch of time; a `Solver` whose `solve` only takes the oldest out.

    It grows as a `Window` does. `converge` solves it; factors may be put in and taken out between two calls.
    """

    def __init__(self) -> None:
        self._graph = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._stamps: dict[int, int] = {}  # key -> when the variable was used last [ns]
        self._placed: dict[int, Placed] = {}  # by slot
        self._slow: dict[int, Sequence[int]] = {}  # the keys of factors that are written in Python, by slot
        self._linear: dict[int, gtsam.LinearContainerFactor] = {}  # they, linear about an estimate, by slot
        self._tree: gtsam.GaussianBayesTree | None = None

    def __contains__(self, key: int) -> bool:
        return key in self._stamps

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def factor_count(self) -> int:
        """How many factors there are."""
        return len(self._placed)

    def insert(self, key: int, value: Value, stamp_ns: int) -> None:
        """Add a variable, about which a factor must follow."""
        self._values.insert(key, value)
        self._stamps[key] = stamp_ns

    def guess(self, key: int, value: Value) -> None:
        """Begin with another value of a variable."""
        self._values.update(key, value)

    @property
    def new(self) -> gtsam.Values:
        """The variables that wait for `solve`: none."""
        return gtsam.Values()

    def keep(self, key: int, stamp_ns: int) -> None:
        """Keep a variable for as long as the time of a factor on it."""
        self._stamps[key] = max(stamp_ns, self._stamps[key])

    def add(self, factor: gtsam.NonlinearFactor) -> Placed:
        """Add a factor on variables that are there. Return a handle to `retract` it."""
        placed = Placed(factor, self._graph.size())
        self._graph.push_back(factor)
        self._note(placed)
        self._tree = None
        return placed

    def _note(self, placed: Placed) -> None:
        assert placed.slot is not None
        self._placed[placed.slot] = placed
        if isinstance(placed.factor, gtsam.CustomFactor):
            self._slow[placed.slot] = placed.factor.keys()

    def retract(self, placed: Placed) -> None:
        """Take out a factor on variables that are still there."""
        if placed.slot is not None and self._placed.get(placed.slot) is placed:
            self._graph.remove(placed.slot)
            del self._placed[placed.slot]
            self._slow.pop(placed.slot, None)
            self._linear.pop(placed.slot, None)
            placed.slot = None
            self._tree = None

    def converge(self) -> Solved:
        """Solve for all variables.

        Factors in Python are linearised where this begins, and once more where it ends if that is far away: in every
        iteration they would take most of the time. So are only those whose variables have moved since.

        Raises:
            RuntimeError: GTSAM failed; the estimate is what it was.
        """
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(MAX_ITERATIONS)
        parameters.setRelativeErrorTol(RELATIVE_TOLERANCE)
        parameters.setlambdaInitial(FIRST_LAMBDA)
        before, iterations = None, 0
        for _ in range(MAX_LINEARISATIONS):
            optimiser = gtsam.LevenbergMarquardtOptimizer(self._native(), self._values, parameters)
            cost = optimiser.error()
            before = cost if before is None else before
            self._move(optimiser.optimize())
            iterations += optimiser.iterations()
            if not self._slow or cost - optimiser.error() < RELINEARISE * cost:
                break
        return Solved(before or 0.0, optimiser.error(), iterations)

    def _move(self, values: gtsam.Values) -> None:
        """Take over an estimate; what is linear about variables that have moved must be linearised anew."""
        if self._linear:
            steps = self._values.localCoordinates(values)
            joined = {key for slot in self._linear for key in self._slow[slot]}
            moved = {key for key in joined if np.abs(steps.at(key)).max() > MOVED}
            stale = [slot for slot in self._linear if not moved.isdisjoint(self._slow[slot])]
            for slot in stale:
                del self._linear[slot]
        self._values, self._tree = values, None

    def _native(self) -> gtsam.NonlinearFactorGraph:
        """Return the graph with those factors linear that are written in Python."""
        graph = gtsam.NonlinearFactorGraph(self._graph)
        for slot in self._slow:
            if slot not in self._linear:
                linear = self._placed[slot].factor.linearize(self._values)
                self._linear[slot] = gtsam.LinearContainerFactor(linear, self._values)
            graph.replace(slot, self._linear[slot])
        return graph

    def solve(self, oldest_ns: int) -> None:
        """Marginalise the variables that were last used before a time; `converge` comes first.

        Raises:
            RuntimeError: the problem is not determined.
        """
        leaves = {key for key, stamp_ns in self._stamps.items() if stamp_ns < oldest_ns}
        if leaves:
            self._marginalise(leaves)

    def _marginalise(self, leaves: set[int]) -> None:
        touched = gtsam.NonlinearFactorGraph()
        rest: list[Placed] = []
        for placed in self._placed.values():
            if leaves.isdisjoint(placed.factor.keys()):
                rest.append(placed)
            else:
                touched.push_back(placed.factor)
                placed.slot = None
        order = gtsam.Ordering()
        for key in sorted(leaves, key=lambda key: (self._stamps[key], key)):
            order.push_back(key)
        _, left = _without(touched.linearize(self._values), order)
        self._graph, self._placed, self._slow, self._linear = gtsam.NonlinearFactorGraph(), {}, {}, {}
        for placed in rest:
            placed.slot = self._graph.size()
            self._graph.push_back(placed.factor)
            self._note(placed)
        for number in range(left.size()):
            if left.exists(number):
                self.add(gtsam.LinearContainerFactor(left.at(number), self._values))
        for key in leaves:
            self._values.erase(key)
            del self._stamps[key]
        self._tree = None

    def nav(self, key: int) -> gtsam.NavState:
        """Return the estimate of a state."""
        return self._values.atNavState(key)

    def bias(self, key: int) -> gtsam.imuBias.ConstantBias:
        """Return the estimate of a bias."""
        return self._values.atConstantBias(key)

    def vector(self, key: int) -> Array:
        """Return the estimate of a parameter."""
        value: Array = self._values.atVector(key)
        return value

    def covariance(self, *keys: int) -> Array:
        """Return the joint covariance of some variables, in the order of the keys, given all factors."""
        if self._tree is None:
            self._tree = self._eliminated(self._native().linearize(self._values))
        covariance: Array
        if len(keys) == 1:
            covariance = self._tree.marginalCovariance(keys[0])
        else:
            covariance = self._tree.jointMarginalCovariance(list(keys)).fullMatrix()
        return covariance

    @staticmethod
    def _eliminated(linear: gtsam.GaussianFactorGraph) -> gtsam.GaussianBayesTree:
        order = gtsam.Ordering.OrderingType.COLAMD
        try:
            return linear.eliminateMultifrontal(order)
        except RuntimeError:  # Cholesky squares the condition; QR takes several times as long
            return linear.eliminateMultifrontal(order, gtsam.EliminateQR)

    def error(self, factor: gtsam.NonlinearFactor) -> float:
        """Return half the weighted square of a factor's residual, whether it is in the problem or not."""
        return float(factor.error(self._values))

    def copy(self) -> "tuple[Batch, Callable[[Placed], Placed]]":
        """Return one of its own with the same content, and what finds the counterpart of a factor in it."""
        other = Batch()
        other._values, other._stamps = gtsam.Values(self._values), dict(self._stamps)
        found = {id(placed): other.add(placed.factor) for placed in self._placed.values()}
        return other, lambda placed: found[id(placed)]


def _without(
    linear: gtsam.GaussianFactorGraph, order: gtsam.Ordering
) -> tuple[gtsam.GaussianBayesTree, gtsam.GaussianFactorGraph]:
    """Return what is eliminated in an order, and what that leaves on the other variables."""
    try:
        return linear.eliminatePartialMultifrontal(order)
    except RuntimeError:
        return linear.eliminatePartialMultifrontal(order, gtsam.EliminateQR)
