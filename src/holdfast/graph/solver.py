"""What the smoother asks of an optimiser: its verbs, so that another one is another file beside `window.py`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, Self

import gtsam

from holdfast.messages import Array

GTSAM_ERRORS = RuntimeError, IndexError, ValueError
"""What GTSAM raises where a problem has no solution, or is not solved yet."""

Value = gtsam.NavState | gtsam.imuBias.ConstantBias | Array


@dataclass(slots=True, eq=False)
class Placed:
    """A factor and its index in the solver, once it is there."""

    factor: gtsam.NonlinearFactor
    slot: int | None = None


class Solver(Protocol):
    """A least-squares problem that grows at one end and is marginalised at the other."""

    def __contains__(self, key: int) -> bool:
        """Whether a variable is there."""

    def insert(self, key: int, value: Value, stamp_ns: int) -> None:
        """Add a variable that is used until a time, about which a factor must follow."""

    def guess(self, key: int, value: Value) -> None:
        """Begin with another value of a variable that waits for `solve`."""

    @property
    def new(self) -> gtsam.Values:
        """The variables that wait for `solve`; not to be written."""

    def keep(self, key: int, stamp_ns: int) -> None:
        """Keep a variable for as long as the time of a factor on it."""

    def add(self, factor: gtsam.NonlinearFactor) -> Placed:
        """Add a factor on variables that are there; it takes effect with `solve`. Return a handle to `retract` it."""

    def retract(self, placed: Placed) -> None:
        """Take out a factor on variables that are still there; it takes effect with `solve`."""

    def solve(self, oldest_ns: int) -> None:
        """Take in what is new, solve, and marginalise the variables that were last used before a time.

        Raises:
            RuntimeError, IndexError, ValueError: it failed, and is of no use any more.
        """

    def nav(self, key: int) -> gtsam.NavState:
        """Return the estimate of a state."""

    def bias(self, key: int) -> gtsam.imuBias.ConstantBias:
        """Return the estimate of a bias."""

    def vector(self, key: int) -> Array:
        """Return the estimate of a parameter."""

    def covariance(self, *keys: int) -> Array:
        """Return the joint covariance of some variables, in the order of the keys."""

    def copy(self) -> tuple[Self, Callable[[Placed], Placed]]:
        """Return one of its own with the same content, and what finds the counterpart of a factor in it.

        It must follow `solve`, so that nothing waits. The estimate is the same to rounding.
        """
