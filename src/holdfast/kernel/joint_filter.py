"""A Kalman filter of the turn joint: its angle, how fast the chassis turns, and what is wrong with two sensors.

Its state is in a `JOINT`: angle q, rate w of the chassis about the joint's axis, bias b of the base gyroscope, lag l of
the encoder; (33) and (34) in docs/math.md. The cabin's gyroscope drives the angle, the base gyroscope measures the
chassis, the encoder the angle; each may be late or absent.
"""

from math import ceil, floor, pi
from typing import Any

from holdfast.kernel.compiling import inner
from holdfast.kernel.layout import NEVER
from holdfast.kernel.search import first_after

ROTATION_S = 5.0  # how long the chassis goes on rotating, where nothing else is known
RATE_WALK2 = 0.1**2  # how its rotation begins and ends [rad^2/s^3]
ANY_RATE_RAD2_S2 = 0.5 * RATE_WALK2 * ROTATION_S  # variance of a rate of which nothing is known
LAG_SIGMA_S, LAG_WALK_S_SQRT_S = 0.02, 1e-3  # of the encoder's stamps
MAX_LAG_S = 0.2
LAG_RATE_RAD_S = 0.05  # slower rotation shows noise rather than the lag
STEP_S, MAX_STEPS = 0.05, 500  # a silence is crossed in steps
GATE_SIGMA = 6.0
SILENT_NS = 100_000_000  # after such a silence of the base gyroscope nothing before it is sure any more

USED, LATE, INNOVATION, FROZEN = range(4)


@inner
def predict(joint: Any, rotations: Any, stamp_ns: int, cabin_rate_rad_s: float, cabin_density2: float) -> None:
    """Go on to a later time, over which the cabin rotated at a rate about the axis: (33).

    Args:
        joint: a `JOINT`.
        rotations: rows of `ROTATION`.
        stamp_ns: the time; an earlier one changes nothing.
        cabin_rate_rad_s: mean rate of the cabin, its bias removed.
        cabin_density2: noise of that rate [rad^2/s].
    """
    if joint.stamp_ns == NEVER:
        joint.stamp_ns = stamp_ns
        _remember(joint, rotations, 0.0)
        return
    whole_s = (stamp_ns - joint.stamp_ns) * 1e-9
    if whole_s <= 0.0:
        return
    steps = 1 if whole_s <= STEP_S else min(ceil(whole_s / STEP_S), MAX_STEPS)
    dt = whole_s / steps
    keep = 1.0 if _has_gyro(joint, stamp_ns) else max(0.0, 1.0 - dt / ROTATION_S)
    qq, qw, qb, ql, ww, wb, wl, bb, bl, ll = _covariance(joint.P)
    rate, turned = joint.rate_rad_s, 0.0
    for _ in range(steps):
        turned += (cabin_rate_rad_s - rate) * dt
        rate *= keep
        qq += dt * (dt * ww - 2.0 * qw + cabin_density2)
        qb -= dt * wb
        ql -= dt * wl
        qw = keep * (qw - dt * ww)
        ww = keep * keep * ww + RATE_WALK2 * dt
        wb *= keep
        wl *= keep
    bb += joint.bias_walk * whole_s
    ll += joint.lag_walk * whole_s
    _set(joint.P, (qq, qw, qb, ql, ww, wb, wl, bb, bl, ll))
    joint.angle_rad += turned
    joint.rate_rad_s, joint.stamp_ns, joint.joint_rate_rad_s = rate, stamp_ns, cabin_rate_rad_s - rate
    _remember(joint, rotations, turned)


@inner
def add_rate(joint: Any, stamp_ns: int, rate_rad_s: float, variance: float) -> None:
    """Take in what the base gyroscope measured, at the filter's time or before: (34)."""
    _, qw, qb, _, ww, wb, wl, bb, bl, _ = _covariance(joint.P)
    S = ww + 2.0 * wb + bb + variance + RATE_WALK2 * _since_s(joint, stamp_ns)
    weighted = (rate_rad_s - joint.rate_rad_s - joint.bias_rad_s) / S
    _correct(joint, weighted, S, (qw + qb, ww + wb, wb + bb, wl + bl), False)
    if stamp_ns - joint.rate_ns > SILENT_NS:
        joint.first = joint.end - 1
    joint.rate_ns = max(stamp_ns, joint.rate_ns)


@inner
def rotation_until(joint: Any, rotations: Any, stamp_ns: int) -> float:
    """Return by how much the joint had turned when a reading with a stamp was taken, since long ago [rad]."""
    taken_ns = stamp_ns - round(joint.lag_s * 1e9)
    low = first_after(rotations, joint.first, joint.end, taken_ns)
    if low == joint.end:
        last = rotations[low - 1]
        return last.angle_rad + joint.joint_rate_rad_s * (taken_ns - last.stamp_ns) * 1e-9
    if low == joint.first:
        return rotations[low].angle_rad
    before, after = rotations[low - 1], rotations[low]
    fraction = (taken_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    return before.angle_rad + fraction * (after.angle_rad - before.angle_rad)


@inner
def add_angle(joint: Any, rotations: Any, stamp_ns: int, angle_rad: float, variance: float, rotation_rad: float) -> int:
    """Take in a reading of the encoder, at the filter's time or before; whole rotations do not matter: (34).

    What the joint turned since it was taken is added to the reading.

    Args:
        joint: a `JOINT`.
        rotations: rows of `ROTATION`.
        stamp_ns: of the reading.
        angle_rad: of the joint.
        variance: of the reading [rad^2].
        rotation_rad: what `rotation_until` says of the stamp.
    """
    taken_ns = stamp_ns - round(joint.lag_s * 1e9)
    if taken_ns < rotations[joint.first].stamp_ns:
        return LATE
    since_s = _since_s(joint, taken_ns)
    angle_rad += rotations[joint.end - 1].angle_rad - rotation_rad
    if not joint.is_known:
        joint.is_known = 1
        _start_at(joint, angle_rad, variance, since_s)
        return USED
    qq, qw, qb, ql, ww, wb, wl, _, bl, ll = _covariance(joint.P)
    shows_lag = abs(joint.joint_rate_rad_s) > LAG_RATE_RAD_S and _has_gyro(joint, stamp_ns)
    joint_rate = joint.joint_rate_rad_s if shows_lag else 0.0
    a = qq + since_s * qw - joint_rate * ql
    c = qw + since_s * ww - joint_rate * wl
    d = qb + since_s * wb - joint_rate * bl
    e = ql + since_s * wl - joint_rate * ll
    S = a + since_s * c - joint_rate * e + variance
    innovation = angle_rad - joint.angle_rad
    innovation -= 2.0 * pi * floor(innovation / (2.0 * pi) + 0.5)
    if innovation * innovation > GATE_SIGMA**2 * S:
        if joint.refused_ns == NEVER:
            joint.refused_ns = stamp_ns
        if stamp_ns - joint.refused_ns < joint.accept_after_ns:
            return INNOVATION
        _start_at(joint, joint.angle_rad + innovation, variance, since_s)
        return USED
    joint.refused_ns = NEVER
    _correct(joint, innovation / S, S, (a, c, d, e), shows_lag)
    return USED


@inner
def _start_at(joint: Any, angle_rad: float, variance: float, since_s: float) -> None:
    """Let a reading alone say what the angle is, carried on for some time; the rate may be as wrong as it was."""
    joint.refused_ns, joint.angle_rad = NEVER, angle_rad
    bb, ll = joint.P[7], joint.P[9]
    qw, ql = -since_s * ANY_RATE_RAD2_S2, joint.joint_rate_rad_s * ll
    qq = variance - since_s * qw + joint.joint_rate_rad_s * ql
    _set(joint.P, (qq, qw, 0.0, ql, ANY_RATE_RAD2_S2, 0.0, 0.0, bb, 0.0, ll))


@inner
def _correct(
    joint: Any, weighted: float, S: float, covariances: tuple[float, float, float, float], moves_lag: bool
) -> None:
    """Correct by an innovation over its variance S, given its covariances with the state.

    A lag that is not moved keeps its variance, too (Schmidt's consider filter).
    """
    a, c, d, e = covariances
    qq, qw, qb, ql, ww, wb, wl, bb, bl, ll = _covariance(joint.P)
    joint.angle_rad += a * weighted
    joint.rate_rad_s += c * weighted
    joint.bias_rad_s += d * weighted
    if moves_lag:
        joint.lag_s = min(max(joint.lag_s + e * weighted, -MAX_LAG_S), MAX_LAG_S)
        ll -= e * e / S
    A, C, D = a / S, c / S, d / S
    row_q, row_w = (qq - a * A, qw - c * A, qb - d * A, ql - e * A), (ww - c * C, wb - d * C, wl - e * C)
    _set(joint.P, (*row_q, *row_w, bb - d * D, bl - e * D, ll))


@inner
def _covariance(P: Any) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    return P[0], P[1], P[2], P[3], P[4], P[5], P[6], P[7], P[8], P[9]


@inner
def _set(P: Any, values: tuple[float, ...]) -> None:
    for k in range(10):
        P[k] = values[k]


@inner
def _has_gyro(joint: Any, stamp_ns: int) -> bool:
    """Whether the base gyroscope says how the chassis rotates; else a lag of the encoder looks like a rotation."""
    return stamp_ns - joint.rate_ns < SILENT_NS


@inner
def _since_s(joint: Any, stamp_ns: int) -> float:
    return max(0, joint.stamp_ns - stamp_ns) * 1e-9


@inner
def _remember(joint: Any, rotations: Any, turned_rad: float) -> None:
    """Append a row, and forget those that no reading needs, many at a time."""
    until_rad = rotations[joint.end - 1].angle_rad if joint.end > joint.first else 0.0
    if joint.end == len(rotations):
        first = max(joint.first, joint.end - len(rotations) // 2)
        for row in range(first, joint.end):
            rotations[row - first].stamp_ns = rotations[row].stamp_ns
            rotations[row - first].angle_rad = rotations[row].angle_rad
        joint.first, joint.end = 0, joint.end - first
    rotations[joint.end].stamp_ns, rotations[joint.end].angle_rad = joint.stamp_ns, until_rad + turned_rad
    joint.end += 1
    if rotations[joint.first].stamp_ns < joint.stamp_ns - 2 * joint.memory_ns:
        while rotations[joint.first + 1].stamp_ns <= joint.stamp_ns - joint.memory_ns:
            joint.first += 1
