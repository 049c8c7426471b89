"""Whether the axes and units of an IMU are those of ROS: what it felt must be how an antenna beside it moved.

A gyroscope in deg/s, an accelerometer that gives gravity in place of specific force, an axis with the wrong sign: each
loses an estimate, and none is seen in the IMU alone. Every mistake is tried on the same stretches of a drive; one that
explains them much better than the readings as they are is what the driver does.
"""

from collections.abc import Iterable, Iterator
from math import inf

import numpy as np

from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2
from holdfast.messages import Array
from holdfast.recording.stretch import GRID_S, Stretch, solve, spread

SPAN_S = 1.0  # over which a change of velocity is taken: slow machines with RTK change theirs by more than its noise
OFFSETS_S = GRID_S[4:-4:2]  # of the receiver's clock; how large it is, is measured elsewhere
MIN_STRETCHES, MAX_STRETCHES = 3, 20  # evenly taken from more
PASSES = 2
EXPLAINED = 3.0  # times what an explanation leaves is the spread of an antenna's changes of velocity
BETTER = 1.4  # times; what is right is explained up to 1.06 times better by a mistake, where it hardly turns


def _mistakes() -> Iterator[tuple[str, Array]]:
    one = np.ones(6)
    yield "the gyroscope gave deg/s", np.repeat([np.pi / 180.0, 1.0], 3)
    yield "the accelerometer gave multiples of g", np.repeat([1.0, STANDARD_GRAVITY_M_S2], 3)
    yield "the accelerometer gave gravity, not specific force: all its signs are wrong", np.repeat([1.0, -1.0], 3)
    yield "all signs of the gyroscope were wrong", np.repeat([-1.0, 1.0], 3)
    yield "its axes were left-handed", -one
    for sensor, first in (("gyroscope", 0), ("accelerometer", 3)):
        for axis, name in enumerate("xyz", first):
            yield f"the {name} axis of the {sensor} had the wrong sign", np.where(np.arange(6) == axis, -1.0, 1.0)


MISTAKES = dict(_mistakes())  # what to multiply the readings (6,) by, so that they are right


def mistake(stretches: Iterable[Stretch]) -> tuple[str, float] | None:
    """Return what explains the stretches better than the readings as they are, and how many times in the median.

    Returns:
        None where nothing does, or where fewer than three stretches hold enough motion.
    """
    compared = list(stretches)
    compared = compared[:: 1 + len(compared) // MAX_STRETCHES]
    return _best(compared, 1) and _best(compared, PASSES)  # what is right hardly ever needs the second


def _best(stretches: Iterable[Stretch], passes: int) -> tuple[str, float] | None:
    compared = (_left(one, passes) for one in stretches)
    left = np.array([left for left, moved in compared if moved > EXPLAINED * left.min()])
    if len(left) < MIN_STRETCHES:
        return None
    better = np.median(left[:, :1] / left[:, 1:], axis=0)
    best = int(better.argmax())
    return (list(MISTAKES)[best], float(better[best])) if better[best] > BETTER else None


def _left(stretch: Stretch, passes: int) -> tuple[Array, float]:
    """Return what the readings as they are, and with each mistake, leave of the changes of velocity, and those."""
    seen = stretch.seen()
    left = np.array([_spread_beside(stretch, seen, scale, passes) for scale in (np.ones(6), *MISTAKES.values())])
    return left, float(spread(seen - np.mean(seen, axis=0)).sum())


def _spread_beside(stretch: Stretch, seen: Array, scale: Array, passes: int) -> float:
    """Return what is left with a mistake, solved again about the biases that were found: they need not be small."""
    bias, left = np.zeros(6), inf
    for _ in range(passes):
        track = stretch.track(scale, bias)
        solutions = solve(stretch.felt(track, OFFSETS_S), seen)
        spreads = spread(solutions.residuals).sum(axis=(1, 2))
        best = int(spreads.argmin())
        bias, left = bias + solutions.biases[best], min(left, float(spreads[best]))
    return left
