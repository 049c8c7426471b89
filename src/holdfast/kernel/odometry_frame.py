"""The odometry frame O: T_W_O takes every correction of T_W_I, and what should not stay in it flows out slowly.

With the policy `always` that is its tilt, so that z of O stays up; with `at_recovery` (the paper) everything but the
corrections at recoveries. Eq. (11) of the paper, (20) in docs/math.md.
"""

from math import atan2, radians, sqrt
from typing import Any

from holdfast.kernel.compiling import inner
from holdfast.kernel.so3 import expmap, multiply, quaternion, rotate, unrotate

MAX_SPEED_M_S = 0.05  # at which T_O_I may flow beside the motion: 0.5 mm per sample at 100 Hz
MAX_RATE_RAD_S = radians(0.5)
SETTLE_S = 0.5  # small remainders flow out with this time constant
NEGLIGIBLE = 1e-9


@inner
def correct(frame: Any, work: Any, before: Any, after: Any, is_recovery: bool) -> None:
    """Let the `FRAME` take in that the pose of the IMU in W went from one to another at one instant: (20)."""
    T_W_O = frame.T_W_O
    for i in range(3):
        for j in range(3):
            work.half[i, j] = (
                after.R[i, 0] * before.R[j, 0] + after.R[i, 1] * before.R[j, 1] + after.R[i, 2] * before.R[j, 2]
            )
    _rotate_about(T_W_O, work, before.p)
    for k in range(3):
        T_W_O.p[k] += after.p[k] - before.p[k]
    if is_recovery:
        frame.rest.R[:, :], frame.rest.p[:] = T_W_O.R, T_W_O.p
    frame.flows = 1


@inner
def flow(frame: Any, work: Any, p_W_I: Any, dt_s: float) -> None:
    """Let T_W_O approach where it rests by what is allowed in a time, T_O_I moving as little as it can."""
    if frame.flows and dt_s > 0.0:
        if frame.always:
            _level(frame, work, p_W_I, min(1.0, dt_s / SETTLE_S), MAX_RATE_RAD_S * dt_s)
        else:
            _approach(frame, work, p_W_I, min(1.0, dt_s / SETTLE_S), dt_s)


@inner
def _level(frame: Any, work: Any, p_W_I: Any, fraction: float, most_rad: float) -> None:
    """Turn O about the machine until its z axis is up."""
    x, y = frame.T_W_O.R[0, 2], frame.T_W_O.R[1, 2]  # of O's z axis in W
    tilt = sqrt(x * x + y * y)
    if tilt < NEGLIGIBLE:
        frame.flows = 0
        return
    by = min(fraction * tilt, most_rad) / tilt
    expmap(y * by, -x * by, 0.0, work.half)
    _rotate_about(frame.T_W_O, work, p_W_I)


@inner
def _approach(frame: Any, work: Any, p_W_I: Any, fraction: float, dt_s: float) -> None:
    """Move O towards its rest: first the rotation about the machine, then what moves the machine in O."""
    T_W_O, rest, half = frame.T_W_O, frame.rest, work.half
    for i in range(3):
        for j in range(3):
            half[i, j] = rest.R[i, 0] * T_W_O.R[j, 0] + rest.R[i, 1] * T_W_O.R[j, 1] + rest.R[i, 2] * T_W_O.R[j, 2]
    angle, x, y, z = _angle_and_axis(half)
    if angle > NEGLIGIBLE:
        by = min(fraction * angle, MAX_RATE_RAD_S * dt_s)
        expmap(x * by, y * by, z * by, half)
        _rotate_about(T_W_O, work, p_W_I)
    px, py, pz = p_W_I[0], p_W_I[1], p_W_I[2]
    here = unrotate(T_W_O.R, px - T_W_O.p[0], py - T_W_O.p[1], pz - T_W_O.p[2])
    there = unrotate(rest.R, px - rest.p[0], py - rest.p[1], pz - rest.p[2])
    x, y, z = here[0] - there[0], here[1] - there[1], here[2] - there[2]
    distance = sqrt(x * x + y * y + z * z)
    if distance > NEGLIGIBLE:
        by = min(fraction * distance, MAX_SPEED_M_S * dt_s) / distance
        x, y, z = rotate(T_W_O.R, x * by, y * by, z * by)
        T_W_O.p[0], T_W_O.p[1], T_W_O.p[2] = T_W_O.p[0] + x, T_W_O.p[1] + y, T_W_O.p[2] + z
    elif angle <= NEGLIGIBLE:
        frame.flows = 0


@inner
def _angle_and_axis(R: Any) -> tuple[float, float, float, float]:
    """Return angle and axis of a rotation, also near half a turn."""
    x, y, z, w = quaternion(R)
    sine = sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return 0.0, 0.0, 0.0, 1.0
    return 2.0 * atan2(sine, w), x / sine, y / sine, z / sine


@inner
def _rotate_about(T_W_O: Any, work: Any, p: Any) -> None:
    """Rotate O in W by `work.half` about a position, which keeps its coordinates in O."""
    work.pose.R[:, :] = T_W_O.R
    multiply(work.half, work.pose.R, T_W_O.R)
    x, y, z = rotate(work.half, T_W_O.p[0] - p[0], T_W_O.p[1] - p[1], T_W_O.p[2] - p[2])
    T_W_O.p[0], T_W_O.p[1], T_W_O.p[2] = p[0] + x, p[1] + y, p[2] + z
