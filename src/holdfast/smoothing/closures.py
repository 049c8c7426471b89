"""Loop closures as the optimum takes them: relative poses of nodes, judged with all else."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.covariances import Covariances
from holdfast.graph.batch import Batch
from holdfast.graph.solver import Placed
from holdfast.messages import Array
from holdfast.sensors.noise import FREE_VARIANCE
from holdfast.smoothing.block import Track
from holdfast.smoothing.decisions import SHAPES, weight_of

LIMIT = 22.5  # of the squared residual of six numbers: 0.1 % of the right ones lie beyond
CONTRADICTED = "contradicted by the others"


class Closure(NamedTuple):
    """A place that was seen twice: the pose of I at a later node in I at an earlier one.

    `covariance` (6, 6) is that of its tangent, rotation [rad] then translation [m], in the later.
    """

    earlier_ns: int
    later_ns: int
    T: gtsam.Pose3
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """What is known of a stretch of the track when closures are looked for.

    Attributes:
        covariances: at the nodes; closures join them.
        after_ns: only closures whose later end is after it are wanted; the others are known.
        calibrations: (8,) of odometries: what is believed of mounting, scale and clock, as in `OdometryCalibration`.
    """

    track: Track
    covariances: Covariances
    after_ns: int
    calibrations: Mapping[str, Array]


class Found(NamedTuple):
    """Closures that were verified, and how many candidates were accepted, or refused for what reason."""

    closures: Sequence[Closure]
    counts: Counter[str]


Closer = Callable[[Stretch], Found]


@dataclass(slots=True, eq=False)
class _Weighed:
    closure: Closure
    keys: tuple[int, int]
    weight: float = 1.0
    entered: float = 0.0
    placed: Placed | None = None

    def enter(self, batch: Batch) -> bool:
        if self.weight == self.entered:
            return False
        if self.placed is not None:
            batch.retract(self.placed)
            self.placed = None
        if self.weight > 0.0:
            self.placed = batch.add(_factor(self.closure, self.keys, self.weight))
        self.entered = self.weight
        return True

    def judge(self, batch: Batch, shape: float) -> None:
        nis = 2.0 * batch.error(_factor(self.closure, self.keys, 1.0))
        self.weight = weight_of(nis, LIMIT, shape)


def close(batch: Batch, closures: Sequence[Closure], key_of: Callable[[int], int]) -> int:
    """Put closures into the problem and solve it, by graduated non-convexity; return how many are contradicted.

    Args:
        batch: the problem.
        closures: between nodes that are there.
        key_of: tells the key of the node at a time.

    Raises:
        RuntimeError: GTSAM failed.
    """
    weighed = [_Weighed(one, (key_of(one.earlier_ns), key_of(one.later_ns))) for one in closures]
    for one in weighed:
        one.enter(batch)
    batch.converge()
    for shape in SHAPES:
        for one in weighed:
            one.judge(batch, shape)
        if sum([one.enter(batch) for one in weighed]):
            batch.converge()
    return sum(one.weight < 0.5 for one in weighed)


def _factor(closure: Closure, keys: tuple[int, int], weight: float) -> gtsam.NonlinearFactor:
    covariance = np.eye(9) * FREE_VARIANCE
    covariance[:6, :6] = closure.covariance / weight
    model = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.BetweenFactorNavState(*keys, gtsam.NavState(closure.T, np.zeros(3)), model)
