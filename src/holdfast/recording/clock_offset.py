"""How far the clock of a GNSS receiver is from the IMU's, by the accelerations that both see.

Stretches of 20 s are solved on their own, over a grid of offsets: the gyroscope gives the attitude up to the first one,
which is unknown, as are both biases and the lever arm (an antenna before the axle makes no offset). What is compared is
the change of the antenna's velocity, so a constant error of the receiver and slow ones of the IMU hardly enter.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np

from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2
from holdfast.messages import Array
from holdfast.recording.inertial_track import InertialTrack, cross

STRETCH_S = 20.0
SPAN_S = 0.5  # over which a change of velocity is taken, or one period of a slower receiver
STEP_S = 0.05
GRID_S = STEP_S * np.arange(-12, 13)
MIN_ROWS = 12
MIN_STRETCHES = 3
MIN_SIGMA_S = 0.01
STRETCH_SIGMA_S = 0.02  # filters in sensors, flexing mounts: what a stretch errs by beside its residuals
CLEAR_S, CLEAR_SIGMAS = 0.03, 3.0
EXPLAINED = 3.0  # times the cost of the best fit is that of an antenna that never accelerates
HUBER = 1.5
OUTLIER = 8.0  # sigma: a fix that jumped
ITERATIONS = 6
PRIOR_SIGMAS = np.repeat([0.3, 0.02, 3.0], 3)  # accelerometer [m/s^2], gyroscope [rad/s], lever arm [m]


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
    fits = [fit for one in _stretches(imu_s, imu, gnss_s, gnss, order) if (fit := _fit(*one, order))]
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


def _stretches(
    imu_s: Array, imu: Array, gnss_s: Array, gnss: Array, order: int
) -> Iterator[tuple[InertialTrack, Array, Array]]:
    """Yield stretches without gaps: the IMU's track, and stamps and values of the receiver."""
    if len(imu_s) < 2 or len(gnss_s) < MIN_ROWS:
        return
    margin = GRID_S[-1] + STEP_S
    period = float(np.median(np.diff(gnss_s)))
    edges = np.arange(max(imu_s[0] + margin, gnss_s[0]), min(imu_s[-1] - margin, gnss_s[-1]) + STEP_S, STRETCH_S)
    for begin, end in pairwise(edges):
        inside = slice(*np.searchsorted(imu_s, [begin - margin, end + margin]))
        seen = slice(*np.searchsorted(gnss_s, [begin, end]))
        if np.diff(imu_s[inside]).max(initial=0.0) > 0.1 or np.diff(gnss_s[seen]).max(initial=0.0) > 3.0 * period:
            continue
        stride = max(1, round(SPAN_S / period))
        if len(gnss_s[seen]) - order * stride >= MIN_ROWS:
            yield InertialTrack(imu_s[inside] - begin, imu[inside]), gnss_s[seen] - begin, gnss[seen]


def _fit(track: InertialTrack, times_s: Array, values: Array, order: int) -> _Fit | None:
    """Solve one stretch: the parabola at the minimum of its costs; None where it holds too little motion."""
    stride = max(1, round(SPAN_S / float(np.median(np.diff(times_s)))))
    seen, spans = _changes(times_s, values, order, stride)
    seen[:, 2] += STANDARD_GRAVITY_M_S2 * spans
    felt = [_changes(times_s, track.at(times_s + offset, order), order, stride)[0] for offset in GRID_S]
    residuals = min((_solve(one, seen)[1] for one in felt[::2]), key=lambda some: float(_spread(some).sum()))
    scale = _spread(residuals)
    usual = (np.abs(residuals) < OUTLIER * scale).all(axis=1)
    if usual.sum() < MIN_ROWS:
        return None
    seen, felt = seen[usual], [one[usual] for one in felt]
    costs = np.array([_solve(one, seen, scale)[0] for one in felt])
    at_rest = _loss((seen - np.mean(seen, axis=0)) / scale).sum()
    k = int(costs.argmin())
    freedom = seen.size - 3 - len(PRIOR_SIGMAS)
    if not 0 < k < len(costs) - 1 or at_rest < EXPLAINED * max(costs[k], freedom):
        return None
    before, least, after = costs[k - 1 : k + 2]
    curvature = (before - 2.0 * least + after) / STEP_S**2
    overlap = stride * order  # so many changes share a measurement
    variance = 2.0 / curvature * overlap * max(1.0, least / freedom)
    return _Fit(float(GRID_S[k] - (after - before) / (2.0 * STEP_S * curvature)), float(np.sqrt(variance)))


def _changes(times_s: Array, values: Array, order: int, stride: int) -> tuple[Array, Array]:
    """Return the changes of velocity (K, ...) over `stride` rows, and how long each took."""
    steps = times_s[stride:] - times_s[:-stride]
    changes = values[stride:] - values[:-stride]
    if order == 1:
        return changes, steps
    changes = changes / steps.reshape(-1, *[1] * (values.ndim - 1))
    return changes[stride:] - changes[:-stride], 0.5 * (times_s[2 * stride :] - times_s[: -2 * stride])


def _solve(felt: Array, seen: Array, scale: Array | None = None) -> tuple[float, Array]:
    """Fit first attitude, biases and lever arm to changes of velocity by reweighted Gauss-Newton.

    Args:
        felt: (K, 3, 10) changes of S and H.
        seen: (K, 3) changes of velocity in W, without gravity.
        scale: (3,) of the residuals; None for that of each iteration.

    Returns:
        The cost, twice the negative logarithm of a likelihood, and the residuals (K, 3).
    """
    U, _, Vt = np.linalg.svd(seen.T @ felt[:, :, 0])
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt
    z = np.zeros(len(PRIOR_SIGMAS))
    for _ in range(ITERATIONS):
        body = felt[:, :, 0] + felt[:, :, 1:] @ z
        residuals = seen - body @ R.T
        sigmas = _spread(residuals) if scale is None else scale
        jacobian = R @ np.concatenate([-cross(body), felt[:, :, 1:]], axis=2)
        weights = np.minimum(1.0, HUBER * sigmas / np.maximum(np.abs(residuals), 1e-12)) / sigmas**2
        rows = jacobian.reshape(-1, 12)
        normal = rows.T @ (rows * weights.reshape(-1, 1)) + np.diag(np.r_[np.full(3, 1e-9), PRIOR_SIGMAS**-2])
        right = rows.T @ (weights * residuals).ravel() - np.r_[np.zeros(3), z / PRIOR_SIGMAS**2]
        step = np.linalg.solve(normal, right)
        R = R @ gtsam.Rot3.Expmap(step[:3]).matrix()
        z = z + step[3:]
        if np.abs(step).max() < 1e-5:
            break
    residuals = seen - (felt[:, :, 0] + felt[:, :, 1:] @ z) @ R.T
    sigmas = _spread(residuals) if scale is None else scale
    return float(_loss(residuals / sigmas).sum() + ((z / PRIOR_SIGMAS) ** 2).sum()), residuals


def _spread(residuals: Array) -> Array:
    """Return a robust standard deviation (3,) of residuals (K, 3)."""
    result: Array = np.percentile(np.abs(residuals), 80.0, axis=0) / 1.28 + 1e-4
    return result


def _loss(ratios: Array) -> Array:
    """Return Huber's loss, twice over, so that it is the square where it is small."""
    a = np.abs(ratios)
    return np.where(a < HUBER, a**2, 2.0 * HUBER * a - HUBER**2)
