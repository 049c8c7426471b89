"""The heading that two antennas show where no receiver says it: their positions of one time, beside the estimate."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from holdfast.events import Outcome
from holdfast.graph.smoother import Smoother
from holdfast.integrity.lever_arms import PAIRED_NS, are_the_same
from holdfast.integrity.residual import residual
from holdfast.integrity.yaw_learning import WITNESS_NS, Witness
from holdfast.sensors.sensor import Position, PositionSensor

LEAST_BASELINE_M = 0.3  # in the horizon


def witness_of(
    sensors: Mapping[str, PositionSensor], used: Sequence[Position], smoother: Smoother, stamp_ns: int
) -> Witness | None:
    """Return what pairs of positions near a time say of the heading of an estimate; None where there are none.

    Args:
        sensors: the receivers, by name.
        used: positions in the window.
        smoother: whose estimate it is.
        stamp_ns: the time.
    """
    near = [one for one in used if abs(one.stamp_ns - stamp_ns) <= WITNESS_NS and smoother.has_node(one.stamp_ns)]
    beyond_rad, variances = [], []
    for one, other in combinations(near, 2):
        if one.sensor == other.sensor or abs(one.stamp_ns - other.stamp_ns) > PAIRED_NS:
            continue
        if are_the_same(one, other):
            continue
        here, there = (residual(sensors[at.sensor], at, smoother) for at in (one, other))
        if isinstance(here, Outcome) or isinstance(there, Outcome):
            continue
        attitude = smoother.nav(one.stamp_ns).attitude()
        x, y, _ = attitude.rotate(sensors[other.sensor].p_I_P - sensors[one.sensor].p_I_P)
        squared = x * x + y * y
        if squared < LEAST_BASELINE_M**2:
            continue
        across = np.array([-y, x, 0.0]) / squared
        beyond_rad.append(float(across @ (there.y - here.y)))
        variances.append(float(across @ (one.covariance + other.covariance) @ across))
    return Witness.of(beyond_rad, variances)
