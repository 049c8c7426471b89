"""By how much the clock of GNSS is off, as a batch shows that fits much better where what it measured came later.

An offset that is small beside what is configured the graph finds by itself, from a start that it hardly harms. A large
one looks like biases that have jumped, or like an odometry that lies: (90) in docs/math.md.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from math import sqrt
from typing import NamedTuple

import numpy as np

from holdfast.estimator.fixes_in_motion import MIN_POSITIONS
from holdfast.graph.alignment_problem import Evidence, Point
from holdfast.sensors.sensor import Position

STEP_S, STEPS = 0.15, 4  # in which offsets are looked for, and how many of them
REACH_S = STEP_S * STEPS
LEAST_S = 0.04  # that needs a batch to be found
MOVED = 5.0  # sigmas, by which it is off
REFINED = 2  # times
SAME_S = 1e-3  # nearer, the parabola through two offsets and a third is rounding


class Offset(NamedTuple):
    """Of a clock [s]: positive where its stamps are early; `near_s` is the offset about which it was looked for."""

    by_s: float
    sigma_s: float
    near_s: float = 0.0

    def __str__(self) -> str:
        return f"{abs(self.by_s):.2f} s {'early' if self.by_s > 0.0 else 'late'}"

    @property
    def is_off(self) -> bool:
        """Whether it matters, and is no chance."""
        is_within = abs(self.by_s - self.near_s) < REACH_S
        return is_within and abs(self.by_s) > max(LEAST_S, MOVED * self.sigma_s)


def restamped(evidence: Evidence, sensors: Collection[str], by_s: float) -> Evidence | None:
    """Return the positions and velocities of some sensors as later ones, without motions, within the same time.

    None where fewer than `MIN_POSITIONS` positions are left.
    """
    by_ns = round(by_s * 1e9)

    def later(measured: Sequence[Point], within: Sequence[Position]) -> list[Point]:
        moved = [replace(one, stamp_ns=one.stamp_ns + by_ns * (one.sensor in sensors)) for one in measured]
        return [one for one in moved if within[0].stamp_ns <= one.stamp_ns <= within[-1].stamp_ns]

    positions = later(evidence.positions, evidence.positions)
    if len({one.stamp_ns for one in positions}) < MIN_POSITIONS:
        return None
    return Evidence(positions, later(evidence.velocities, positions))


def kept(evidence: Evidence, moved: Evidence, sensors: Collection[str], by_s: float) -> Evidence:
    """Return the part of evidence that is left when it is restamped, as it was: what is missing may explain all."""
    by_ns = round(by_s * 1e9)

    def before(one: Point) -> int:
        return one.stamp_ns - by_ns * (one.sensor in sensors)

    since_ns, until_ns = before(moved.positions[0]), before(moved.positions[-1])
    return Evidence(
        [one for one in evidence.positions if since_ns <= one.stamp_ns <= until_ns],
        [one for one in evidence.velocities if since_ns <= one.stamp_ns <= until_ns],
    )


def offset_of(misfit: Callable[[float], float], freedom: int, origins_s: Sequence[float] = (0.0,)) -> Offset | None:
    """Return the offset at which what was measured fits best; None if there is none within reach.

    Args:
        misfit: squared residuals over their expectation, given an offset [s]; inf where nothing can be said.
        freedom: how many residuals there are.
        origins_s: offsets about which it is looked for.
    """
    left: dict[float, float] = {}
    for origin_s in origins_s:
        left[origin_s] = misfit(origin_s)
        for side in (STEP_S, -STEP_S):
            before_s = origin_s
            for steps in range(1, STEPS + 1):
                by_s = origin_s + steps * side
                left[by_s] = misfit(by_s)
                if left[by_s] >= left[before_s]:
                    break
                before_s = by_s
    curvature = 0.0
    for _ in range(REFINED):
        best = min(left, key=left.__getitem__)
        near = sorted(left, key=lambda at: abs(at - best))[:3]
        values = [left[at] for at in near]
        if len(near) < 3 or not np.isfinite(values).all():
            return None
        curvature, slope, _ = np.polyfit(near, values, 2)
        if curvature <= 0.0:
            return None
        lowest = -0.5 * slope / curvature
        if min(abs(at - lowest) for at in left) < SAME_S:
            break
        left[lowest] = misfit(lowest)
    best = min(left, key=left.__getitem__)
    sigma_s = sqrt(max(left[best], 1.0) / (curvature * freedom))
    return Offset(best, sigma_s, min(origins_s, key=lambda origin_s: abs(best - origin_s)))
