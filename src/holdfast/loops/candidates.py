"""Which pairs of times may see the same place: near by the estimate, apart in time, and known badly enough to gain."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation import quaternions
from holdfast.messages import Array

KEYFRAME_S = 2.0  # between two of them
APART_S = 15.0  # odometry knows better what is closer in time
NEAR_M = 6.0  # at which two submaps see the same, in spite of what hides it
SIGMAS = 3.0  # by which the estimate may be wrong
FARTHEST_M = 15.0
HEADING_RAD = 2.1  # further turned, a machine hides from its lidar what it saw before
GAIN_SIGMA_M = 0.015  # a registration is not better: who is known so well gains nothing
PER_KEYFRAME = 2
MAX_PAIRS = 150


class Keyframe(NamedTuple):
    """A time of the track: its row, position (3,) [m], quaternion (4,), and sigma of the horizontal position [m]."""

    row: int
    time_ns: int
    position: Array
    quaternion: Array
    sigma_m: float


class Pair(NamedTuple):
    """An earlier and a later time at which the same place may be seen."""

    earlier: Keyframe
    later: Keyframe


def keyframes_of(times_ns: NDArray[np.int64], positions: Array, attitudes: Array, covariances: Array) -> list[Keyframe]:
    """Return one of some nodes (N,) every two seconds; covariances (N, 9, 9) are in their own axes."""
    seconds = (times_ns - times_ns[0]) * 1e-9
    _, rows = np.unique(np.floor(seconds / KEYFRAME_S), return_index=True)
    sigmas = np.sqrt(np.trace(covariances[rows, 3:6, 3:6], axis1=1, axis2=2) / 3.0)
    return [
        Keyframe(row, int(times_ns[row]), positions[row], attitudes[row], float(sigma))
        for row, sigma in zip(rows.tolist(), sigmas, strict=True)
    ]


def candidates(keyframes: list[Keyframe], after_ns: int) -> list[Pair]:
    """Return the pairs worth a registration: for each keyframe after a time those near it that are known best."""
    found: list[tuple[float, Pair]] = []
    for late, later in enumerate(keyframes):
        if later.time_ns <= after_ns:
            continue
        near = [
            (earlier.sigma_m + 0.01 * distance_m, Pair(earlier, later))
            for earlier in keyframes[:late]
            if (distance_m := _distance(earlier, later)) is not None
        ]
        near.sort(key=lambda one: one[0])
        for _, pair in _spread(near):
            gain = max(pair.earlier.sigma_m, later.sigma_m)
            found.append((-gain, pair))
    found.sort(key=lambda one: (one[0], one[1].later.time_ns, one[1].earlier.time_ns))
    return sorted((pair for _, pair in found[:MAX_PAIRS]), key=lambda pair: (pair.later.time_ns, pair.earlier.time_ns))


def _distance(earlier: Keyframe, later: Keyframe) -> float | None:
    """Return the distance of two keyframes [m] if they may see the same place and a registration would tell news."""
    if later.time_ns - earlier.time_ns < APART_S * 1e9:
        return None
    if max(earlier.sigma_m, later.sigma_m) < GAIN_SIGMA_M:
        return None
    distance_m = float(np.linalg.norm(earlier.position - later.position))
    radius_m = min(NEAR_M + SIGMAS * float(np.hypot(earlier.sigma_m, later.sigma_m)), FARTHEST_M)
    if distance_m > radius_m:
        return None
    turned = quaternions.multiply(quaternions.conjugate(earlier.quaternion[None]), later.quaternion[None])
    return distance_m if float(quaternions.angle_rad(turned)[0]) < HEADING_RAD else None


def _spread(near: list[tuple[float, Pair]]) -> list[tuple[float, Pair]]:
    """Return the best, none within `APART_S` of one that is taken: neighbours say the same."""
    taken: list[tuple[float, Pair]] = []
    for one in near:
        times = [other.earlier.time_ns for _, other in taken]
        if all(abs(one[1].earlier.time_ns - time) > APART_S * 1e9 for time in times):
            taken.append(one)
        if len(taken) == PER_KEYFRAME:
            break
    return taken
