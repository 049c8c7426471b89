"""Stretches of a drive in which an IMU and an antenna beside it are compared, by changes of the antenna's velocity.

A stretch of 20 s is solved on its own: the gyroscope gives the attitude up to the first one, which is unknown, as are
both biases and the lever arm (an antenna before the axle makes no offset). What is compared is the change of the
antenna's velocity, so a constant error of the receiver and slow ones of the IMU hardly enter.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.geometry.earth import STANDARD_GRAVITY_M_S2
from holdfast.messages import Array
from holdfast.recording.inertial_track import InertialTrack, cross

STRETCH_S = 20.0
STEP_S = 0.05
GRID_S = STEP_S * np.arange(-12, 13)  # offsets of the receiver's clock that are tried
MIN_ROWS = 12
HUBER = 1.5
ITERATIONS = 6
PRIOR_SIGMAS = np.repeat([0.3, 0.02, 3.0], 3)  # accelerometer [m/s^2], gyroscope [rad/s], lever arm [m]


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

    def felt(self, track: InertialTrack, offset_s: float) -> Array:
        """Return the changes (K, 3, 10) of S and H of a track, the receiver's stamps moved by an offset."""
        return _changes(self.times_s, track.at(self.times_s + offset_s, self.order), self.order, self.stride)[0]


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


class Solution(NamedTuple):
    """How well a stretch is explained.

    Attributes:
        cost: twice the negative logarithm of a likelihood.
        residuals: (K, 3) of the changes of velocity [m/s].
        bias: (6,) of gyroscope [rad/s] and accelerometer [m/s^2].
    """

    cost: float
    residuals: Array
    bias: Array


def solve(felt: Array, seen: Array, scale: Array | None = None) -> Solution:
    """Fit first attitude, biases and lever arm to changes of velocity by reweighted Gauss-Newton.

    Args:
        felt: (K, 3, 10) changes of S and H.
        seen: (K, 3) changes of velocity in W, without gravity.
        scale: (3,) of the residuals; None for that of each iteration.
    """
    U, _, Vt = np.linalg.svd(seen.T @ felt[:, :, 0])
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt
    z = np.zeros(len(PRIOR_SIGMAS))
    for _ in range(ITERATIONS):
        body = felt[:, :, 0] + felt[:, :, 1:] @ z
        residuals = seen - body @ R.T
        sigmas = spread(residuals) if scale is None else scale
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
    sigmas = spread(residuals) if scale is None else scale
    cost = float(loss(residuals / sigmas).sum() + ((z / PRIOR_SIGMAS) ** 2).sum())
    return Solution(cost, residuals, np.r_[z[3:6], z[:3]])


def spread(residuals: Array) -> Array:
    """Return a robust standard deviation (3,) of residuals (K, 3)."""
    result: Array = np.percentile(np.abs(residuals), 80.0, axis=0) / 1.28 + 1e-4
    return result


def loss(ratios: Array) -> Array:
    """Return Huber's loss, twice over, so that it is the square where it is small."""
    a = np.abs(ratios)
    return np.where(a < HUBER, a**2, 2.0 * HUBER * a - HUBER**2)
