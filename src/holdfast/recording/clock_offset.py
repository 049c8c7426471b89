"""How far the clock of a GNSS receiver is from the IMU's, by the accelerations that both see.

Stretches of 20 s are solved on their own (see `stretch`), over a grid of offsets.
"""

from dataclasses import dataclass

import numpy as np

from holdfast.messages import Array
from holdfast.recording.stretch import (
    GRID_S,
    MIN_ROWS,
    PRIOR_SIGMAS,
    STEP_S,
    STRETCH_S,
    Stretch,
    loss,
    solve,
    spread,
    stretches,
)

SPAN_S = 0.5  # over which a change of velocity is taken, or one period of a slower receiver
MIN_STRETCHES = 3
MIN_SIGMA_S = 0.01
STRETCH_SIGMA_S = 0.02  # filters in sensors, flexing mounts: what a stretch errs by beside its residuals
CLEAR_S, CLEAR_SIGMAS = 0.03, 3.0
EXPLAINED = 3.0  # times the cost of the best fit is that of an antenna that never accelerates
OUTLIER = 8.0  # sigma: a fix that jumped


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """An offset to be added to a receiver's stamps.

    Attributes:
        offset_s: positive where the receiver's stamps are early.
        sigma_s: standard deviation, at least 10 ms.
        stretches: on which it rests.
    """

    offset_s: float
    sigma_s: float
    stretches: int

    def is_clear(self) -> bool:
        """Whether it is worth correcting."""
        return abs(self.offset_s) > max(CLEAR_S, CLEAR_SIGMAS * self.sigma_s)

    def __str__(self) -> str:
        """Return it in words."""
        seen = f"the accelerations in {self.stretches} stretches of {STRETCH_S:.0f} s"
        return f"{self.offset_s:+.3f} +- {self.sigma_s:.3f} s, from {seen}"


@dataclass(frozen=True, slots=True)
class _Fit:
    """The offset of one stretch, sigma by the curvature of its costs and its residuals."""

    offset_s: float
    sigma_s: float


def clock_offset(imu_s: Array, imu: Array, gnss_s: Array, gnss: Array, order: int) -> ClockOffset | None:
    """Measure the offset to be added to the stamps of a receiver.

    Args:
        imu_s: (N,) stamps, increasing.
        imu: (N, 6) angular velocity [rad/s] and specific force [m/s^2].
        gnss_s: (M,) stamps on the same scale, increasing.
        gnss: (M, 3) velocities [m/s] or positions [m] of one antenna in a frame whose z axis is up.
        order: 1 for velocities, 2 for positions.

    Returns:
        None where fewer than three stretches hold enough motion.
    """
    fits = [fit for one in stretches(imu_s, imu, gnss_s, gnss, order, span_s=SPAN_S) if (fit := _fit(one))]
    if len(fits) < MIN_STRETCHES:
        return None
    offsets = np.array([fit.offset_s for fit in fits])
    variances = np.array([fit.sigma_s**2 for fit in fits]) + STRETCH_SIGMA_S**2
    return _combined(offsets, variances)


def pooled(one: ClockOffset | None, other: ClockOffset | None) -> tuple[ClockOffset | None, ClockOffset | None]:
    """Return two measurements of one clock: as they are if they contradict each other, else both their mean."""
    if one is None or other is None:
        return one or other, other or one
    weights = np.array([one.sigma_s, other.sigma_s]) ** -2.0
    if abs(one.offset_s - other.offset_s) > 2.0 * np.hypot(one.sigma_s, other.sigma_s):
        return one, other
    offset_s = float(weights @ [one.offset_s, other.offset_s] / weights.sum())
    mean = ClockOffset(offset_s, max(MIN_SIGMA_S, float(weights.sum() ** -0.5)), one.stretches + other.stretches)
    return mean, mean


def _combined(offsets: Array, variances: Array) -> ClockOffset:
    """Return the mean of independent offsets, their scatter beyond the variances added (DerSimonian-Laird)."""
    w = 1.0 / variances
    excess = w @ (offsets - w @ offsets / w.sum()) ** 2 - (len(w) - 1)
    w = 1.0 / (variances + max(0.0, excess) / (w.sum() - (w @ w) / w.sum()))
    return ClockOffset(float(w @ offsets / w.sum()), max(MIN_SIGMA_S, float(w.sum() ** -0.5)), len(offsets))


def _fit(stretch: Stretch) -> _Fit | None:
    """Solve one stretch: the parabola at the minimum of its costs; None where it holds too little motion."""
    seen, track = stretch.seen(), stretch.track()
    felt = stretch.felt(track, GRID_S)
    tried = solve(felt[::2], seen).residuals
    residuals = tried[spread(tried).sum(axis=(1, 2)).argmin()]
    scale = spread(residuals)
    usual = (np.abs(residuals) < OUTLIER * scale).all(axis=1)
    if usual.sum() < MIN_ROWS:
        return None
    seen = seen[usual]
    costs = solve(felt[:, usual], seen, scale).costs
    at_rest = loss((seen - np.mean(seen, axis=0)) / scale).sum()
    k = int(costs.argmin())
    freedom = seen.size - 3 - len(PRIOR_SIGMAS)
    if not 0 < k < len(costs) - 1 or at_rest < EXPLAINED * max(costs[k], freedom):
        return None
    before, least, after = costs[k - 1 : k + 2]
    curvature = (before - 2.0 * least + after) / STEP_S**2
    overlap = stretch.stride * stretch.order  # so many changes share a measurement
    variance = 2.0 / curvature * overlap * max(1.0, least / freedom)
    return _Fit(float(GRID_S[k] - (after - before) / (2.0 * STEP_S * curvature)), float(np.sqrt(variance)))
