"""The zero of the turn joint's encoder, learnt from what cabin and chassis measure of one motion.

Horizontal angular velocity and horizontal specific force of the chassis are those of the cabin, rotated by the joint's
angle. What is left over is the error of the encoder's zero, beside biases, tilts and the clocks of the two inertial
measurement units: (58) to (60) in docs/math.md.
"""

from math import atan2, copysign, log, pi, sqrt
from typing import Any

from holdfast.kernel.compiling import inner

STATES = 9  # of a regression
KEPT_WINDOWS = 60  # over which the noise is averaged
WINSOR2 = 9.0  # of its variance, so much counts of a squared residual
SURE_RAD2 = 0.02**2  # an angle with a larger variance says nothing
MAX_GAIN_ERROR = 0.1  # of two units that measure one motion
AGREE_SIGMA = 4.0  # within which rates and forces must agree
WRONG_ODDS, RIGHT_ODDS = log(100.0), 0.0  # that the configured zero is wrong, to believe it or no more
LEAST_RATE_RAD_S, CORRECT_S = 2e-3, 10.0  # with which the correction comes in: T_O_B does not step
REFUTED_S = 1.0  # the same, once what was known before the start is refuted: it must not do harm for long


@inner
def learn(zero: Any) -> None:
    """Take in the window that is pending, and say what the zero is."""
    zero.is_pending = 0
    for k in range(2):
        _regress(zero, k)
    zero.windows += 1
    conclude(zero)


@inner
def _regress(zero: Any, k: int) -> None:
    """Take increments of the rates (k = 0) or the forces (k = 1) into their regression, a Kalman filter: (58).

    Its state: gain of the cabin (complex), bias (x, y), tilts of cabin and chassis (x, y each), offset of the clock.
    """
    x, P, h, Ph, T = zero.x[k], zero.P[k], zero.h, zero.Ph, zero.window_s
    for i in range(STATES):
        P[i, i] += zero.walk[k, i] * T
    cabin, base, change = zero.window_cabin[4 * k :], zero.window_base[3 * k :], zero.window_change[3 * k :]
    ux, uy, ex, ey = cabin[0], cabin[1], cabin[2], cabin[3]
    noise, excess, is_predicted, NIS = zero.variance[k] * T, 0.0, True, 0.0
    for axis in range(2):
        _row(h, axis, (ux, uy, ex, ey, base[2], change[axis], T))
        innovation, of_state = base[axis], 0.0
        for i in range(STATES):
            innovation -= h[i] * x[i]
            for j in range(STATES):
                of_state += h[i] * P[i, j] * h[j]
        is_predicted = is_predicted and of_state < noise
        excess += 0.5 * max(0.0, innovation * innovation - of_state)
        NIS += 0.5 * innovation * innovation / (of_state + noise)
    if is_predicted:
        share = 1.0 / min(zero.windows + 1.0, KEPT_WINDOWS)
        fresh = min(excess / T, WINSOR2 * zero.variance[k])
        zero.variance[k] = max(zero.variance[k] + share * (fresh - zero.variance[k]), zero.floor[k])
    noise = max(noise, zero.variance[k] * T) * max(1.0, NIS / WINSOR2)
    for axis in range(2):
        _row(h, axis, (ux, uy, ex, ey, base[2], change[axis], T))
        _correct(x, P, h, Ph, base[axis], noise)


@inner
def _row(h: Any, axis: int, window: tuple[float, float, float, float, float, float, float]) -> None:
    """Let `h` (9,) be what an axis of the chassis depends on."""
    ux, uy, ex, ey, z, change, T = window
    h[:] = 0.0
    h[2 + axis], h[6 + axis], h[8] = T, z, change
    if axis == 0:
        h[0], h[1], h[4], h[5] = ux, -uy, ex, -ey
    else:
        h[0], h[1], h[4], h[5] = uy, ux, ey, ex


@inner
def _correct(x: Any, P: Any, h: Any, Ph: Any, measured: float, variance: float) -> None:
    innovation, S = measured, variance
    for i in range(STATES):
        Ph[i] = 0.0
        innovation -= h[i] * x[i]
        for j in range(STATES):
            Ph[i] += P[i, j] * h[j]
        S += h[i] * Ph[i]
    for i in range(STATES):
        x[i] += Ph[i] * innovation / S
        for j in range(STATES):
            P[i, j] -= Ph[i] * Ph[j] / S


@inner
def _angle(zero: Any, k: int) -> tuple[float, float]:
    """Return the angle of the gain and its variance [rad^2]; 0 where it says nothing."""
    P, c, s = zero.P[k], zero.x[k, 0], zero.x[k, 1]
    square = c * c + s * s
    along = (c * c * P[0, 0] + 2.0 * c * s * P[0, 1] + s * s * P[1, 1]) / square
    variance = (s * s * P[0, 0] - 2.0 * c * s * P[0, 1] + c * c * P[1, 1]) / (square * square)
    if not variance < SURE_RAD2 or abs(sqrt(square) - 1.0) > MAX_GAIN_ERROR + 3.0 * sqrt(along):
        return 0.0, 0.0
    return atan2(s, c), variance


@inner
def _with_kept(zero: Any, measured_rad: float, variance: float) -> tuple[float, float, float]:
    """Return an angle with what was known of it before the start, its variance, and that if nothing had changed since.

    What was known is dropped for good where another zero explains better what was measured: (74).

    Args:
        zero: a `ZERO`.
        measured_rad: the angle as it was measured since.
        variance: of that; 0 where nothing was measured.
    """
    kept_rad, of_kept = zero.kept_rad, zero.kept_variance + zero.kept_change
    if variance == 0.0:
        return kept_rad, of_kept, zero.kept_variance
    apart_rad = _wrapped(measured_rad - kept_rad)
    of_right = zero.zero_variance + zero.mounting_variance + variance
    log_another = max(_log_density(measured_rad, of_right), -log(2.0 * pi) - WRONG_ODDS) + zero.another_log_odds
    if log_another > _log_density(apart_rad, of_kept + variance):
        zero.kept_variance, zero.is_refuted = 0.0, 1
        return measured_rad, variance, variance
    share = of_kept / (of_kept + variance)
    unchanged = zero.kept_variance * variance / (zero.kept_variance + variance)
    return _wrapped(kept_rad + share * apart_rad), share * variance, unchanged


@inner
def _log_density(error: float, variance: float) -> float:
    return -0.5 * (log(2.0 * pi * variance) + error * error / variance)


@inner
def conclude(zero: Any) -> None:
    """Weigh what was measured against what is configured: (59) and (60)."""
    (rates_rad, of_rates), (forces_rad, of_forces) = _angle(zero, 0), _angle(zero, 1)
    measured_rad, variance = rates_rad, of_rates
    zero.is_contradictory = 0
    if of_forces > 0.0:
        measured_rad, variance = forces_rad, of_forces
        if of_rates > 0.0:
            apart_rad = _wrapped(rates_rad - forces_rad)
            if apart_rad * apart_rad > AGREE_SIGMA**2 * (of_rates + of_forces + 2.0 * zero.mounting_variance):
                variance, zero.is_contradictory = 0.0, 1
            else:
                measured_rad = _wrapped(forces_rad + apart_rad * of_forces / (of_rates + of_forces))
                variance = of_rates * of_forces / (of_rates + of_forces)
    is_measured, unchanged = variance > 0.0, variance
    if zero.kept_variance > 0.0 and not zero.is_contradictory:
        measured_rad, variance, unchanged = _with_kept(zero, measured_rad, variance)
    zero.measured_rad, zero.measured_variance = measured_rad, variance if is_measured else 0.0
    if variance == 0.0:
        zero.is_wrong = 0
        zero.correction_rad, zero.correction_variance = 0.0, zero.zero_variance
        return
    unchanged += zero.mounting_variance
    of_right = zero.zero_variance + unchanged
    log_odds = log(sqrt(of_right / (2.0 * pi))) + 0.5 * measured_rad * measured_rad / of_right
    zero.is_wrong = int(log_odds > (RIGHT_ODDS if zero.is_wrong else WRONG_ODDS))
    variance += zero.mounting_variance
    trust = 1.0 if zero.is_wrong else zero.zero_variance / (zero.zero_variance + variance)
    zero.correction_rad, zero.correction_variance = trust * measured_rad, trust * variance


@inner
def correct_slowly(zero: Any, dt_s: float) -> float:
    """Let the correction come in, without a step; return what is left of it [rad]."""
    left_rad = _wrapped(zero.correction_rad - zero.applied_rad)
    step_rad = max(LEAST_RATE_RAD_S, abs(left_rad) / (REFUTED_S if zero.is_refuted else CORRECT_S)) * dt_s
    if abs(left_rad) <= step_rad:
        step_rad, zero.is_refuted = left_rad, 0
    else:
        step_rad = copysign(step_rad, left_rad)
    zero.applied_rad += step_rad
    return left_rad - step_rad


@inner
def _wrapped(angle_rad: float) -> float:
    return angle_rad - 2.0 * pi * round(angle_rad / (2.0 * pi))
