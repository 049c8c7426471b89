"""What happens at one sample of the IMU, and where a new optimised state comes in.

What was published goes on beside its successor until the next sample. There the two are compared, and T_W_O takes the
difference: T_O_I arrives where the state published before leads it, whatever has become of position, attitude or
velocity, also where the IMU was silent in between.

What happens seldom has a function of its own: less code for the usual sample, which finds the caches cold. For the same
reason all that Python gives is the address of a `PATH`, which knows where the other records lie.
"""

from math import isfinite
from typing import Any

from holdfast.kernel.addresses import floats_at, records_at, words_at
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
)
from holdfast.kernel.odometry_frame import correct, flow
from holdfast.kernel.preintegration import predict, predict_covariance
from holdfast.kernel.propagation import advance, copy_nav, fold, follows_as_usual, start, step
from holdfast.kernel.ring import WIDTH, write_row
from holdfast.kernel.samples import IS_LINE, STEPPED, append, is_usual
from holdfast.kernel.so3 import quaternion
from holdfast.kernel.turn_joint import at
from holdfast.kernel.types import BOOL, INT64, VECTOR, VOID
from holdfast.messages import Array

REFUSED = 0  # nothing was done: the sample is unusual, and someone must look at it
HAS_NEWS = -1  # nothing was done: the optimiser has published a state that should be taken in first
# flags beside those of `samples`
TAKEN, IS_PENDING, HAS_ESTIMATE, FROM_IMU, IS_SOUND, HAS_CHASSIS, CHASSIS_IS_UNSOUND = 4, 8, 16, 32, 64, 128, 256
IS_OVERDUE = 512  # no new state for long
ENCODER_FLAG = 1024  # times the state of the encoder, one of `turn_joint`, or this:
NO_ENCODER = 5

LEAVE = 2  # for so many samples a new state is left to calls that are in less of a hurry


@inner
def open_path(address: int) -> Any:
    """Return (1,) `PATH` at an address, and its (2,) `PROPAGATION`, (1,) `BUFFER`, samples, blocks, (1,) `WORK`."""
    path = records_at(address, 1, PATH)
    buffer = records_at(path[0].buffer_at, 1, BUFFER)
    samples = records_at(buffer[0].samples_at, buffer[0].rows, SAMPLE)
    blocks = records_at(buffer[0].blocks_at, buffer[0].block_rows, BLOCK)
    propagations = records_at(path[0].propagations_at, 2, PROPAGATION)
    return path, propagations, buffer, samples, blocks, records_at(path[0].work_at, 1, WORK)


@inner
def _complete(path: Any, propagations: Any, work: Any, sample: Any, before_ns: int) -> int:
    """Publish the state that has been carried to a sample; return what came of it, in flags."""
    mount, joint = records_at(path.mount_at, 1, MOUNT)[0], records_at(path.joint_at, 2, JOINT)
    newest, published, stamp_ns = propagations[path.newest], path.published, sample.stamp_ns
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
    flags = HAS_ESTIMATE | FROM_IMU * from_imu | IS_OVERDUE * (stamp_ns > path.shared.rescue_ns)
    if _is_finite(estimate):
        flags |= IS_SOUND
        chassis = published.chassis
        rotations = records_at(path.rotations_at, path.rotation_rows, ROTATION)
        waiting = records_at(path.waiting_at, path.waiting_rows, JOINT_READING)
        known = (mount, joint, rotations, waiting, estimate, chassis)
        if mount.has_chassis and at(*known, stamp_ns, from_imu, sample.force):
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


@inner
def _reach(path: Any, propagations: Any, held: Any, samples: Any, work: Any, brought: int) -> int:
    """Carry the state to the newest sample, or leave that pending where it takes more than a step."""
    if not path.is_running:
        return brought
    newest, stamp_ns = propagations[path.newest], held.newest_ns
    before_ns = newest.stamp_ns
    if stamp_ns <= before_ns:
        path.was_ahead = 1  # a measurement in a silent stretch has led the state past this sample
        return brought
    path.has_imu = brought & STEPPED
    if not path.has_imu or not follows_as_usual(newest, held, samples):
        return brought | IS_PENDING
    if path.is_replaced and not follows_as_usual(propagations[1 - path.newest], held, samples):
        return brought | IS_PENDING
    for k in range(1 + path.is_replaced):
        step(propagations[(path.newest + k) % 2], held, samples, work)
    return brought | _complete(path, propagations, work, samples[held.end - 1], before_ns)


@inner
def _should_take_news(path: Any) -> bool:
    """Whether a new state of the optimiser is to be taken in now; if not, it was left alone once more."""
    shared = path.shared
    if shared.slot_at == 0 or words_at(shared.slot_at, 1, 1)[0, 0] == shared.seen:
        return False
    shared.left += 1
    return shared.left > LEAVE or path.is_running == 0


@inner
def continue_from_incoming(
    path: Any, propagations: Any, buffer: Any, samples: Any, blocks: Any, work: Any, is_first: bool, is_recovery: bool
) -> None:
    """Continue from the state in `path.incoming`: propagate the samples since its stamp.

    Args:
        path: as the others what `_open` returns.
        propagations: of `PROPAGATION`.
        buffer: the `BUFFER`.
        samples: its rows.
        blocks: what they show of the noise.
        work: a `WORK`.
        is_first: there was none before; O is where W is.
        is_recovery: T_W_O keeps this correction, whatever the policy.
    """
    path.is_recovery |= is_recovery
    if is_first:
        for pose in (path.frame.T_W_O, path.frame.rest):
            pose.R[:, :], pose.p[:] = 0.0, 0.0
            for k in range(3):
                pose.R[k, k] = 1.0
        path.frame.flows, path.is_running = 0, 1
        path.is_replaced = 1  # by nothing that was published
    _replace(path, propagations, buffer, samples, blocks, work)
    if is_first:
        path.is_replaced = path.is_recovery = 0


# --- what Python calls: compiled here, so it comes last


@entry(INT64, INT64, INT64, INT64, VECTOR, VECTOR, BOOL)
def process(address: int, stamp_ns: int, arrival_ns: int, force: Array, rate: Array, is_checked: bool) -> int:
    """Take in a sample and carry the state to it; return what came of it, in flags, or why nothing did.

    Args:
        address: of the `PATH`.
        stamp_ns: of the sample, as the clock of the IMU had it.
        arrival_ns: when it came.
        force: (3,) specific force [m/s^2].
        rate: (3,) angular velocity [rad/s].
        is_checked: an unusual sample that may be used, with its stamp in continuous time; there is a row for it, and it
            is left to the caller to pass it to the other process.
    """
    paths, propagations, buffers, samples, _, works = open_path(address)
    path, held, work = paths[0], buffers[0], works[0]
    if len(force) != 3 or len(rate) != 3:
        return REFUSED
    reading = force[0], force[1], force[2], rate[0], rate[1], rate[2]
    if is_checked:
        stamp_ns += path.offset_ns
    else:
        if _should_take_news(path):
            return HAS_NEWS
        read_ns = stamp_ns - path.clock_ns
        stamp_ns = read_ns + path.offset_ns
        if not is_usual(held, samples, stamp_ns, reading):
            return REFUSED
        shared = path.shared
        if shared.ring_at:
            words = words_at(shared.ring_at, shared.ring_rows, WIDTH)
            floats = floats_at(shared.ring_at, shared.ring_rows, WIDTH)
            written = words_at(shared.written_at, 1, 1)
            write_row(words, floats, written[0, 0], shared.epoch, read_ns, arrival_ns, reading)
            written[0, 0] += 1
    path.used += 1
    brought = append(held, samples, stamp_ns, arrival_ns, reading) | TAKEN
    return _reach(path, propagations, held, samples, work, brought)


@entry(INT64, INT64, INT64)
def catch_up(address: int, brought: int) -> int:
    """Carry the state to a sample that `process` has left pending: after a silence, or once a second."""
    paths, propagations, buffers, samples, blocks, works = open_path(address)
    path, held, work = paths[0], buffers[0], works[0]
    before_ns = propagations[path.newest].stamp_ns
    if brought & IS_LINE:
        _copy_optimised(propagations[path.newest].optimised, path.incoming)
        _replace(path, propagations, held, samples, blocks, work)  # what looked good was a straight line
    for k in range(1 + path.is_replaced):
        if k == 1 or not brought & IS_LINE:
            state = propagations[(path.newest + k) % 2]
            advance(path, state, held, samples, blocks, work, brought & STEPPED != 0)
    return (brought & ~IS_PENDING) | _complete(path, propagations, work, samples[held.end - 1], before_ns)


@entry(VOID, INT64, BOOL, BOOL)
def anchor(address: int, is_first: bool, is_recovery: bool) -> None:
    """Continue from the state in `incoming`, as `continue_from_incoming`."""
    paths, propagations, buffers, samples, blocks, works = open_path(address)
    path, held, work = paths[0], buffers[0], works[0]
    continue_from_incoming(path, propagations, held, samples, blocks, work, is_first, is_recovery)


@entry(VOID, INT64)
def settle(address: int) -> None:
    """Let the state now, with its covariance, take the place of the optimised one."""
    paths, propagations, buffers, samples, blocks, works = open_path(address)
    path, held, work = paths[0], buffers[0], works[0]
    newest = propagations[path.newest]
    fold(path, newest, held, samples, blocks, work)
    first = newest.optimised
    first.stamp_ns, first.rate[:], first.P[:, :] = newest.stamp_ns, newest.rate, newest.P
    copy_nav(newest.start, first.nav)
