"""The variables and factors of the last seconds, in an iSAM2 that eliminates them in the order of their time.

In that order the Bayes tree is a chain from the oldest variables, its leaves, to the newest, its root: what is new
touches the end of the chain only, the marginal of the newest costs nothing, and the oldest are cut off without
touching the rest. GTSAM's own order has none of this: docs/decisions/018-eliminated-in-the-order-of-time.md.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from itertools import islice

import gtsam

from holdfast.graph.solver import Placed, Value
from holdfast.messages import Array

BATCH_FRACTION = 0.5  # of all variables: from here on all are eliminated anew; iSAM2 itself does so from 0.65 on


class Window:
    """A least-squares problem that grows at one end and is marginalised at the other.

    A variable has the stamp of its last use, and is eliminated anew when that moves. So what lies below a variable in
    the tree was never used later than it, and the variables before a time are leaves. (GTSAM does not check that they
    are, nor that the groups that it is given are fewer than the variables: it crashes.)

    Args:
        thresholds: by the letter of a variable's key; it is relinearised when it has moved by more.
    """

    def __init__(self, thresholds: gtsam.ISAM2ThresholdMap) -> None:
        self._thresholds = thresholds
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR")
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = 1
        parameters.findUnusedFactorSlots = True
        self._isam = gtsam.ISAM2(parameters)
        self._stamps: dict[int, int] = {}  # key -> when the variable was used last [ns]
        self._clear_waiting()

    def _clear_waiting(self) -> None:
        self._factors: list[Placed] = []
        self._values = gtsam.Values()
        self._removed: list[int] = []  # slots
        self._touched: set[int] = set()  # variables to eliminate anew, beside those of the new factors

    def __contains__(self, key: int) -> bool:
        return key in self._stamps

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def factor_count(self) -> int:
        """How many factors there are, those that wait left out."""
        count: int = self._isam.getFactorsUnsafe().nrFactors()
        return count

    def copy(self) -> "tuple[Window, Callable[[Placed], Placed]]":
        """Return one of its own with the same content, and what finds the counterpart of a factor in it.

        It must follow `solve`, so that nothing waits. The estimate is the same to rounding.
        """
        other = Window(self._thresholds)
        factors = self._isam.getFactorsUnsafe()
        slots = [slot for slot in range(factors.size()) if factors.exists(slot)]
        other._values, other._stamps = self._isam.getLinearizationPoint(), dict(self._stamps)
        other._factors = [Placed(_about(factors.at(slot), other._values)) for slot in slots]
        other._take_in()
        counterparts = dict(zip(slots, (placed.slot for placed in other._factors), strict=True))
        other._clear_waiting()
        return other, lambda placed: Placed(placed.factor, None if placed.slot is None else counterparts[placed.slot])

    def insert(self, key: int, value: Value, stamp_ns: int) -> None:
        """Add a variable, about which a factor must follow."""
        self._values.insert(key, value)
        self._stamps[key] = stamp_ns

    def guess(self, key: int, value: Value) -> None:
        """Begin with another value of a variable that waits for `solve`."""
        self._values.update(key, value)

    def keep(self, key: int, stamp_ns: int) -> None:
        """Keep a variable for as long as the time of a factor on it."""
        self._stamps[key] = max(stamp_ns, self._stamps[key])
        self._touched.add(key)

    @property
    def new(self) -> gtsam.Values:
        """The variables that wait for `solve`; not to be written."""
        return self._values

    def add(self, factor: gtsam.NonlinearFactor) -> Placed:
        """Add a factor on variables that are there; it takes effect with `solve`. Return a handle to `retract` it."""
        placed = Placed(factor)
        self._factors.append(placed)
        return placed

    def retract(self, placed: Placed) -> None:
        """Take out a factor on variables that are still there; it takes effect with `solve`."""
        if placed.slot is not None:
            self._removed.append(placed.slot)
            self._touched.update(placed.factor.keys())
            placed.slot = None
        elif placed in self._factors:
            self._factors.remove(placed)

    def solve(self, oldest_ns: int) -> None:
        """Take in what is new, solve, and marginalise the variables that were last used before a time.

        Raises:
            RuntimeError, IndexError, ValueError: GTSAM failed; the window is of no use any more.
        """
        self._take_in()
        self._clear_waiting()
        self._update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [], [])  # one more step, if it has moved far
        self._marginalise(oldest_ns)

    def _take_in(self) -> None:
        graph = gtsam.NonlinearFactorGraph()
        for placed in self._factors:
            graph.add(placed.factor)
        slots = self._update(graph, self._values, self._removed, self._touched)
        for placed, slot in zip(self._factors, slots, strict=True):
            placed.slot = slot

    def _update(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, removed: Sequence[int], touched: Iterable[int]
    ) -> Sequence[int]:
        """Take one step of Gauss-Newton, if there is anything to do; return the slots of the factors."""
        step = gtsam.ISAM2UpdateParams()
        step.removeFactorIndices = removed
        step.extraReelimKeys = _key_list(touched)
        found, _ = self._isam.predictUpdateInfo(graph, values, step)
        if found.empty():
            return []
        affected: Collection[int] = list(islice(found, found.size()))  # its end is an exception in C++, which is slow
        if len(affected) >= BATCH_FRACTION * len(self._stamps):
            affected = self._stamps
            step.extraReelimKeys = _key_list(affected)
        # CCOLAMD orders sets, of which there may be no more than variables: so these are all of them and no others
        order = gtsam.KeyGroupMap()
        for group, key in enumerate(sorted(affected, key=lambda key: (self._stamps[key], key))):
            order.insert2(key, group)
        step.constrainedKeys = order
        slots: Sequence[int] = self._isam.update(graph, values, step).getNewFactorsIndices()
        return slots

    def _marginalise(self, oldest_ns: int) -> None:
        leaves = [key for key, stamp_ns in self._stamps.items() if stamp_ns < oldest_ns]
        if leaves:
            self._isam.marginalizeLeaves(_key_list(leaves))
        for key in leaves:
            del self._stamps[key]

    def nav(self, key: int) -> gtsam.NavState:
        """Return the estimate of a state."""
        return self._isam.calculateEstimateNavState(key)

    def bias(self, key: int) -> gtsam.imuBias.ConstantBias:
        """Return the estimate of a bias."""
        return self._isam.calculateEstimateConstantBias(key)

    def vector(self, key: int) -> Array:
        """Return the estimate of a parameter."""
        value: Array = self._isam.calculateEstimateVector(key)
        return value

    def covariance(self, *keys: int) -> Array:
        """Return the joint covariance of some variables, in the order of the keys."""
        covariance: Array = self._isam.jointMarginalCovariance(keys).fullMatrix()
        return covariance


def _about(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.NonlinearFactor:
    """Return a factor for another iSAM2, in which its variables may be relinearised.

    What the marginalised left behind is linear about a point that the factor does not know: iSAM2 never relinearises
    the variables of such a factor, but only where it made that factor itself.
    """
    if not isinstance(factor, gtsam.LinearContainerFactor):
        return factor
    return gtsam.LinearContainerFactor(factor.linearize(point), point)


def _key_list(keys: Iterable[int]) -> gtsam.KeyList:
    found = gtsam.KeyList()
    for key in keys:
        found.push_back(key)
    return found
