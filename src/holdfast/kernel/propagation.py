"""An optimised state, carried forward by the samples since, with its biases and its covariance: (5) and (8)."""

from math import sqrt
from typing import Any

from holdfast.kernel.compiling import inner
from holdfast.kernel.density import density_between
from holdfast.kernel.preintegration import integrate, predict, predict_covariance, reset
from holdfast.kernel.samples import cut, piece_from, rate_at, row_after
from holdfast.kernel.so3 import expmap, multiply, unrotate

FOLD_S = 1.0  # the walk of the biases enters the covariance this often
SWING_NS = 100_000_000  # over which an engine swings to and fro
MOTION_STEP_S = 0.02
MAX_MOTION_STEPS = 100  # of a longer silence, which are longer then: constant twist is followed to second order


@inner
def copy_nav(source: Any, target: Any) -> None:
    """Copy a `NAV`."""
    target.R[:, :], target.p[:], target.v[:] = source.R, source.p, source.v


@inner
def start(path: Any, state: Any, buffer: Any, samples: Any, blocks: Any, work: Any) -> None:
    """Begin a `PROPAGATION` with its optimised state and carry it to the newest sample.

    Args:
        path: the `PATH`.
        state: the propagation.
        buffer: the `BUFFER`; so `samples` and `blocks`.
        work: a `WORK`.
    """
    first = state.optimised
    state.rate[:], state.P[:, :], state.from_imu, state.stamp_ns = first.rate, first.P, 1, first.stamp_ns
    copy_nav(first.nav, state.start)
    _begin(path, state, buffer, samples, blocks)
    while state.stamp_ns < buffer.newest_ns:
        until_ns, is_gap = piece_from(buffer, samples, state.stamp_ns, buffer.newest_ns)
        if is_gap:
            coast(path, state, buffer, samples, blocks, work, until_ns)
        else:
            at_ns, row = state.stamp_ns, row_after(buffer, samples, state.stamp_ns)
            while at_ns < until_ns:
                next_ns = min(samples[row].stamp_ns, until_ns)
                cut(buffer, samples, row, at_ns, next_ns, work.step)
                _add(state, work, work.step.dt_s)
                at_ns, row = next_ns, row + 1
            _note_rate(state, until_ns, rate_at(buffer, samples, until_ns))


@inner
def follows_as_usual(state: Any, buffer: Any, samples: Any) -> bool:
    """Whether a `PROPAGATION` has reached the sample before the newest, and goes on without a fold."""
    before_ns = samples[buffer.end - 2].stamp_ns
    return before_ns == state.stamp_ns and state.pim.dt_s + (buffer.newest_ns - before_ns) * 1e-9 <= FOLD_S


@inner
def step(state: Any, buffer: Any, samples: Any, work: Any) -> None:
    """Carry a `PROPAGATION` to the newest sample, between which and the one before the IMU measured."""
    row = buffer.end - 1
    newest = samples[row]
    cut(buffer, samples, row, samples[row - 1].stamp_ns, newest.stamp_ns, work.step)
    # a measurement may have led the state into this step while the IMU was silent
    _add(state, work, (newest.stamp_ns - state.stamp_ns) * 1e-9)
    _note_rate(state, newest.stamp_ns, (newest.rate[0], newest.rate[1], newest.rate[2]))


@inner
def advance(path: Any, state: Any, buffer: Any, samples: Any, blocks: Any, work: Any, has_step: bool) -> None:
    """Carry a `PROPAGATION` to the newest sample; `has_step` is False where the IMU was silent before it."""
    until_ns = samples[buffer.end - 2].stamp_ns if has_step else buffer.newest_ns
    if until_ns > state.stamp_ns or not has_step:
        coast(path, state, buffer, samples, blocks, work, until_ns)
    if has_step:
        step(state, buffer, samples, work)
        if state.pim.dt_s > FOLD_S:
            fold(path, state, buffer, samples, blocks, work)


@inner
def fold(path: Any, state: Any, buffer: Any, samples: Any, blocks: Any, work: Any) -> None:
    """Begin anew after what was preintegrated, so that other noise and the walk of the biases can be added."""
    pim, P = state.pim, state.P
    predict_covariance(pim, work, P, work.covariance)
    P[:9, :9], P[:9, 9:], P[9:, :9] = work.covariance, work.cross, work.cross.T
    for k in range(6):
        P[9 + k, 9 + k] += path.walk[k] * pim.dt_s
    predict(pim, work, state.start, path.gravity, work.nav)
    copy_nav(work.nav, state.start)
    _begin(path, state, buffer, samples, blocks)


@inner
def coast(path: Any, state: Any, buffer: Any, samples: Any, blocks: Any, work: Any, until_ns: int) -> None:
    """Cross a stretch in which the IMU was silent with the motion model: (12)."""
    fold(path, state, buffer, samples, blocks, work)
    duration_s = (until_ns - state.stamp_ns) * 1e-9
    if duration_s > 0.0:
        state.noise[:] = path.motion_noise
        move(state.pim, work, state.noise, state.start, state.rate, path.gravity, duration_s)
        fold(path, state, buffer, samples, blocks, work)
    state.stamp_ns, state.from_imu = until_ns, 0


@inner
def move(pim: Any, work: Any, noise: Any, nav: Any, rate: Any, gravity: float, duration_s: float) -> None:
    """Preintegrate what an ideal IMU would read at constant twist: (12)."""
    n = min(max(1, round(duration_s / MOTION_STEP_S)), MAX_MOTION_STEPS)
    dt_s, attitude = duration_s / n, work.attitude
    wx, wy, wz = rate[0], rate[1], rate[2]
    vx, vy, vz = unrotate(nav.R, nav.v[0], nav.v[1], nav.v[2])
    ax, ay, az = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
    expmap(0.5 * dt_s * wx, 0.5 * dt_s * wy, 0.5 * dt_s * wz, work.turn)
    multiply(nav.R, work.turn, attitude)
    expmap(dt_s * wx, dt_s * wy, dt_s * wz, work.turn)
    for _ in range(n):
        ux, uy, uz = unrotate(attitude, 0.0, 0.0, gravity)
        integrate(pim, work, noise, dt_s, ax + ux, ay + uy, az + uz, wx, wy, wz)
        multiply(attitude, work.turn, work.half)
        attitude[:, :] = work.half


@inner
def _begin(path: Any, state: Any, buffer: Any, samples: Any, blocks: Any) -> None:
    """Let something follow the state, with the noise of the motion at the newest samples: (10)."""
    reset(state.pim)
    state.noise[:] = path.imu_noise
    if buffer.end > buffer.first:
        seen_force, seen_rate = density_between(buffer, samples, blocks, state.stamp_ns, state.stamp_ns)
        bias, rate = state.optimised.bias_accel, state.rate
        fx, fy, fz = _mean_force(buffer, samples)
        ux, uy, uz = unrotate(state.start.R, 0.0, 0.0, path.gravity)
        ax, ay, az = fx - bias[0] - ux, fy - bias[1] - uy, fz - bias[2] - uz
        by_force = path.force_error * sqrt(ax * ax + ay * ay + az * az)
        by_rate = path.rate_error * sqrt(rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2])
        state.noise[0] = max(path.accelerometer_density, seen_force) ** 2 + by_force**2
        state.noise[1] = max(path.gyroscope_density, seen_rate) ** 2 + by_rate**2


@inner
def _mean_force(buffer: Any, samples: Any) -> tuple[float, float, float]:
    """Return the mean of the newest specific forces: what swings about it is no acceleration of the machine."""
    fx, fy, fz, row = 0.0, 0.0, 0.0, buffer.end
    while row > buffer.first and (row == buffer.end or samples[row - 1].stamp_ns > buffer.newest_ns - SWING_NS):
        row -= 1
        force = samples[row].force
        fx, fy, fz = fx + force[0], fy + force[1], fz + force[2]
    count = buffer.end - row
    return fx / count, fy / count, fz / count


@inner
def _add(state: Any, work: Any, dt_s: float) -> None:
    """Preintegrate the readings of `work.step` over a time."""
    f, w, a, g = work.step.force, work.step.rate, state.optimised.bias_accel, state.optimised.bias_gyro
    readings = f[0] - a[0], f[1] - a[1], f[2] - a[2], w[0] - g[0], w[1] - g[1], w[2] - g[2]
    integrate(state.pim, work, state.noise, dt_s, *readings)
    state.from_imu = 1


@inner
def _note_rate(state: Any, stamp_ns: int, rate: tuple[float, float, float]) -> None:
    state.stamp_ns, bias = stamp_ns, state.optimised.bias_gyro
    for k in range(3):
        state.rate[k] = rate[k] - bias[k]
