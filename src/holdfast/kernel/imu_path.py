"""What happens at one sample of the IMU, and where a new optimised state comes in.

What was published goes on beside its successor until the next sample. There the two are compared, and T_W_O takes the
difference: T_O_I arrives where the state published before leads it, whatever has become of position, attitude or
velocity, also where the IMU was silent in between.

What happens seldom has a function of its own: less code for the usual sample, which finds the caches cold.
"""

from math import isfinite
from typing import Any

from holdfast.kernel.compiling import entry, inner
from holdfast.kernel.layout import (
    BLOCK,
    BUFFER,
    JOINT,
    JOINT_READING,
    MOUNT,
    PATH,
    PROPAGATION,
    ROTATION,
    SAMPLE,
    WORK,
    records,
)
from holdfast.kernel.odometry_frame import correct, flow
from holdfast.kernel.preintegration import predict, predict_covariance
from holdfast.kernel.propagation import advance, copy_nav, fold, follows_as_usual, start, step
from holdfast.kernel.ring import write_row
from holdfast.kernel.samples import IS_LINE, STEPPED, append, is_usual
from holdfast.kernel.so3 import quaternion
from holdfast.kernel.turn_joint import at
from holdfast.kernel.types import BOOL, FLOATS, INT64, READING, VOID, WORDS

REFUSED = 0  # nothing was done: the sample is unusual, and someone must look at it
# flags beside those of `samples`
TAKEN, IS_PENDING, HAS_ESTIMATE, FROM_IMU, IS_SOUND, HAS_CHASSIS, CHASSIS_IS_UNSOUND = 4, 8, 16, 32, 64, 128, 256
ENCODER_FLAG = 512  # times the state of the encoder, one of `turn_joint`, or this:
NO_ENCODER = 4

STATE = tuple(records(one) for one in (PATH, PROPAGATION, BUFFER, SAMPLE, BLOCK, WORK))
CHASSIS = tuple(records(one) for one in (MOUNT, JOINT, ROTATION, JOINT_READING))


@inner
def _complete(
    path: Any,
    propagations: Any,
    work: Any,
    mount: Any,
    joint: Any,
    rotations: Any,
    waiting: Any,
    stamp_ns: int,
    before_ns: int,
) -> int:
    """Publish the state that has been carried to a sample; return what came of it, in flags."""
    newest, published = propagations[path.newest], path.published
    estimate = published.estimate
    for k in range(1 + path.is_replaced):
        state = propagations[(path.newest + k) % 2]
        predict(state.pim, work, state.start, path.gravity, state.nav)
    if path.is_replaced:
        other = propagations[1 - path.newest]
        correct(path.frame, work, other.nav, newest.nav, path.is_recovery != 0)
        path.is_replaced = path.is_recovery = 0
    flow(path.frame, work, newest.nav.p, (stamp_ns - before_ns) * 1e-9)
    from_imu = newest.from_imu != 0 and not path.was_ahead
    path.was_ahead = 0
    _publish(path, newest, work, estimate)
    flags = HAS_ESTIMATE | FROM_IMU * from_imu
    if _is_finite(estimate):
        flags |= IS_SOUND
        chassis = published.chassis
        if mount.has_chassis and at(mount, joint, rotations, waiting, estimate, chassis, stamp_ns, from_imu):
            total = chassis.joint_angle_rad + chassis.joint_rate_rad_s
            total += chassis.velocity[0] + chassis.velocity[1] + chassis.velocity[2]
            flags |= HAS_CHASSIS if isfinite(total) else CHASSIS_IS_UNSOUND
    return flags | (joint[0].encoder if mount.has_joint else NO_ENCODER) * ENCODER_FLAG


@inner
def _publish(path: Any, newest: Any, work: Any, estimate: Any) -> None:
    T_W_O = path.frame.T_W_O
    copy_nav(newest.nav, estimate.nav)
    q = quaternion(newest.nav.R)
    for k in range(4):
        estimate.quaternion[k] = q[k]
    estimate.T_W_O.R[:, :], estimate.T_W_O.p[:] = T_W_O.R, T_W_O.p
    estimate.bias_accel[:], estimate.bias_gyro[:] = newest.optimised.bias_accel, newest.optimised.bias_gyro
    estimate.angular_velocity[:] = newest.rate
    predict_covariance(newest.pim, work, newest.P, estimate.covariance)


@inner
def _is_finite(estimate: Any) -> bool:
    total = 0.0
    for i in range(3):
        total += estimate.nav.p[i] + estimate.nav.v[i] + estimate.T_W_O.p[i]
        for j in range(3):
            total += estimate.nav.R[i, j] + estimate.T_W_O.R[i, j]
    return isfinite(total)


@inner
def _replace(path: Any, propagations: Any, buffer: Any, samples: Any, blocks: Any, work: Any) -> None:
    if not path.is_replaced:
        path.newest = 1 - path.newest
        path.is_replaced = 1
    newest = propagations[path.newest]
    _copy_optimised(path.incoming, newest.optimised)
    start(path, newest, buffer, samples, blocks, work)


@inner
def _copy_optimised(source: Any, target: Any) -> None:
    target.stamp_ns = source.stamp_ns
    copy_nav(source.nav, target.nav)
    target.bias_accel[:], target.bias_gyro[:] = source.bias_accel, source.bias_gyro
    target.rate[:], target.P[:, :] = source.rate, source.P


# --- what Python calls: compiled here, so it comes last


@entry(INT64, *STATE, *CHASSIS, WORDS, FLOATS, INT64, INT64, INT64, INT64, READING, BOOL)
def process(
    path: Any,
    propagations: Any,
    buffer: Any,
    samples: Any,
    blocks: Any,
    work: Any,
    mount: Any,
    joint: Any,
    rotations: Any,
    waiting: Any,
    words: Any,
    floats: Any,
    number: int,
    epoch: int,
    stamp_ns: int,
    arrival_ns: int,
    reading: tuple[float, ...],
    is_checked: bool,
) -> int:
    """Take in a sample and carry the state to it; return what came of it, in flags.

    Args:
        path: (1,) of `PATH`.
        propagations: (2,) of `PROPAGATION`.
        buffer: (1,) of `BUFFER`.
        samples: the rows of the buffer; so `blocks`.
        blocks: what they show of the noise.
        work: (1,) of `WORK`.
        mount: (1,) of `MOUNT`.
        joint: (2,) of `JOINT`, as `rotations` and `waiting` those of `turn_joint.at`.
        rotations: rows of `ROTATION`.
        waiting: rows of `JOINT_READING`.
        words: rows of the shared ring, none where there is no other process; as `ring.write_row` has them.
        floats: the same.
        number: of the row in the ring, as `epoch` for it; an unusual sample is left to the caller.
        epoch: of the row.
        stamp_ns: of the sample, offset applied.
        arrival_ns: when it came.
        reading: (6,) specific force [m/s^2] and angular velocity [rad/s].
        is_checked: an unusual one that may be used, and for which there is a row.
    """
    held, here = buffer[0], path[0]
    if not is_checked:
        if not is_usual(held, samples, stamp_ns, reading):
            return REFUSED
        if len(words):
            write_row(words, floats, number, epoch, stamp_ns - here.offset_ns, arrival_ns, reading)
    brought = append(held, samples, stamp_ns, arrival_ns, reading) | TAKEN
    if not here.is_running:
        return brought
    newest = propagations[here.newest]
    before_ns = newest.stamp_ns
    if stamp_ns <= before_ns:
        here.was_ahead = 1  # a measurement in a silent stretch has led the state past this sample
        return brought
    here.has_imu = brought & STEPPED
    if not here.has_imu or not follows_as_usual(newest, held, samples):
        return brought | IS_PENDING
    if here.is_replaced and not follows_as_usual(propagations[1 - here.newest], held, samples):
        return brought | IS_PENDING
    for k in range(1 + here.is_replaced):
        step(propagations[(here.newest + k) % 2], held, samples, work[0])
    return brought | _complete(here, propagations, work[0], mount[0], joint, rotations, waiting, stamp_ns, before_ns)


@entry(INT64, *STATE, *CHASSIS, INT64)
def catch_up(
    path: Any,
    propagations: Any,
    buffer: Any,
    samples: Any,
    blocks: Any,
    work: Any,
    mount: Any,
    joint: Any,
    rotations: Any,
    waiting: Any,
    brought: int,
) -> int:
    """Carry the state to a sample that `process` has left pending: after a silence, or once a second."""
    here, held = path[0], buffer[0]
    before_ns = propagations[here.newest].stamp_ns
    if brought & IS_LINE:
        _copy_optimised(propagations[here.newest].optimised, here.incoming)
        _replace(here, propagations, held, samples, blocks, work[0])  # what looked good was a straight line
    for k in range(1 + here.is_replaced):
        if k == 1 or not brought & IS_LINE:
            state = propagations[(here.newest + k) % 2]
            advance(here, state, held, samples, blocks, work[0], brought & STEPPED != 0)
    return brought | _complete(
        here, propagations, work[0], mount[0], joint, rotations, waiting, held.newest_ns, before_ns
    )


@entry(VOID, *STATE, BOOL, BOOL)
def anchor(
    path: Any,
    propagations: Any,
    buffer: Any,
    samples: Any,
    blocks: Any,
    work: Any,
    is_first: bool,
    is_recovery: bool,
) -> None:
    """Continue from the state in `path.incoming`: propagate the samples since its stamp.

    Args:
        path: as the others those of `process`.
        propagations: of `PROPAGATION`.
        buffer: of `BUFFER`.
        samples: rows of the buffer.
        blocks: what they show of the noise.
        work: of `WORK`.
        is_first: there was none before; O is where W is.
        is_recovery: T_W_O keeps this correction, whatever the policy.
    """
    here = path[0]
    here.is_recovery |= is_recovery
    if is_first:
        for pose in (here.frame.T_W_O, here.frame.rest):
            pose.R[:, :], pose.p[:] = 0.0, 0.0
            for k in range(3):
                pose.R[k, k] = 1.0
        here.frame.flows, here.is_running = 0, 1
        here.is_replaced = 1  # by nothing that was published
    _replace(here, propagations, buffer[0], samples, blocks, work[0])
    if is_first:
        here.is_replaced = here.is_recovery = 0


@entry(VOID, *STATE)
def settle(path: Any, propagations: Any, buffer: Any, samples: Any, blocks: Any, work: Any) -> None:
    """Let the state now, with its covariance, take the place of the optimised one."""
    newest = propagations[path[0].newest]
    fold(path[0], newest, buffer[0], samples, blocks, work[0])
    first = newest.optimised
    first.stamp_ns, first.rate[:], first.P[:, :] = newest.stamp_ns, newest.rate, newest.P
    copy_nav(newest.start, first.nav)
