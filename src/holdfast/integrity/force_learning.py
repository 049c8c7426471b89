"""Learns how wrong the accelerometer is in motion, from fixes alone: (76) to (78) in docs/math.md.

Three fixes and what the IMU measured between them need neither position nor velocity: whatever these were, they cancel.
What is left over a second is the noise of the fixes, over several seconds the error of the accelerometer; or gravity,
if the attitude is wrong. Of five fixes a tilt that grows evenly cancels, too: they say how large the error is at most.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from math import log
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.smoother import Smoother
from holdfast.integrity.force_scales import ForceScales, Seen
from holdfast.integrity.learnt_snapshot import LearntScale
from holdfast.integrity.point_motion import divided_difference, white_acceleration
from holdfast.messages import Array
from holdfast.sensors.imu import InertialMotion
from holdfast.sensors.noise import Colour
from holdfast.sensors.preintegration import MOTION_CORRELATION_S
from holdfast.sensors.sensor import Position

_NODES, _SHARES = np.polynomial.legendre.leggauss(3)  # exact for polynomials of degree 5
SPANS = 1, 2, 4  # steps between two of three fixes
STEP_NS, MAX_STEP_NS = 900_000_000, 2_500_000_000
MEMORY_S = 600.0
LASTING = 1.5  # times what five fixes see at most: of an error that lasts, more is seen of three


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
        self._scales = {3: ForceScales(carried), 5: ForceScales()}  # by how many fixes are compared
        self._scale, self._learnt = self._tell()
        self._places: deque[_Place] = deque(maxlen=2 * max(SPANS) + 1)

    @property
    def accelerometer_scale(self) -> float:
        """How many times larger the error of the accelerometer in proportion to the motion is than configured."""
        return self._scale

    def learnt(self) -> LearntScale | None:
        """Return what is believed of the accelerometer; None where nothing was taken in."""
        return self._learnt

    def _tell(self) -> tuple[float, LearntScale | None]:
        of_three, found = self._scales[3].accelerometer, self._scales[3].learnt()
        scale = min(of_three, LASTING * self._scales[5].most)
        return scale, found and found.model_copy(update={"log_mean": found.log_mean - log(of_three / scale)})

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
        places, tilted = list(self._places), _Tilted.now(smoother, nav.attitude().matrix())
        for count, scales in self._scales.items():
            for span in SPANS:
                if len(places) > (steps := (count - 1) * span):
                    scales.learn(_compared(places[-1 - steps :], span, tilted, colour), 0.5 / span)
            scales.forget(since_ns * 1e-9 / MEMORY_S)
        self._scale, self._learnt = self._tell()


class _Tilted(NamedTuple):
    """How the machine stands at a fix.

    Attributes:
        R_W_I: attitude (3, 3).
        gravity: [m/s^2].
        variance: of an acceleration in W (3,) [m^2/s^4], given tilt and bias, which are one at rest.
    """

    R_W_I: Array
    gravity: float
    variance: Array

    @classmethod
    def now(cls, smoother: Smoother, R_W_I: Array) -> "_Tilted":
        """Return it, known as well as the newest state."""
        gravity = smoother.imu_noise.gravity
        J = np.concatenate([R_W_I @ gtsam.SO3.Hat(R_W_I.T @ np.array([0.0, 0.0, gravity])), R_W_I], axis=1)
        held = np.r_[0:3, 9:12]
        covariance = smoother.newest.covariance[np.ix_(held, held)]
        return cls(R_W_I, gravity, np.einsum("ij,jk,ik->i", J, covariance, J))


def _compared(places: Sequence[_Place], span: int, tilted: _Tilted, colour: Colour) -> Seen:
    """Compare every span-th fix with what was measured from step to step, as the machine stands at the newest."""
    steps = [place.step for place in places[1:] if place.step is not None]
    times_s = np.cumsum([0.0, *(one.time_s for one in steps)])
    weights = np.zeros(len(places))
    weights[::span] = divided_difference(times_s[::span])
    counted = _Counted.of(times_s, weights)
    R, moved = _moved(steps)
    track = np.array([one.p_W_I for one in places])
    beyond = weights @ track - tilted.R_W_I @ R.T @ (weights @ moved) + [0.0, 0.0, counted.steady_s2 * tilted.gravity]
    density, error, turning = np.array([(one.density, one.error, one.turning) for one in steps]).T
    known = counted.steady_s2**2 * tilted.variance + counted.noise @ density
    known[:2] += tilted.gravity**2 * (counted.tilt @ turning)
    alike = float(weights @ np.exp(-np.abs(times_s[:, None] - times_s) / colour.time_constant_s) @ weights)
    claim = places[len(places) // 2].claim
    return Seen(beyond**2, known, float(counted.noise @ error), colour.white * claim, colour.slow * alike * claim)


class _Counted(NamedTuple):
    """How an acceleration counts in a combination of positions in which neither place nor velocity is left.

    Attributes:
        steady_s2: one that lasts all the time.
        noise: white noise of density 1 in each step (n,) [s^3].
        tilt: gravity tilted by a gyroscope whose noise in each step has density 1 (n,) [s^5].
    """

    steady_s2: float
    noise: Array
    tilt: Array

    @classmethod
    def of(cls, times_s: Array, weights: Array) -> "_Counted":
        """Return that of positions at times (n + 1,)."""
        lengths_s = np.diff(times_s)
        at_s = times_s[:-1, None] + lengths_s[:, None] * 0.5 * (1.0 + _NODES)
        left_s = np.maximum(times_s - at_s[..., None], 0.0)
        steady_s2 = 0.5 * float(weights @ times_s**2)
        tilt = lengths_s * ((steady_s2 - 0.5 * left_s**2 @ weights) ** 2 @ (0.5 * _SHARES))
        return cls(steady_s2, white_acceleration(times_s, weights), tilt)


def _measured(smoother: Smoother, start_ns: int, end_ns: int, nav: gtsam.NavState) -> _Step | None:
    """Return what the IMU measured between two times, at the latter of which a state is known; None in a gap."""
    imu, noise = smoother.imu, smoother.imu_noise
    if not imu.is_trusted(start_ns, end_ns):
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


def _moved(steps: Iterable[_Step]) -> tuple[Array, Array]:
    """Return the attitude (3, 3) after steps that follow each other, and the way after each (n + 1, 3), from 0 on."""
    R, v, p = np.eye(3), np.zeros(3), [np.zeros(3)]
    for time_s, motion, *_ in steps:
        p.append(p[-1] + v * time_s + R @ motion.p)
        v = v + R @ motion.v
        R = R @ motion.R
    return R, np.array(p)


def least_scale(learners: Iterable[ForceLearning]) -> float:
    """Return the scale of the accelerometer: an error of it shows against each receiver that has told anything."""
    return min((one.accelerometer_scale for one in learners if one.learnt() is not None), default=1.0)
