"""The motion that the IMU measured between two times, without gravity and without a covariance: (4) in docs/math.md."""

from typing import Any

import numpy as np

from holdfast.kernel.compiling import entry
from holdfast.kernel.layout import STEP, records
from holdfast.kernel.so3 import expmap, multiply, rotate, rotated
from holdfast.kernel.types import FLOATS, INT64, READING, VOID


@entry(VOID, records(STEP), INT64, READING, FLOATS)
def add_up(steps: Any, count: int, bias: tuple[float, ...], out: Any) -> None:
    """Let `out` (15,) be rotation (9,), velocity (3,) and position (3,) in the frame of the start, after all steps.

    Args:
        steps: of `STEP`, in the order of time.
        count: so many of them.
        bias: of specific force [m/s^2] and angular velocity [rad/s].
        out: [1], [m/s] and [m].
    """
    R, turn, product = np.eye(3), np.empty((3, 3)), np.empty((3, 3))
    v, p = np.zeros(3), np.zeros(3)
    for k in range(count):
        step = steps[k]
        dt_s = step.dt_s
        wx, wy, wz = step.rate[0] - bias[3], step.rate[1] - bias[4], step.rate[2] - bias[5]
        fx, fy, fz = step.force[0] - bias[0], step.force[1] - bias[1], step.force[2] - bias[2]
        fx, fy, fz = rotated(0.5 * dt_s * wx, 0.5 * dt_s * wy, 0.5 * dt_s * wz, fx, fy, fz)
        a = rotate(R, fx, fy, fz)
        for i in range(3):
            p[i] += (v[i] + 0.5 * a[i] * dt_s) * dt_s
            v[i] += a[i] * dt_s
        expmap(dt_s * wx, dt_s * wy, dt_s * wz, turn)
        multiply(R, turn, product)
        R[:] = product
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = R[i, j]
        out[9 + i], out[12 + i] = v[i], p[i]
