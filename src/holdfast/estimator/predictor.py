"""The IMU path: one sample in, one estimate out.

Between optimisations the newest optimised state is carried forward by the samples since, with its biases and its
covariance; after each optimisation the samples since that node are propagated again (paper, IV-B).

What was published goes on beside its successor until the next sample. There the two are compared, and T_W_O takes the
difference: T_O_I arrives where the state published before leads it, whatever has become of position, attitude or
velocity, also where the IMU was silent in between.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.odometry_frame import OdometryFrame
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import ImuNoise, MotionModel, Step, integrate, preintegrate_with
from holdfast.state import Estimate, OptimisedState

FOLD_S = 1.0  # the walk of the biases enters the covariance this often


class Start(NamedTuple):
    """Where a preintegration begins.

    Attributes:
        nav: the state.
        bias: at which what follows is predicted.
        covariance: (15, 15) of state and biases.
        params: the noise of what follows.
    """

    nav: gtsam.NavState
    bias: gtsam.imuBias.ConstantBias
    covariance: Array
    params: gtsam.PreintegrationParams


class LazyCovariance:
    """The covariance (9, 9) after preintegrated samples, computed when it is asked for: (8) in docs/math.md.

    Args:
        start: where they begin.
        pim: the samples, to which others may be added later.
        steps: all that `pim` is made of; the list grows with it.
    """

    __slots__ = ("_made_of", "_value")

    def __init__(self, start: Start, pim: gtsam.PreintegratedImuMeasurements, steps: list[Step]) -> None:
        self._made_of: tuple[Any, ...] | None = start, pim, steps, len(steps)
        self._value: Array

    def __call__(self) -> Array:
        """Return the covariance."""
        if self._made_of is not None:
            start, pim, steps, count = self._made_of
            if len(steps) > count:  # asked after more was added
                pim = preintegrate_with(start.params, steps[:count], start.bias)
            F = transition(pim, start)
            self._value = F @ start.covariance @ F.T
            self._value += pim.residualCovariance()
            self._made_of = None
        return self._value

    def __reduce__(self) -> tuple[Callable[[Array], Array], tuple[Array]]:
        return np.asarray, (self(),)


def transition(pim: gtsam.PreintegratedImuMeasurements, start: Start) -> Array:
    """Return F (9, 15), how the state after preintegrated samples depends on the state before and on the biases."""
    by_nav, by_bias = np.empty((9, 9), order="F"), np.empty((9, 6), order="F")
    pim.predict(start.nav, start.bias, by_nav, by_bias)
    F = np.empty((9, 15))
    F[:, :9], F[:, 9:] = by_nav, by_bias
    return F


class Propagation:
    """An optimised state, carried forward by the samples since; `nav` and `covariance` are those of `stamp_ns`."""

    def __init__(self, config: Config, buffer: ImuBuffer, gravity: float) -> None:
        imu = config.imu
        self._buffer = buffer
        self._noise = ImuNoise(imu, config.graph.position_integration_sigma, gravity)
        self._motion_model = MotionModel(config.motion_model, gravity)
        walk = np.repeat([imu.accelerometer_random_walk, imu.gyroscope_random_walk], 3) ** 2
        self._bias_walk = np.diag(np.concatenate([np.zeros(9), walk]))
        self.state: OptimisedState
        self.stamp_ns: int
        self.rate: Array
        self.from_imu: bool
        self._start: Start
        self._pim: gtsam.PreintegratedImuMeasurements
        self._steps: list[Step]  # that it is made of

    def start(self, state: OptimisedState) -> None:
        """Begin with a state and carry it to the newest sample."""
        self.state = state
        self.rate = state.angular_velocity
        self.from_imu = True
        self._begin(state.stamp_ns, state.nav, state.covariance)
        for piece in self._buffer.pieces(state.stamp_ns, max(state.stamp_ns, self._buffer.latest_ns)):
            if piece.is_gap:
                self._coast(piece.end_ns)
                continue
            for step in self._buffer.steps(piece.start_ns, piece.end_ns):
                self._integrate(step)
            self.stamp_ns, self.rate = piece.end_ns, self._buffer.angular_velocity(piece.end_ns) - self._bias_gyro

    def advance(self, stamp_ns: int, step: Step | None) -> None:
        """Carry the state to a later sample; `step` is None where the IMU was silent before it."""
        if step is None:
            self._coast(stamp_ns)
            return
        missing_ns = stamp_ns - round(step.dt_s * 1e9) - self.stamp_ns
        if missing_ns > 0:
            self._coast(self.stamp_ns + missing_ns)
        elif missing_ns < 0:  # a measurement led the state into this step while the IMU was silent
            step = step._replace(dt_s=(stamp_ns - self.stamp_ns) * 1e-9)
        self._integrate(step)
        self.stamp_ns, self.rate = stamp_ns, self._buffer.latest_rate() - self._bias_gyro
        if self._pim.deltaTij() > FOLD_S:
            self._fold(self._pim)

    def settle(self) -> OptimisedState:
        """Let the state now, with its covariance, take the place of the optimised one."""
        self._fold(self._pim)
        start = self._start
        self.state = OptimisedState(self.stamp_ns, start.nav, start.bias, start.covariance, self.rate)
        return self.state

    def nav(self) -> gtsam.NavState:
        """Return the state now."""
        return self._pim.predict(self._start.nav, self._start.bias)

    def predict(self) -> tuple[gtsam.NavState, LazyCovariance]:
        """Return the state now and its covariance."""
        return self.nav(), LazyCovariance(self._start, self._pim, self._steps)

    def _integrate(self, step: Step) -> None:
        self._steps.append(step)
        integrate(self._pim, step, self._bias_accel, self._bias_gyro)
        self.from_imu = True

    def _begin(self, stamp_ns: int, nav: gtsam.NavState, covariance: Array) -> None:
        """Let something follow a state, with the noise of the motion at the newest sample."""
        bias = self.state.bias
        self.stamp_ns = stamp_ns
        self._bias_accel, self._bias_gyro = bias.accelerometer(), bias.gyroscope()
        force = self._buffer.latest_force() - self._bias_accel
        seen = self._buffer.density(stamp_ns, stamp_ns)
        self._start = Start(nav, bias, covariance, self._noise.params(force, self.rate, nav.attitude(), seen))
        self._pim, self._steps = gtsam.PreintegratedImuMeasurements(self._start.params, bias), []

    def _fold(self, pim: gtsam.PreintegratedImuMeasurements) -> None:
        """Begin anew after `pim`, so that other noise and the walk of the biases can be added."""
        start = self._start
        F = transition(pim, start)
        covariance = start.covariance + self._bias_walk * pim.deltaTij()
        covariance[:9, :9] = F @ start.covariance @ F.T + pim.residualCovariance()
        covariance[:9, 9:] = F @ start.covariance[:, 9:]
        covariance[9:, :9] = covariance[:9, 9:].T
        self._begin(self.stamp_ns, pim.predict(start.nav, start.bias), covariance)

    def _coast(self, stamp_ns: int) -> None:
        """Cross a stretch in which the IMU was silent with the motion model."""
        self._fold(self._pim)
        duration_s = (stamp_ns - self.stamp_ns) * 1e-9
        if duration_s > 0.0:
            start = self._start
            self._fold(self._motion_model.preintegrate(duration_s, start.nav, self.rate, start.bias))
        self.stamp_ns, self.from_imu = stamp_ns, False


class Predictor:
    """Gives attitude, position, velocity and their covariance at IMU rate, from `state` on."""

    def __init__(self, config: Config, buffer: ImuBuffer, gravity: float, state: OptimisedState) -> None:
        self._buffer = buffer
        self._frame = OdometryFrame(config.frames.odometry_policy)
        self._newest = Propagation(config, buffer, gravity)
        self._other = Propagation(config, buffer, gravity)  # what was published, or nothing
        self._is_replaced = self._is_recovery = False
        self._newest.start(state)

    @property
    def stamp_ns(self) -> int:
        """Time that the newest state has reached."""
        return self._newest.stamp_ns

    def anchor(self, state: OptimisedState, *, is_recovery: bool = False) -> None:
        """Continue from a new optimised state: propagate the samples since its stamp again."""
        if not self._is_replaced:
            self._newest, self._other = self._other, self._newest
            self._is_replaced = True
        self._is_recovery |= is_recovery
        self._newest.start(state)

    def settle(self) -> OptimisedState:
        """Let the propagated state take the place of the optimised one, and return it."""
        return self._newest.settle()

    def add(self, stamp_ns: int, step: Step | None, *, is_line: bool = False) -> Estimate:
        """Carry the state to the newest sample.

        Args:
            stamp_ns: of the sample.
            step: to it from the sample before; None where the IMU was silent.
            is_line: the samples until now have turned out to be a straight line.
        """
        newest, before_ns = self._newest, self._newest.stamp_ns
        if is_line:
            self.anchor(newest.state)  # samples that looked good were a straight line
            newest = self._newest
        else:
            newest.advance(stamp_ns, step)
        nav, covariance = newest.predict()
        if self._is_replaced:
            self._other.advance(stamp_ns, step)
            self._frame.correct(self._other.nav().pose(), nav.pose(), is_recovery=self._is_recovery)
            self._is_replaced = self._is_recovery = False
        self._frame.flow(nav.pose(), (stamp_ns - before_ns) * 1e-9)
        return Estimate(
            newest.stamp_ns, nav, self._frame.T_W_O, newest.state.bias, covariance, newest.rate, newest.from_imu
        )
