"""Stretches of a drive in which an IMU and an antenna beside it are compared, by changes of the antenna's velocity.

A stretch of 20 s is solved on its own: the gyroscope gives the attitude up to the first one, which is unknown, as are
both biases and the lever arm (an antenna before the axle makes no offset). What is compared is the change of the
antenna's velocity, so a constant error of the receiver and slow ones of the IMU hardly enter.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2
from holdfast.geometry.rotations import exponentials, skew
from holdfast.messages import Array
from holdfast.recording.inertial_track import InertialTrack

STRETCH_S = 20.0
STEP_S = 0.05
GRID_S: Array = STEP_S * np.arange(-12.0, 13.0)  # offsets of the receiver's clock that are tried
MIN_ROWS = 12
HUBER = 1.5
ITERATIONS = 6
CONVERGED = 1e-5  # rad, and units of the biases and the lever arm
PRIOR_SIGMAS = np.repeat([0.3, 0.02, 3.0], 3)  # accelerometer [m/s^2], gyroscope [rad/s], lever arm [m]
PRIOR = np.diag(np.concatenate([np.full(3, 1e-9), PRIOR_SIGMAS**-2]))  # information; of the attitude nothing


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """What an IMU and an antenna measured in some seconds.

    Attributes:
        imu_s: (N,) stamps, from a little before the antenna's first to a little after its last.
        imu: (N, 6) angular velocity [rad/s] and specific force [m/s^2].
        times_s: (M,) stamps of the receiver.
        values: (M, 3) velocities [m/s] or positions [m] of the antenna in a frame whose z axis is up.
        order: 1 for velocities, 2 for positions.
        stride: rows over which a change is taken.
    """

    imu_s: Array
    imu: Array
    times_s: Array
    values: Array
    order: int
    stride: int

    def seen(self) -> Array:
        """Return the changes (K, 3) of the antenna's velocity, without gravity."""
        seen, spans_s = _changes(self.times_s, self.values, self.order, self.stride)
        seen[:, 2] += STANDARD_GRAVITY_M_S2 * spans_s
        return seen

    def track(self, scale: Array | float = 1.0, bias: Array | float = 0.0) -> InertialTrack:
        """Return what the IMU felt: its readings times `scale` (6,), less a bias (6,)."""
        return InertialTrack(self.imu_s, self.imu * scale - bias)

    def felt(self, track: InertialTrack, offsets_s: Array) -> Array:
        """Return the changes (N, K, 3, 10) of S and H of a track, the receiver's stamps moved by offsets (N,)."""
        values = track.at(self.times_s[:, None] + offsets_s, self.order)
        return _changes(self.times_s, values, self.order, self.stride)[0].swapaxes(0, 1)


def stretches(imu_s: Array, imu: Array, gnss_s: Array, gnss: Array, order: int, *, span_s: float) -> Iterator[Stretch]:
    """Yield the stretches without gaps.

    Args:
        imu_s: (N,) stamps, increasing.
        imu: (N, 6) angular velocity [rad/s] and specific force [m/s^2].
        gnss_s: (M,) stamps on the same scale, increasing.
        gnss: (M, 3) velocities [m/s] or positions [m] of one antenna in a frame whose z axis is up.
        order: 1 for velocities, 2 for positions.
        span_s: over which a change of velocity is taken, or one period of a slower receiver.
    """
    if len(imu_s) < 2 or len(gnss_s) < MIN_ROWS:
        return
    margin = GRID_S[-1] + STEP_S
    period = float(np.median(np.diff(gnss_s)))
    edges = np.arange(max(imu_s[0] + margin, gnss_s[0]), min(imu_s[-1] - margin, gnss_s[-1]) + STEP_S, STRETCH_S)
    for begin, end in pairwise(edges):
        inside = slice(*np.searchsorted(imu_s, [begin - margin, end + margin]))
        rows = slice(*np.searchsorted(gnss_s, [begin, end]))
        if np.diff(imu_s[inside]).max(initial=0.0) > 0.1 or np.diff(gnss_s[rows]).max(initial=0.0) > 3.0 * period:
            continue
        times_s = gnss_s[rows] - begin
        if len(times_s) < 2:
            continue
        stride = max(1, round(span_s / float(np.median(np.diff(times_s)))))
        if len(times_s) - order * stride >= MIN_ROWS:
            yield Stretch(imu_s[inside] - begin, imu[inside], times_s, gnss[rows], order, stride)


def _changes(times_s: Array, values: Array, order: int, stride: int) -> tuple[Array, Array]:
    """Return the changes of velocity (K, ...) over `stride` rows, and how long each took."""
    steps = times_s[stride:] - times_s[:-stride]
    changes = values[stride:] - values[:-stride]
    if order == 1:
        return changes, steps
    changes = changes / steps.reshape(-1, *[1] * (values.ndim - 1))
    return changes[stride:] - changes[:-stride], 0.5 * (times_s[2 * stride :] - times_s[: -2 * stride])


class Solutions(NamedTuple):
    """How well a stretch is explained, in each of N ways.

    Attributes:
        costs: (N,) twice the negative logarithm of a likelihood.
        residuals: (N, K, 3) of the changes of velocity [m/s].
        biases: (N, 6) of gyroscope [rad/s] and accelerometer [m/s^2].
    """

    costs: Array
    residuals: Array
    biases: Array


def solve(felt: Array, seen: Array, scale: Array | None = None) -> Solutions:
    """Fit first attitude, biases and lever arm to changes of velocity by reweighted Gauss-Newton, in N ways at once.

    Args:
        felt: (N, K, 3, 10) changes of S and H.
        seen: (K, 3) changes of velocity in W, without gravity.
        scale: (1, 3) of the residuals; None for that of each iteration.
    """
    U, _, Vt = np.linalg.svd(seen.T @ felt[..., 0])
    U[..., -1] *= np.linalg.det(U @ Vt)[:, None]
    R = U @ Vt
    z = np.zeros((len(felt), len(PRIOR_SIGMAS)))
    moves = np.ones(len(felt), dtype=bool)
    for _ in range(ITERATIONS):
        body, residuals = _explained(felt[moves], seen, R[moves], z[moves])
        sigmas = spread(residuals) if scale is None else scale
        jacobian = R[moves, None] @ np.concatenate([-skew(body), felt[moves, :, :, 1:]], axis=3)
        rows = jacobian.reshape(len(body), -1, 12)
        weights = _weights(residuals, sigmas).reshape(len(body), -1, 1)
        transposed = rows.swapaxes(1, 2)
        right = (transposed @ (weights * residuals.reshape(weights.shape)))[..., 0]
        right[:, 3:] -= z[moves] / PRIOR_SIGMAS**2
        step = np.linalg.solve(transposed @ (rows * weights) + PRIOR, right[..., None])[..., 0]
        R[moves] = R[moves] @ exponentials(step[:, :3])
        z[moves] += step[:, 3:]
        moves[moves] = np.abs(step).max(axis=1) >= CONVERGED
        if not moves.any():
            break
    residuals = _explained(felt, seen, R, z)[1]
    ratios = residuals / (spread(residuals) if scale is None else scale)
    costs = loss(ratios).sum(axis=(1, 2)) + ((z / PRIOR_SIGMAS) ** 2).sum(axis=1)
    return Solutions(costs, residuals, np.concatenate([z[:, 3:6], z[:, :3]], axis=1))


def _explained(felt: Array, seen: Array, R: Array, z: Array) -> tuple[Array, Array]:
    """Return the changes (N, K, 3) of velocity that are explained, in the first body frame, and what is left in W."""
    body = felt[..., 0] + (felt[..., 1:] @ z[:, None, :, None])[..., 0]
    return body, seen - body @ R.swapaxes(1, 2)


def _weights(residuals: Array, sigmas: Array) -> Array:
    result: Array = np.minimum(1.0, HUBER * sigmas / np.maximum(np.abs(residuals), 1e-12)) / sigmas**2
    return result


def spread(residuals: Array) -> Array:
    """Return a robust standard deviation (..., 1, 3) of residuals (..., K, 3)."""
    result: Array = np.percentile(np.abs(residuals), 80.0, axis=-2, keepdims=True) / 1.28 + 1e-4
    return result


def loss(ratios: Array) -> Array:
    """Return Huber's loss, twice over, so that it is the square where it is small."""
    a = np.abs(ratios)
    return np.where(a < HUBER, a**2, 2.0 * HUBER * a - HUBER**2)
