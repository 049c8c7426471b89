"""The IMU path: one sample in, one estimate out.

Between optimisations the newest optimised state is carried forward by the samples since, with its biases and its
covariance; after each optimisation the samples since that node are propagated again (paper, IV-B).
"""

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.estimator.odometry_frame import OdometryFrame
from holdfast.messages import Array
from holdfast.sensors.imu import ImuBuffer, ImuNoise, MotionModel, Step, integrate
from holdfast.state import Estimate, OptimisedState

FOLD_S = 1.0  # the walk of the biases enters the covariance this often


class Predictor:
    """Propagates attitude, position, velocity and their covariance at IMU rate, from `state` on."""

    def __init__(self, config: Config, buffer: ImuBuffer, gravity: float, state: OptimisedState) -> None:
        imu = config.sensors.imu
        self._buffer = buffer
        self._noise = ImuNoise(imu, config.graph.position_integration_sigma, gravity)
        self._motion_model = MotionModel(config.motion_model, gravity)
        walk = np.repeat([imu.accelerometer_random_walk, imu.gyroscope_random_walk], 3) ** 2
        self._bias_walk = np.diag(np.concatenate([np.zeros(9), walk]))
        self._frame = OdometryFrame(config.frames.odometry_policy)
        self._H_nav = np.zeros((9, 9), order="F")
        self._H_bias = np.zeros((9, 6), order="F")
        self._transition = np.zeros((9, 15))
        self._state = state
        self._stamp_ns: int
        self._pim: gtsam.PreintegratedImuMeasurements
        self._base: gtsam.NavState
        self._propagate_again()

    @property
    def stamp_ns(self) -> int:
        """Time that the newest state has reached."""
        return self._stamp_ns

    def anchor(self, state: OptimisedState, *, is_recovery: bool = False) -> None:
        """Continue from a new optimised state: propagate the samples since its stamp again."""
        before = self._nav.pose()
        self._state = state
        self._propagate_again()
        self._frame.correct(before, self._nav.pose(), is_recovery=is_recovery)

    def add(self, stamp_ns: int, step: Step | None) -> Estimate:
        """Carry the state to the newest sample; `step` is None where the IMU was silent before it."""
        before_ns = self._stamp_ns
        if self._buffer.gap_found_ns is not None:
            self._propagate_again()  # samples that looked good were a straight line
        elif step is None:
            self._coast(stamp_ns)
        else:
            self._integrate(step)
            self._stamp_ns = stamp_ns
            if self._pim.deltaTij() > FOLD_S:
                self._fold(self._pim)
        return self._estimate((stamp_ns - before_ns) * 1e-9)

    def _propagate_again(self) -> None:
        state = self._state
        self._rate = state.angular_velocity
        self._from_imu = True
        self._begin(state.stamp_ns, state.nav, state.covariance)
        for piece in self._buffer.pieces(state.stamp_ns, max(state.stamp_ns, self._buffer.latest_ns)):
            if piece.is_gap:
                self._coast(piece.end_ns)
                continue
            for step in self._buffer.steps(piece.start_ns, piece.end_ns):
                self._integrate(step)
            self._stamp_ns = piece.end_ns
        self._nav = self._pim.predict(self._base, state.bias)

    def _integrate(self, step: Step) -> None:
        integrate(self._pim, step, self._bias_accel, self._bias_gyro)
        self._rate = step.angular_velocity - self._bias_gyro
        self._from_imu = True

    def _begin(self, stamp_ns: int, nav: gtsam.NavState, covariance: Array) -> None:
        """Make a state the base of what follows; the noise is that of the motion at the newest sample."""
        bias = self._state.bias
        self._stamp_ns, self._base, self._base_covariance = stamp_ns, nav, covariance
        self._bias_accel, self._bias_gyro = bias.accelerometer(), bias.gyroscope()
        force = self._buffer.latest_force() - self._bias_accel
        self._pim = gtsam.PreintegratedImuMeasurements(self._noise.params(force, self._rate, nav.attitude()), bias)

    def _predict(self, pim: gtsam.PreintegratedImuMeasurements) -> tuple[gtsam.NavState, Array]:
        """Return the state after `pim` and its covariance (9, 9): (8) in docs/math.md."""
        nav = pim.predict(self._base, self._state.bias, self._H_nav, self._H_bias)
        F = self._transition
        F[:, :9], F[:, 9:] = self._H_nav, self._H_bias
        covariance: Array = F @ self._base_covariance @ F.T
        covariance += pim.residualCovariance()
        return nav, covariance

    def _fold(self, pim: gtsam.PreintegratedImuMeasurements) -> None:
        """Make the state after `pim` the new base, so that other noise and the walk of the biases can be added."""
        nav, nav_covariance = self._predict(pim)
        covariance = self._base_covariance + self._bias_walk * pim.deltaTij()
        covariance[:9, 9:] = self._transition @ self._base_covariance[:, 9:]
        covariance[9:, :9] = covariance[:9, 9:].T
        covariance[:9, :9] = nav_covariance
        self._begin(self._stamp_ns, nav, covariance)

    def _coast(self, stamp_ns: int) -> None:
        """Cross a stretch in which the IMU was silent with the motion model."""
        self._fold(self._pim)
        duration_s = (stamp_ns - self._stamp_ns) * 1e-9
        if duration_s > 0.0:
            self._fold(self._motion_model.preintegrate(duration_s, self._base, self._rate, self._state.bias))
        self._stamp_ns, self._from_imu = stamp_ns, False

    def _estimate(self, since_last_s: float) -> Estimate:
        self._nav, covariance = self._predict(self._pim)
        self._frame.flow(self._nav.pose(), since_last_s)
        return Estimate(
            self._stamp_ns,
            self._nav,
            self._frame.T_W_O,
            self._state.bias,
            covariance,
            self._rate,
            self._from_imu,
        )
