"""Learns how wrong the accelerometer is in motion, from fixes alone: (76) to (78) in docs/math.md.

Three fixes and what the IMU measured between them need neither position nor velocity: whatever these were, they cancel.
What is left over a second is the noise of the fixes, over several seconds the error of the accelerometer.
"""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.smoother import Smoother
from holdfast.integrity.force_scales import ForceScales, Seen
from holdfast.integrity.learnt_snapshot import LearntScale
from holdfast.messages import Array
from holdfast.sensors.imu import InertialMotion
from holdfast.sensors.noise import Colour
from holdfast.sensors.preintegration import MOTION_CORRELATION_S
from holdfast.sensors.sensor import Position

SPANS = 1, 2, 4  # steps between two of three fixes
STEP_NS, MAX_STEP_NS = 900_000_000, 2_500_000_000
MEMORY_S = 600.0
TILTING = 0.767  # of T^5: how an angle that walks tilts gravity in the middle of three fixes a time T apart


class _Step(NamedTuple):
    """What the IMU measured from one fix to the next.

    Attributes:
        time_s: between the two.
        motion: in the frame where I was at the first.
        density: variance of the white noise of the accelerometer [m^2/s^3].
        error: of what is in proportion to the acceleration, at the configured ratio [m^2/s^3].
        turning: variance of the gyroscope [rad^2/s].
    """

    time_s: float
    motion: InertialMotion
    density: float
    error: float
    turning: float


class _Place(NamedTuple):
    """A fix: where it says that I is (3,), its claim (3,) [m^2], and the step that leads to it."""

    stamp_ns: int
    p_W_I: Array
    claim: Array
    step: _Step | None


class ForceLearning:
    """What the fixes of one receiver say of the accelerometer.

    Args:
        carried: what was learnt of the accelerometer before.
    """

    def __init__(self, carried: LearntScale | None = None) -> None:
        self._scales = ForceScales(carried)
        self._places: deque[_Place] = deque(maxlen=2 * max(SPANS) + 1)

    @property
    def accelerometer_scale(self) -> float:
        """How many times larger the error of the accelerometer in proportion to the motion is than configured."""
        return self._scales.accelerometer

    def learnt(self) -> LearntScale | None:
        """Return what is believed of the accelerometer; None where nothing was taken in."""
        return self._scales.learnt()

    def learn(self, smoother: Smoother, position: Position, beyond: Array, colour: Colour) -> None:
        """Take in a fix that was used and has a node, in the order of stamps.

        Args:
            smoother: whose attitude and biases are used.
            position: the fix.
            beyond: by how much it lies beyond the estimate (3,) [m].
            colour: how its error is composed, before anything was learnt.
        """
        last = self._places[-1] if self._places else None
        since_ns = MAX_STEP_NS if last is None else position.stamp_ns - last.stamp_ns
        if since_ns < STEP_NS:
            return
        nav = smoother.nav(position.stamp_ns)
        step = None
        if last is not None and since_ns <= MAX_STEP_NS:
            step = _measured(smoother, last.stamp_ns, position.stamp_ns, nav)
        if step is None:
            self._places.clear()
        self._places.append(_Place(position.stamp_ns, nav.position() + beyond, position.covariance.diagonal(), step))
        for span in SPANS:
            if len(self._places) > 2 * span:
                self._compare(span, smoother, nav.attitude().matrix(), colour)
        self._scales.forget(since_ns * 1e-9 / MEMORY_S)

    def _compare(self, span: int, smoother: Smoother, R_W_I: Array, colour: Colour) -> None:
        """Compare the newest fix and the two that came one and two spans before it; attitude (3, 3) at the newest."""
        first, middle, newest = (self._places[k] for k in (-1 - 2 * span, -1 - span, -1))
        steps = [place.step for place in list(self._places)[-2 * span :] if place.step is not None]
        whole, half = _joined(steps), _joined(steps[:span])
        total_s, half_s = sum(one.time_s for one in steps), sum(one.time_s for one in steps[:span])
        ratio = total_s / half_s
        lever_s2 = 0.5 * (total_s**2 - ratio * half_s**2)  # by which a constant acceleration counts
        fallen = np.array([0.0, 0.0, lever_s2 * smoother.imu_noise.gravity])
        at_first = R_W_I @ whole.R.T
        seen = (newest.p_W_I - first.p_W_I) - ratio * (middle.p_W_I - first.p_W_I)
        beyond = seen - (at_first @ (whole.p - ratio * half.p) - fallen)
        density, error, turning = _integrated(steps, half_s, total_s)
        known = lever_s2**2 * _acceleration_variance(smoother, R_W_I) + density
        known += smoother.imu_noise.gravity**2 * turning * TILTING * half_s**5 / total_s * np.array([1.0, 1.0, 0.0])
        weights = np.array([ratio - 1.0, -ratio, 1.0])
        at_s = np.array([0.0, half_s, total_s])
        alike = float(weights @ np.exp(-np.abs(at_s[:, None] - at_s) / colour.time_constant_s) @ weights)
        white = colour.white * float(weights @ weights) * middle.claim
        slow = colour.slow * alike * middle.claim
        self._scales.learn(Seen(beyond**2, known, error, white, slow), 0.5 / span)


def _measured(smoother: Smoother, start_ns: int, end_ns: int, nav: gtsam.NavState) -> _Step | None:
    """Return what the IMU measured between two times, at the latter of which a state is known; None in a gap."""
    imu, noise = smoother.imu, smoother.imu_noise
    if start_ns < imu.oldest_ns or not imu.is_trusted(start_ns, end_ns):
        return None
    time_s = (end_ns - start_ns) * 1e-9
    bias: Array = smoother.newest.bias.vector()
    motion = imu.motion(start_ns, end_ns, bias)
    forces, rates, lengths_s = imu.readings(start_ns, end_ns)
    up = nav.attitude().unrotate(np.array([0.0, 0.0, noise.gravity]))
    share = (np.cumsum(lengths_s) / time_s)[:, None]
    ups = (1.0 - share) * (motion.R @ up) + share * up  # gravity in the axes of I, from the start to the end
    accelerated = float(lengths_s @ ((forces - bias[:3] - ups) ** 2).sum(axis=1)) / time_s
    turned = float(lengths_s @ ((rates - bias[3:]) ** 2).sum(axis=1)) / time_s
    config = noise.config
    seen = imu.density(start_ns, end_ns)
    return _Step(
        time_s,
        motion,
        max(config.accelerometer_noise_density, seen.accelerometer) ** 2,
        MOTION_CORRELATION_S * config.accelerometer_error_ratio**2 * accelerated,
        config.gyroscope_noise_density**2 + MOTION_CORRELATION_S * config.gyroscope_error_ratio**2 * turned,
    )


def _joined(steps: list[_Step]) -> InertialMotion:
    """Return what the IMU measured over steps that follow each other."""
    R, v, p = np.eye(3), np.zeros(3), np.zeros(3)
    for time_s, motion, *_ in steps:
        p = p + v * time_s + R @ motion.p
        v = v + R @ motion.v
        R = R @ motion.R
    return InertialMotion(R, v, p)


def _integrated(steps: list[_Step], half_s: float, total_s: float) -> tuple[float, float, float]:
    """Return what white noise, proportional errors [m^2] and the gyroscope [rad^2] come to.

    An acceleration at t counts with h(t), which rises from 0 at the first fix to the middle one, and falls to the last.
    """
    density, error, turning, at_s = 0.0, 0.0, 0.0, 0.0
    for step in steps:
        before, after = _counted(at_s, half_s, total_s), _counted(at_s + step.time_s, half_s, total_s)
        squared = (before**2 + before * after + after**2) / 3.0 * step.time_s
        density += squared * step.density
        error += squared * step.error
        turning += step.turning * step.time_s
        at_s += step.time_s
    return density, error, turning


def _counted(at_s: float, half_s: float, total_s: float) -> float:
    return (total_s - at_s) - (total_s / half_s * (half_s - at_s) if at_s < half_s else 0.0)


def _acceleration_variance(smoother: Smoother, R_W_I: Array) -> Array:
    """Return how well the acceleration in W is known (3,) [m^2/s^4], given tilt and bias, which are one at rest."""
    up = R_W_I.T @ np.array([0.0, 0.0, smoother.imu_noise.gravity])
    J = np.concatenate([R_W_I @ gtsam.SO3.Hat(up), R_W_I], axis=1)
    held = np.r_[0:3, 9:12]
    variance: Array = np.einsum("ij,jk,ik->i", J, smoother.newest.covariance[np.ix_(held, held)], J)
    return variance


def least_scale(learners: Iterable[ForceLearning]) -> float:
    """Return the scale of the accelerometer: an error of it shows against each receiver that has told anything."""
    return min((one.accelerometer_scale for one in learners if one.learnt() is not None), default=1.0)
