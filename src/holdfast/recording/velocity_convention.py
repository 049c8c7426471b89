"""Whether a receiver's velocity is east, north, up in m/s: it must be how the fixes of the same receiver move."""

from collections.abc import Callable

import numpy as np

from holdfast.messages import Array

SPAN_S = 2.0  # over which fixes are differenced
MIN_SPEED_M_S = 1.0
MIN_ROWS = 20
BETTER = 2.0  # times
KNOT_M_S = 1852.0 / 3600.0

# what is left of horizontal velocities (K, 2) by the fixes beside those of the messages, with each mistake
MISTAKES: dict[str, Callable[[Array, Array], Array]] = {
    "it were north, east (NED), not east, north (ENU)": lambda told, seen: told[:, ::-1] - seen,
    "it were in km/h": lambda told, seen: told / 3.6 - seen,
    "it were in knots": lambda told, seen: told * KNOT_M_S - seen,
    "it were along the axes of the vehicle, not east, north": lambda told, seen: told - _forward(seen),
    "its signs were wrong": lambda told, seen: -told - seen,
}


def mistake(fix_s: Array, positions: Array, velocity_s: Array, velocities: Array) -> tuple[str, float] | None:
    """Return what explains velocities better than that they are what they should be, and how many times better.

    Args:
        fix_s: (M,) stamps of the fixes, increasing.
        positions: (M, 3) in a local east, north, up frame [m].
        velocity_s: (N,) stamps of the velocities, increasing.
        velocities: (N, 3), as the messages hold them.

    Returns:
        None where nothing does, or where the receiver hardly moved.
    """
    if len(fix_s) < MIN_ROWS or len(velocity_s) < MIN_ROWS:
        return None
    stride = max(1, round(SPAN_S / float(np.median(np.diff(fix_s)))))
    begin, end = fix_s[:-stride], fix_s[stride:]
    seen = (positions[stride:, :2] - positions[:-stride, :2]) / (end - begin)[:, None]
    way = np.concatenate([np.zeros((1, 2)), np.cumsum(_means(velocities) * np.diff(velocity_s)[:, None], axis=0)])
    driven = [np.interp(end, velocity_s, one) - np.interp(begin, velocity_s, one) for one in way.T]
    told = np.stack(driven, axis=1) / (end - begin)[:, None]
    usual = (end - begin < 2.0 * SPAN_S) & (begin >= velocity_s[0]) & (end <= velocity_s[-1])
    moves = usual & (np.linalg.norm(seen, axis=1) > MIN_SPEED_M_S)
    if moves.sum() < MIN_ROWS:
        return None
    told, seen = told[moves], seen[moves]
    left = {why: _left(residuals(told, seen)) for why, residuals in MISTAKES.items()}
    best = min(left, key=lambda why: left[why])
    times = _left(told - seen) / max(left[best], 1e-6)
    return (best, times) if times > BETTER else None


def _means(values: Array) -> Array:
    result: Array = 0.5 * (values[1:, :2] + values[:-1, :2])
    return result


def _forward(velocities: Array) -> Array:
    """Return velocities (K, 2) as the vehicle has them that drives forward: its speed, and nothing across."""
    return np.stack([np.linalg.norm(velocities, axis=1), np.zeros(len(velocities))], axis=1)


def _left(residuals: Array) -> float:
    return float(np.median(np.linalg.norm(residuals, axis=1)))
