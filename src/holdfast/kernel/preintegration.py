"""Preintegration on the tangent space, prediction, and the covariance of both, as GTSAM has them.

Forster et al. 2017 with the rotation vector, position and velocity as a vector of 9; (4) to (8) in docs/math.md. In
contrast to GTSAM's, the specific force is turned to the middle of its step here.
"""

from typing import Any

from holdfast.kernel.compiling import inner
from holdfast.kernel.so3 import coefficients, multiply, polynomial, rotate, rotated
from holdfast.messages import Array


@inner
def reset(pim: Any) -> None:
    """Begin a `PREINTEGRATED` with nothing in it."""
    pim.dt_s = 0.0
    pim.theta[:], pim.p[:], pim.v[:] = 0.0, 0.0, 0.0
    pim.covariance[:, :], pim.by_bias[:, :] = 0.0, 0.0


@inner
def integrate(
    pim: Any, work: Any, noise: Array, dt_s: float, fx: float, fy: float, fz: float, wx: float, wy: float, wz: float
) -> None:
    """Add a step to a `PREINTEGRATED`: (4) and (7).

    Args:
        pim: what the step is added to.
        work: a `WORK`.
        noise: (3,) variance densities: accelerometer [m^2/s^3], gyroscope [rad^2/s], integration of position [m^2/s].
        dt_s: length of the step.
        fx: specific force, mean over the step, bias removed [m/s^2]; `fy`, `fz`.
        wx: angular velocity, mean over the step, bias removed [rad/s]; `wy`, `wz`.
    """
    theta, half_s, half_s2 = pim.theta, 0.5 * dt_s, 0.5 * dt_s * dt_s
    fx, fy, fz = rotated(half_s * wx, half_s * wy, half_s * wz, fx, fy, fz)
    tx, ty, tz = theta[0], theta[1], theta[2]
    a, b, c, d, e, f = coefficients(tx * tx + ty * ty + tz * tz)
    R, right, inverse, turning = work.R, work.right, work.inverse, work.half
    polynomial(theta, a, b, R)
    polynomial(theta, -b, c, right)  # the right Jacobian
    polynomial(theta, 0.5, d, inverse)  # and its inverse
    ux, uy, uz = rotate(inverse, wx, wy, wz)  # rate of theta
    _differentiate(theta, (ux, uy, uz), (b, c, e, f), turning)
    ax, ay, az = rotate(R, fx, fy, fz)
    # derivatives of the rate of theta, -inverse turning, and of the force, -R [f] right, with respect to theta
    multiply(inverse, turning, work.by_theta_rate)
    work.skew[0, 1], work.skew[0, 2], work.skew[1, 2] = fz, -fy, fx
    work.skew[1, 0], work.skew[2, 0], work.skew[2, 1] = -fz, fy, -fx
    multiply(work.skew, right, turning)
    multiply(R, turning, work.by_theta_force)
    for i in range(3):
        pim.p[i] += pim.v[i] * dt_s
    theta[0], theta[1], theta[2] = tx + ux * dt_s, ty + uy * dt_s, tz + uz * dt_s
    pim.p[0], pim.p[1], pim.p[2] = pim.p[0] + ax * half_s2, pim.p[1] + ay * half_s2, pim.p[2] + az * half_s2
    pim.v[0], pim.v[1], pim.v[2] = pim.v[0] + ax * dt_s, pim.v[1] + ay * dt_s, pim.v[2] + az * dt_s
    pim.dt_s += dt_s
    _propagate(pim, work, noise, dt_s)


@inner
def _differentiate(
    theta: Array, u: tuple[float, float, float], of: tuple[float, float, float, float], out: Array
) -> None:
    """Let `out` (3, 3) be the derivative of the right Jacobian at theta, times u, with respect to theta."""
    b, c, e, f = of
    x, y, z = theta[0], theta[1], theta[2]
    p, q, r = y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]
    across = (f * (y * r - z * q) - e * p, f * (z * p - x * r) - e * q, f * (x * q - y * p) - e * r)
    along = c * (x * u[0] + y * u[1] + z * u[2])
    for i in range(3):
        for j in range(3):
            out[i, j] = (across[i] - 2.0 * c * u[i]) * theta[j] + c * theta[i] * u[j]
        out[i, i] += along
    out[0, 1] -= b * u[2]
    out[0, 2] += b * u[1]
    out[1, 0] += b * u[2]
    out[1, 2] -= b * u[0]
    out[2, 0] -= b * u[1]
    out[2, 1] += b * u[0]


@inner
def _propagate(pim: Any, work: Any, noise: Array, dt_s: float) -> None:
    """Carry covariance and derivative by the bias of a `PREINTEGRATED` over a step whose Jacobians are in `work`."""
    covariance, by_bias, half_s2 = pim.covariance, pim.by_bias, 0.5 * dt_s * dt_s
    _premultiply(covariance, work, dt_s, 9)
    for i in range(9):
        for j in range(i):
            covariance[i, j], covariance[j, i] = covariance[j, i], covariance[i, j]
    _premultiply(covariance, work, dt_s, 9)
    _premultiply(by_bias, work, dt_s, 6)
    R, inverse = work.R, work.inverse
    for i in range(3):
        for j in range(3):
            by_bias[i, 3 + j] -= inverse[i, j] * dt_s
            by_bias[3 + i, j] -= R[i, j] * half_s2
            by_bias[6 + i, j] -= R[i, j] * dt_s
            both = inverse[i, 0] * inverse[j, 0] + inverse[i, 1] * inverse[j, 1] + inverse[i, 2] * inverse[j, 2]
            covariance[i, j] += both * noise[1] * dt_s
        covariance[3 + i, 3 + i] += noise[0] * half_s2 * half_s2 / dt_s + noise[2] * dt_s
        covariance[3 + i, 6 + i] += noise[0] * half_s2
        covariance[6 + i, 3 + i] += noise[0] * half_s2
        covariance[6 + i, 6 + i] += noise[0] * dt_s


@inner
def _premultiply(M: Array, work: Any, dt_s: float, columns: int) -> None:
    """Let M (9, columns) be A M, with A how rotation vector, position and velocity depend on those before a step."""
    half_s2 = 0.5 * dt_s * dt_s
    by_rate, by_force = work.by_theta_rate, work.by_theta_force
    for j in range(columns):
        x, y, z = M[0, j], M[1, j], M[2, j]
        for i in range(3):
            force = by_force[i, 0] * x + by_force[i, 1] * y + by_force[i, 2] * z
            M[3 + i, j] += dt_s * M[6 + i, j] + half_s2 * force
            M[6 + i, j] += dt_s * force
            M[i, j] -= dt_s * (by_rate[i, 0] * x + by_rate[i, 1] * y + by_rate[i, 2] * z)


@inner
def predict(pim: Any, work: Any, start: Any, gravity: float, out: Any) -> None:
    """Let `out` be the `NAV` that a `PREINTEGRATED` leads to from a `NAV`, with its own bias: (5)."""
    theta, p, v, R, dt_s = pim.theta, pim.p, pim.v, start.R, pim.dt_s
    a, b, _, _, _, _ = coefficients(theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2])
    polynomial(theta, a, b, work.R)
    multiply(R, work.R, out.R)
    for i in range(3):
        out.p[i] = start.p[i] + start.v[i] * dt_s + (R[i, 0] * p[0] + R[i, 1] * p[1] + R[i, 2] * p[2])
        out.v[i] = start.v[i] + (R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2])
    out.p[2] -= 0.5 * gravity * dt_s * dt_s
    out.v[2] -= gravity * dt_s


@inner
def predict_covariance(pim: Any, work: Any, P: Array, out: Array) -> None:
    """Let `out` (9, 9) be the covariance of what `predict` gives, F P F^T and that of the samples: (8).

    Leaves in `work.cross` (9, 6) the covariance of that state with the biases.

    Args:
        pim: a `PREINTEGRATED`.
        work: a `WORK`.
        P: (15, 15) covariance of state and biases before.
        out: what it becomes.
    """
    theta, T = pim.theta, work.T
    a, b, c, _, _, _ = coefficients(theta[0] * theta[0] + theta[1] * theta[1] + theta[2] * theta[2])
    polynomial(theta, a, b, work.R)
    polynomial(theta, b, c, work.left)  # the left Jacobian
    _shift(pim, work, P)
    _shift_back(pim, work, out)
    left, samples = work.left, pim.covariance
    for i in range(9):  # of the samples, theta seen in the frame of the start
        for j in range(i, 9):
            if i >= 3:
                out[i, j] += samples[i, j]
            elif j >= 3:
                out[i, j] += left[i, 0] * samples[0, j] + left[i, 1] * samples[1, j] + left[i, 2] * samples[2, j]
            else:
                for k in range(3):
                    across = samples[k, 0] * left[j, 0] + samples[k, 1] * left[j, 1] + samples[k, 2] * left[j, 2]
                    out[i, j] += left[i, k] * across
    for i in range(0, 9, 3):
        for j in range(i, 9, 3):
            if i == j:
                out[i + 1, i], out[i + 2, i], out[i + 2, i + 1] = out[i, i + 1], out[i, i + 2], out[i + 1, i + 2]
            _unrotate_block(work, out, i, j)
    for i in range(9):
        for j in range(i):
            out[i, j] = out[j, i]
    R = work.R
    for i in range(0, 9, 3):
        for j in range(6):
            x, y, z = T[i, 9 + j], T[i + 1, 9 + j], T[i + 2, 9 + j]
            for k in range(3):
                work.cross[i + k, j] = R[0, k] * x + R[1, k] * y + R[2, k] * z


@inner
def _shift(pim: Any, work: Any, P: Array) -> None:
    """Let `work.T` (9, 15) be G P with F = diag(R, R, R)^T G, and `work.B` (6, 9) that of the biases, transposed."""
    T, B, left, p, v, dt_s = work.T, work.B, work.left, pim.p, pim.v, pim.dt_s
    for k in range(6):
        x, y, z = pim.by_bias[0, k], pim.by_bias[1, k], pim.by_bias[2, k]
        for i in range(3):
            B[k, i] = left[i, 0] * x + left[i, 1] * y + left[i, 2] * z
            B[k, 3 + i], B[k, 6 + i] = pim.by_bias[3 + i, k], pim.by_bias[6 + i, k]
    for j in range(15):
        x, y, z = P[0, j], P[1, j], P[2, j]
        T[0, j], T[1, j], T[2, j] = x, y, z
        T[3, j] = P[3, j] + dt_s * P[6, j] - (p[1] * z - p[2] * y)
        T[4, j] = P[4, j] + dt_s * P[7, j] - (p[2] * x - p[0] * z)
        T[5, j] = P[5, j] + dt_s * P[8, j] - (p[0] * y - p[1] * x)
        T[6, j] = P[6, j] - (v[1] * z - v[2] * y)
        T[7, j] = P[7, j] - (v[2] * x - v[0] * z)
        T[8, j] = P[8, j] - (v[0] * y - v[1] * x)
    for i in range(9):
        for k in range(6):
            by = B[k, i]
            for j in range(15):
                T[i, j] += by * P[9 + k, j]


@inner
def _shift_back(pim: Any, work: Any, out: Array) -> None:
    """Let the upper triangle of `out` (9, 9) be that of T G^T."""
    T, B, p, v, dt_s = work.T, work.B, pim.p, pim.v, pim.dt_s
    for i in range(9):
        x, y, z = T[i, 0], T[i, 1], T[i, 2]
        out[i, 0], out[i, 1], out[i, 2] = x, y, z
        out[i, 3] = T[i, 3] + dt_s * T[i, 6] - (p[1] * z - p[2] * y)
        out[i, 4] = T[i, 4] + dt_s * T[i, 7] - (p[2] * x - p[0] * z)
        out[i, 5] = T[i, 5] + dt_s * T[i, 8] - (p[0] * y - p[1] * x)
        out[i, 6] = T[i, 6] - (v[1] * z - v[2] * y)
        out[i, 7] = T[i, 7] - (v[2] * x - v[0] * z)
        out[i, 8] = T[i, 8] - (v[0] * y - v[1] * x)
        for k in range(6):
            by = T[i, 9 + k]
            for j in range(9):
                out[i, j] += by * B[k, j]


@inner
def _unrotate_block(work: Any, M: Array, i: int, j: int) -> None:
    """Let the block (3, 3) of M at a row and a column become R^T M R."""
    R, half = work.R, work.half
    for k in range(3):
        x, y, z = M[i, j + k], M[i + 1, j + k], M[i + 2, j + k]
        for m in range(3):
            half[m, k] = R[0, m] * x + R[1, m] * y + R[2, m] * z
    for m in range(3):
        x, y, z = half[m, 0], half[m, 1], half[m, 2]
        for k in range(3):
            M[i + m, j + k] = x * R[0, k] + y * R[1, k] + z * R[2, k]
