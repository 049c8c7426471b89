"""What two inertial measurement units, in the cabin and on the chassis, measured of one motion: increments of both.

Both are carried to the point A where the axis of the joint passes, and into the axes of J; there they differ by the
error of the joint's angle, and by what `holdfast.kernel.encoder_zero` estimates beside it: (58) in docs/math.md.
"""

from math import cos, exp, sin
from typing import Any

from holdfast.kernel.compiling import inner
from holdfast.kernel.layout import CABIN_ROWS, NEVER
from holdfast.kernel.so3 import rotate, unrotate

WINDOW_NS = 500_000_000  # so long increments are gathered
SMOOTH_S = 0.05  # over which readings are averaged where they stand for the motion, not for themselves
KNOWN_RAD2 = 2e-3**2  # the angle must be known so well beside its zero
MAX_STEP_NS = 100_000_000  # of the cabin


@inner
def add_cabin(zero: Any, mount: Any, stamp_ns: int, angle_rad: float, rate: Any, force: Any) -> None:
    """Append what the cabin measured until an estimate.

    Args:
        zero: a `ZERO`.
        mount: a `MOUNT`.
        stamp_ns: of the estimate.
        angle_rad: of the joint, as the encoder has its zero.
        rate: (3,) angular velocity of I [rad/s].
        force: (3,) specific force of I [m/s^2].
    """
    since_ns = stamp_ns - zero.stamps_ns[zero.rows % CABIN_ROWS]
    has_before = zero.rows > 0 and 0 < since_ns <= MAX_STEP_NS
    if not has_before:
        zero.rows, zero.since_ns = 0, NEVER
    w, dt = (rate[0], rate[1], rate[2]), since_ns * 1e-9
    f = _carried(force, w, zero.cabin_rate, mount.T_I_A.p, dt if has_before else 0.0, 1.0)
    _keep(zero.cabin_rate, w)
    wx, wy, wz = unrotate(mount.T_I_A.R, w[0], w[1], w[2])
    fx, fy, fz = unrotate(mount.T_I_A.R, f[0], f[1], f[2])
    c, s = cos(angle_rad), sin(angle_rad)
    now = c * wx - s * wy, s * wx + c * wy, c * wz, s * wz, c * fx - s * fy, s * fx + c * fy, c * fz, s * fz
    last, zero.rows = zero.integrals[zero.rows % CABIN_ROWS], zero.rows + 1
    new = zero.integrals[zero.rows % CABIN_ROWS]
    for k in range(8):
        new[k] = last[k] + 0.5 * dt * (zero.cabin[k] + now[k]) if has_before else 0.0
        zero.cabin[k] = now[k]
    zero.stamps_ns[zero.rows % CABIN_ROWS] = stamp_ns


@inner
def forget_cabin(zero: Any) -> None:
    """Let what the cabin measured until now be compared with nothing that comes later."""
    zero.rows, zero.since_ns = 0, NEVER


@inner
def add_base(zero: Any, reading: Any, max_gap_ns: int) -> None:
    """Take in a reading of the base IMU, a `JOINT_READING` whose stamp the cabin has reached."""
    step_ns, zero.base_ns = reading.stamp_ns - zero.base_ns, max(reading.stamp_ns, zero.base_ns)
    if step_ns <= 0:
        return
    has_before = step_ns <= max_gap_ns
    dt, r = step_ns * 1e-9, reading.rate
    w = rotate(zero.R_J_S, r[0], r[1], r[2])
    f = rotate(zero.R_J_S, reading.force[0], reading.force[1], reading.force[2])
    f = _carried(f, w, zero.base_rate, zero.p_J_S, dt if has_before else 0.0, -1.0)
    _keep(zero.base_rate, w)
    now = w[0], w[1], w[2], f[0], f[1], f[2]
    new = 1.0 - exp(-dt / SMOOTH_S) if has_before else 1.0
    for k in range(6):
        zero.base_integrals[k] += 0.5 * dt * (zero.base[k] + now[k])
        zero.smooth[k] += new * (now[k] - zero.smooth[k])
        zero.base[k] = now[k]
    if not has_before:
        zero.since_ns = NEVER
    elif zero.since_ns == NEVER:
        _begin(zero, reading.stamp_ns)
    elif reading.stamp_ns - zero.since_ns >= WINDOW_NS:
        _close(zero, reading.stamp_ns)
        _begin(zero, reading.stamp_ns)


@inner
def _carried(force: Any, rate: Any, before: Any, arm: Any, dt: float, sign: float) -> tuple[float, float, float]:
    """Return the specific force at a point that a rigid body has at sign * arm from the IMU; dt 0: no rate before."""
    x, y, z = sign * arm[0], sign * arm[1], sign * arm[2]
    a, b, c = rate[0], rate[1], rate[2]
    ux, uy, uz = b * z - c * y, c * x - a * z, a * y - b * x
    fx, fy, fz = force[0] + b * uz - c * uy, force[1] + c * ux - a * uz, force[2] + a * uy - b * ux
    if dt > 0.0:
        a, b, c = (a - before[0]) / dt, (b - before[1]) / dt, (c - before[2]) / dt
        fx, fy, fz = fx + b * z - c * y, fy + c * x - a * z, fz + a * y - b * x
    return fx, fy, fz


@inner
def _keep(array: Any, values: tuple[float, float, float]) -> None:
    for k in range(3):
        array[k] = values[k]


@inner
def _begin(zero: Any, stamp_ns: int) -> None:
    """Begin a window at a reading of the base IMU, if the cabin's motion is known there."""
    zero.since_ns = stamp_ns if _integrals_at(zero, stamp_ns, zero.cabin_at_start) else NEVER
    for k in range(6):
        zero.base_integrals[k], zero.smooth_at_start[k] = 0.0, zero.smooth[k]


@inner
def _close(zero: Any, stamp_ns: int) -> None:
    """Leave a window to be looked at, if the one before has been; this may be in a sample of the cabin's IMU."""
    if zero.is_pending or not _integrals_at(zero, stamp_ns, zero.window_cabin):
        return
    for k in range(8):
        zero.window_cabin[k] -= zero.cabin_at_start[k]
    for k in range(6):
        zero.window_base[k] = zero.base_integrals[k]
        zero.window_change[k] = zero.smooth[k] - zero.smooth_at_start[k]
    zero.window_s, zero.is_pending = (stamp_ns - zero.since_ns) * 1e-9, 1


@inner
def _integrals_at(zero: Any, stamp_ns: int, out: Any) -> bool:
    """Let `out` (8,) be what the cabin measured until a time; False where that is not known, or not any more."""
    row, oldest = zero.rows, max(1, zero.rows - CABIN_ROWS + 1)
    if row < 2 or stamp_ns > zero.stamps_ns[row % CABIN_ROWS]:
        return False
    while row > oldest and zero.stamps_ns[(row - 1) % CABIN_ROWS] > stamp_ns:
        row -= 1
    if row == oldest:
        return False
    before, after = (row - 1) % CABIN_ROWS, row % CABIN_ROWS
    fraction = (stamp_ns - zero.stamps_ns[before]) / (zero.stamps_ns[after] - zero.stamps_ns[before])
    for k in range(8):
        out[k] = zero.integrals[before, k] + fraction * (zero.integrals[after, k] - zero.integrals[before, k])
    return True
