"""The turn joint over time: what readings of the encoder and the base gyroscope do to the filter, and the chassis."""

from math import copysign, cos, inf, sin, sqrt
from typing import Any

from holdfast.kernel.base_comparison import KNOWN_RAD2, add_base, add_cabin, forget_cabin
from holdfast.kernel.compiling import entry, inner
from holdfast.kernel.encoder_zero import conclude, correct_slowly, learn
from holdfast.kernel.joint_filter import FROZEN, LATE, USED, add_angle, add_rate, predict, rotation_until
from holdfast.kernel.layout import JOINT, JOINT_READING, NEVER, ROTATION, records
from holdfast.kernel.so3 import multiply, rotate, unrotate
from holdfast.kernel.types import FLOAT64, INT64, VECTOR, VOID
from holdfast.messages import Array

CORRECTED_S = 0.1  # so long an error in proportion to the cabin's turning adds up before the encoder corrects it
MAX_STEP_RAD = 2.5e-4  # that the encoder may correct the angle at once: T_O_B does not step
SETTLE_S = 0.5  # in which the rest of the correction flows in
AT_ONCE_NS = 50_000_000  # a longer silence of the cabin's IMU is crossed from reading to reading
KEPT_CHANGES, MAX_RATIO = 500.0, 9.0  # of readings of the base gyroscope; one tells no more
LEAST_NOISE = 0.01  # of the variance that is configured, whatever readings show
FROZEN_STEPS = 3.0  # an encoder that has rotated by so many of its steps without a new reading is frozen

OK, ABSENT, IS_LATE, IS_FROZEN, IS_WRONG = range(5)  # states of the encoder; the last has a wrong zero, which is known


@inner
def advance(
    joint: Any,
    rotations: Any,
    waiting: Any,
    mount: Any,
    stamp_ns: int,
    cabin_rate_rad_s: float,
    rate: Any,
    force: Any,
    from_imu: bool,
) -> bool:
    """Go on to the next estimate, taking in the readings on the way; False if no angle was ever read.

    Args:
        joint: a `JOINT`, whose `motion` is set.
        rotations: rows of `ROTATION`.
        waiting: rows of `JOINT_READING` in the order of their stamps; those until the estimate are taken in.
        mount: a `MOUNT`.
        stamp_ns: of the estimate, not before the last one.
        cabin_rate_rad_s: mean rate of the cabin about the axis since the estimate before, bias removed.
        rate: (3,) angular velocity of I at the estimate, bias removed [rad/s].
        force: (3,) specific force of I [m/s^2].
        from_imu: False where the cabin's IMU was silent.
    """
    density2 = joint.silent_density2
    if from_imu:
        density2 = joint.cabin_density2 + joint.motion_ratio2 * cabin_rate_rad_s * cabin_rate_rad_s
    step_ns = 0 if joint.stamp_ns == NEVER else stamp_ns - joint.stamp_ns
    at_once, had_encoder = step_ns <= AT_ONCE_NS, _is_usable(joint.encoder)
    if at_once:
        predict(joint, rotations, stamp_ns, cabin_rate_rad_s, density2)
    if at_once and from_imu and joint.has_gyro and had_encoder and joint.P[0] < KNOWN_RAD2:
        add_cabin(joint.zero, mount, stamp_ns, joint.angle_rad, rate, force)
    else:
        forget_cabin(joint.zero)
    count = 0
    while count < joint.waiting and waiting[count].stamp_ns <= stamp_ns:
        if not at_once:
            predict(joint, rotations, waiting[count].stamp_ns, cabin_rate_rad_s, density2)
        _take(joint, rotations, waiting[count])
        count += 1
    if count > 0:
        _drop(joint, waiting, count)
    if not at_once:
        predict(joint, rotations, stamp_ns, cabin_rate_rad_s, density2)
    joint.encoder = _judge_encoder(joint, stamp_ns)
    if not joint.is_known:
        return False
    corrected_rad = joint.corrected_rad
    joint.corrected_rad = 0.0
    if abs(corrected_rad) > MAX_STEP_RAD and (joint.has_gyro or not had_encoder):
        joint.held_rad += corrected_rad - copysign(MAX_STEP_RAD, corrected_rad)
    joint.held_rad *= max(0.0, 1.0 - step_ns * 1e-9 / SETTLE_S)
    zero, held_rad = joint.zero, joint.held_rad
    left_rad = correct_slowly(zero, step_ns * 1e-9)
    joint.motion[0] = joint.angle_rad - held_rad + zero.applied_rad
    of_zero = zero.correction_variance + left_rad * left_rad
    joint.motion[1] = sqrt(max(joint.P[0], 0.0) + of_zero + held_rad * held_rad)
    joint.motion[2], joint.motion[3] = joint.rate_rad_s, sqrt(max(joint.P[4], 0.0))
    return True


@inner
def _take(joint: Any, rotations: Any, reading: Any) -> None:
    was_known, before_rad, outcome = joint.is_known, joint.angle_rad, USED
    if reading.is_angle:
        outcome = _take_angle(joint, rotations, reading.stamp_ns, reading.value)
    else:
        since_ns = reading.stamp_ns - joint.gyro_ns
        if since_ns > 0:
            joint.gyro_ns = reading.stamp_ns
            if since_ns <= joint.gyro_gap_ns:
                joint.gyro_period_s = since_ns * 1e-9
                _learn_noise(joint, reading.value - joint.gyro_rad_s)
            joint.gyro_rad_s = reading.value
        add_rate(joint, reading.stamp_ns, reading.value, _gyro_density2(joint) / joint.gyro_period_s)
        add_base(joint.zero, reading, joint.gyro_gap_ns)
    joint.counts[reading.is_angle, outcome] += 1
    if was_known:
        joint.corrected_rad += joint.angle_rad - before_rad


@inner
def _learn_noise(joint: Any, change_rad_s: float) -> None:
    """Take in by how much two successive readings of the base gyroscope differ: by their noise, and by its motion."""
    density2 = 0.5 * change_rad_s * change_rad_s * joint.gyro_period_s
    if joint.gyro_changes > 0.0:
        density2 = min(density2, MAX_RATIO * joint.gyro_changed2)
    joint.gyro_changes = min(joint.gyro_changes + 1.0, KEPT_CHANGES)
    joint.gyro_changed2 += (density2 - joint.gyro_changed2) / joint.gyro_changes


@inner
def _gyro_density2(joint: Any) -> float:
    """Return the noise of the base gyroscope [rad^2/s]: no more than successive readings differ by."""
    if joint.gyro_changes < KEPT_CHANGES:
        return joint.gyro_density2
    return min(joint.gyro_density2, max(joint.gyro_changed2, LEAST_NOISE * joint.gyro_density2))


@inner
def _take_angle(joint: Any, rotations: Any, stamp_ns: int, angle_rad: float) -> int:
    hidden_rad, rotation_rad = 0.0, rotation_until(joint, rotations, stamp_ns)
    if stamp_ns > joint.angle_ns:
        joint.angle_ns = stamp_ns
        white = bias = -1.0  # nothing can be told where the rate itself comes from the encoder
        if joint.has_gyro and stamp_ns - joint.gyro_ns <= joint.gyro_gap_ns:
            white, bias = joint.cabin_density2 + _gyro_density2(joint), max(joint.P[7], 0.0)
        hidden_rad = hidden_rotation(joint.repeats, stamp_ns, angle_rad, rotation_rad, white, bias)
    if joint.repeats.is_frozen:
        return FROZEN
    outcome = add_angle(
        joint, rotations, stamp_ns, angle_rad, joint.angle_variance + hidden_rad * hidden_rad, rotation_rad
    )
    if outcome == USED and stamp_ns > joint.used_ns:
        joint.used_ns = stamp_ns
    return outcome


@inner
def hidden_rotation(
    repeats: Any, stamp_ns: int, reading_rad: float, rotation_rad: float, white: float, bias: float
) -> float:
    """Take in a reading and return by how much the joint has turned for sure since it was first read [rad].

    An encoder that stands still repeats itself, and so does one with a coarse step: a reading may be as old as the
    first of its run. It is frozen where that is more than noise and steps explain: (35) in docs/math.md.

    Args:
        repeats: a `REPEATS`.
        stamp_ns: of the reading, later than those before.
        reading_rad: the angle.
        rotation_rad: integral of the joint's rate until the stamp, from any time on.
        white: noise of that rate [rad^2/s]; negative where nothing can be told.
        bias: variance of its bias [rad^2/s^2].
    """
    if not repeats.has_reading or reading_rad != repeats.reading_rad:
        if repeats.has_reading:
            repeats.step_rad = min(repeats.step_rad, abs(reading_rad - repeats.reading_rad))
        repeats.reading_rad, repeats.since_ns, repeats.rotation_rad = reading_rad, stamp_ns, rotation_rad
        repeats.has_reading, repeats.is_frozen = 1, 0
        return 0.0
    if white < 0.0:
        return 0.0
    since_s = (stamp_ns - repeats.since_ns) * 1e-9
    unsure = 4.0 * sqrt(white * since_s + bias * since_s * since_s)
    hidden = max(0.0, abs(rotation_rad - repeats.rotation_rad) - unsure)
    steps = FROZEN_STEPS * repeats.step_rad if repeats.step_rad < inf else 0.0
    repeats.is_frozen = int(hidden > max(repeats.least_rad, steps))
    return hidden


@inner
def _judge_encoder(joint: Any, stamp_ns: int) -> int:
    if not joint.is_known:
        return ABSENT
    newest_ns = joint.angle_ns if joint.repeats.is_frozen else joint.used_ns
    if stamp_ns - newest_ns > joint.max_age_ns:
        return IS_LATE
    if joint.repeats.is_frozen:
        return IS_FROZEN
    return IS_WRONG if joint.zero.is_wrong else OK


@inner
def _is_usable(encoder: int) -> bool:
    return encoder in (OK, IS_WRONG)


@inner
def place(mount: Any, estimate: Any, motion: Any, out: Any) -> None:
    """Let a `CHASSIS` be what the joint's motion makes of an `ESTIMATE`: (36) and (37)."""
    nav, T_W_O, T_W_B, T_O_B, T_J_B, R = estimate.nav, estimate.T_W_O, out.T_W_B, out.T_O_B, mount.T_J_B, mount.T_I_A.R
    angle, rate, s = motion[0], motion[2], mount.T_I_A.p
    c, sine = cos(angle), sin(angle)
    for i in range(3):  # T_O_B is scratch paper until the end: R_I_J, then R_I_B
        T_O_B.R[i, 0], T_O_B.R[i, 1], T_O_B.R[i, 2] = (
            c * R[i, 0] - sine * R[i, 1],
            sine * R[i, 0] + c * R[i, 1],
            R[i, 2],
        )
    px, py, pz = rotate(T_O_B.R, T_J_B.p[0], T_J_B.p[1], T_J_B.p[2])
    px, py, pz = rotate(nav.R, px + s[0], py + s[1], pz + s[2])
    T_W_B.p[0], T_W_B.p[1], T_W_B.p[2] = px + nav.p[0], py + nav.p[1], pz + nav.p[2]
    w, v = estimate.angular_velocity, nav.v
    ux, uy, uz = unrotate(nav.R, v[0], v[1], v[2])
    ux, uy, uz = ux + w[1] * s[2] - w[2] * s[1], uy + w[2] * s[0] - w[0] * s[2], uz + w[0] * s[1] - w[1] * s[0]
    ux, uy, uz = unrotate(T_O_B.R, ux, uy, uz)
    wx, wy, wz = unrotate(T_O_B.R, w[0], w[1], w[2])
    joint_rate, wz = wz - rate, rate
    r = T_J_B.p
    ux, uy, uz = ux + wy * r[2] - wz * r[1], uy + wz * r[0] - wx * r[2], uz + wx * r[1] - wy * r[0]
    ux, uy, uz = unrotate(T_J_B.R, ux, uy, uz)
    wx, wy, wz = unrotate(T_J_B.R, wx, wy, wz)
    out.velocity[0], out.velocity[1], out.velocity[2] = ux, uy, uz
    out.angular_velocity[0], out.angular_velocity[1], out.angular_velocity[2] = wx, wy, wz
    multiply(nav.R, T_O_B.R, T_W_B.R)
    multiply(T_W_B.R, T_J_B.R, T_O_B.R)
    T_W_B.R[:, :] = T_O_B.R
    for i in range(3):
        for j in range(3):
            T_O_B.R[i, j] = (
                T_W_O.R[0, i] * T_W_B.R[0, j] + T_W_O.R[1, i] * T_W_B.R[1, j] + T_W_O.R[2, i] * T_W_B.R[2, j]
            )
    p, o = T_W_B.p, T_W_O.p
    T_O_B.p[0], T_O_B.p[1], T_O_B.p[2] = unrotate(T_W_O.R, p[0] - o[0], p[1] - o[1], p[2] - o[2])
    out.joint_angle_rad, out.joint_rate_rad_s = angle, joint_rate
    out.joint_angle_sigma_rad, out.turn_rate_sigma_rad_s = motion[1], motion[3]


@inner
def _drop(joint: Any, waiting: Any, count: int) -> None:
    """Let the first readings wait no more."""
    for k in range(count, joint.waiting):
        waiting[k - count] = waiting[k]
    joint.waiting -= count


@inner
def at(
    mount: Any,
    joint: Any,
    rotations: Any,
    waiting: Any,
    estimate: Any,
    out: Any,
    stamp_ns: int,
    from_imu: bool,
    force: Any,
) -> bool:
    """Let `out` be the `CHASSIS` at an `ESTIMATE`; False before the first reading of the encoder.

    Args:
        mount: a `MOUNT`.
        joint: (2,) of `JOINT`: as it is, and as it was when nothing was known; not used without a joint.
        rotations: rows of `ROTATION`.
        waiting: rows of `JOINT_READING`.
        estimate: of the cabin.
        out: the chassis.
        stamp_ns: of the estimate.
        from_imu: False where the cabin's IMU was silent.
        force: (3,) specific force of its sample [m/s^2].
    """
    w, turning, before_rad_s = estimate.angular_velocity, joint[0], mount.axis_rate_rad_s
    _, _, rate_rad_s = unrotate(mount.T_I_A.R, w[0], w[1], w[2])
    if stamp_ns < mount.stamp_ns:
        joint[1].counts[:, :] = turning.counts
        joint[0] = joint[1]  # the clock has gone back: no reading of before compares with one of now
    mount.stamp_ns, mount.axis_rate_rad_s = stamp_ns, rate_rad_s
    if mount.has_joint:
        mean_rad_s = 0.5 * (before_rad_s + rate_rad_s) if from_imu else rate_rad_s
        if not advance(turning, rotations, waiting, mount, stamp_ns, mean_rad_s, w, force, from_imu):
            return False
    else:
        turning.motion[2] = rate_rad_s
    place(mount, estimate, turning.motion, out)
    return True


# --- what Python calls: compiled here, so it comes last


@entry(VOID, records(JOINT))
def begin_with_zero(joint: Any) -> None:
    """Let the first of (N,) of `JOINT` begin with the zero that was known before, which is in its record."""
    zero = joint[0].zero
    conclude(zero)
    zero.applied_rad = zero.correction_rad


@entry(VOID, *(records(one) for one in (JOINT, ROTATION, JOINT_READING)), INT64, INT64, INT64, FLOAT64, VECTOR, VECTOR)
def add_reading(
    joint: Any,
    rotations: Any,
    waiting: Any,
    stamp_ns: int,
    order: int,
    is_angle: int,
    value: float,
    rate: Array,
    force: Array,
) -> None:
    """Take in a reading whose stamp the filter has reached, or let it wait; where all rows wait, the first is late.

    Args:
        joint: (2,) of `JOINT`, as in `at`.
        rotations: rows of `ROTATION`.
        waiting: rows of `JOINT_READING`.
        stamp_ns: of the reading.
        order: of the sensor among readings with equal stamps.
        is_angle: whether it is an angle [rad] rather than a rate [rad/s].
        value: of the reading.
        rate: (3,) angular velocity [rad/s] of the base IMU, in its own axes; not used of an angle.
        force: (3,) its specific force [m/s^2].
    """
    turning = joint[0]
    if turning.waiting == len(waiting):
        turning.counts[waiting[0].is_angle, LATE] += 1
        _drop(turning, waiting, 1)
    k = turning.waiting
    while k > 0 and (waiting[k - 1].stamp_ns, waiting[k - 1].order) > (stamp_ns, order):
        waiting[k] = waiting[k - 1]
        k -= 1
    reading = waiting[k]
    reading.stamp_ns, reading.order, reading.is_angle, reading.value = stamp_ns, order, is_angle, value
    reading.rate[:], reading.force[:] = rate, force
    turning.waiting += 1
    if turning.stamp_ns != NEVER and stamp_ns <= turning.stamp_ns:  # then it is the first, for none waits that long
        _take(turning, rotations, reading)
        _drop(turning, waiting, 1)
    if turning.zero.is_pending:
        learn(turning.zero)
