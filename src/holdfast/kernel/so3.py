"""The rotation group: exponential map, its Jacobians and their derivative, as GTSAM's `so3::DexpFunctor` has them.

With x = |theta|^2 all are polynomials in [theta]: Forster et al. 2017, Eqs. 3, 8 and 9.
"""

from math import cos, sin, sqrt

from holdfast.kernel.compiling import inner
from holdfast.messages import Array

Vector = Array | tuple[float, float, float]

SMALL = 1e-4  # squared angle below which the series are exact to the last bit


@inner
def coefficients(x: float) -> tuple[float, float, float, float, float, float]:
    """Return A to F of a squared angle.

    A = sin t / t, B = (1 - cos t) / t^2, C = (1 - A) / t^2, D = (1 - A / 2B) / t^2, and the derivatives of B and C with
    respect to t over t, E = (A - 2B) / t^2 and F = (B - 3C) / t^2.
    """
    if x < SMALL:
        return (
            1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0)),
            0.5 - x / 24.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0)),
            1.0 / 6.0 - x / 120.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0)),
            1.0 / 12.0 + x / 720.0 * (1.0 + x / 42.0 * (1.0 + x / 40.0)),
            -1.0 / 12.0 + x / 180.0 * (1.0 - x * 180.0 / 6720.0 * (1.0 - x * 6720.0 / 453600.0)),
            -1.0 / 60.0 + x / 1260.0 * (1.0 - x * 1260.0 / 60480.0 * (1.0 - x * 60480.0 / 4989600.0)),
        )
    angle = sqrt(x)
    half = sin(0.5 * angle)
    a, b = sin(angle) / angle, 2.0 * half * half / x
    c = (1.0 - a) / x
    # A / 2B = (t / 2) / tan(t / 2)
    d = (1.0 - 0.5 * angle * cos(0.5 * angle) / half) / x
    return a, b, c, d, (a - 2.0 * b) / x, (b - 3.0 * c) / x


@inner
def polynomial(theta: Vector, a: float, b: float, out: Array) -> None:
    """Let `out` (3, 3) be I + a [theta] + b [theta]^2."""
    x, y, z = theta[0], theta[1], theta[2]
    square = x * x + y * y + z * z
    for i in range(3):
        for j in range(3):
            out[i, j] = b * theta[i] * theta[j]
        out[i, i] += 1.0 - b * square
    out[0, 1] -= a * z
    out[0, 2] += a * y
    out[1, 0] += a * z
    out[1, 2] -= a * x
    out[2, 0] -= a * y
    out[2, 1] += a * x


@inner
def expmap(x: float, y: float, z: float, out: Array) -> None:
    """Let `out` (3, 3) be Exp of a rotation vector [rad]."""
    a, b, _, _, _, _ = coefficients(x * x + y * y + z * z)
    polynomial((x, y, z), a, b, out)


@inner
def rotated(x: float, y: float, z: float, u: float, v: float, w: float) -> tuple[float, float, float]:
    """Return Exp(x, y, z) (u, v, w)."""
    a, b, _, _, _, _ = coefficients(x * x + y * y + z * z)
    p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
    return (
        u + a * p + b * (y * r - z * q),
        v + a * q + b * (z * p - x * r),
        w + a * r + b * (x * q - y * p),
    )


@inner
def multiply(a: Array, b: Array, out: Array) -> None:
    """Let `out` (3, 3) be a b."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@inner
def rotate(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return R (x, y, z)."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@inner
def unrotate(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return R^T (x, y, z)."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@inner
def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Return a rotation as a unit quaternion x, y, z, w with w >= 0, by the largest of the four: Shepperd 1978."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace >= max(R[0, 0], R[1, 1], R[2, 2]):
        x, y, z, w = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1.0 + trace
    else:
        i = 0
        if R[1, 1] > R[i, i]:
            i = 1
        if R[2, 2] > R[i, i]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        s, u, v = 1.0 + R[i, i] - R[j, j] - R[k, k], R[i, j] + R[j, i], R[i, k] + R[k, i]
        x, y, z = (s, u, v) if i == 0 else ((v, s, u) if i == 1 else (u, v, s))
        w = R[k, j] - R[j, k]
    scale = 1.0 / sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    return x * scale, y * scale, z * scale, w * scale
