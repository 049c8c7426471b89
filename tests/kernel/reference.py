"""The propagation of a state as GTSAM alone does it: slow, and nothing of it shared with the compiled functions."""

from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.preintegration import ImuNoise, MotionModel, integrate

FOLD_S = 1.0


class Start(NamedTuple):
    nav: gtsam.NavState
    covariance: np.ndarray
    params: gtsam.PreintegrationParams


def transition(pim, nav, bias):
    """F (9, 15), how the state after preintegrated samples depends on the state before and on the biases."""
    by_nav, by_bias = np.empty((9, 9), order="F"), np.empty((9, 6), order="F")
    pim.predict(nav, bias, by_nav, by_bias)
    return np.hstack([by_nav, by_bias])


class Propagation:
    """An optimised state, carried by the samples of a buffer, each as it comes."""

    def __init__(self, config, buffer: ImuBuffer, gravity, state):
        imu = config.imu
        self.buffer, self.bias, self.rate = buffer, state.bias, state.angular_velocity
        self.noise = ImuNoise(imu, config.graph.position_integration_sigma, gravity)
        self.motion = MotionModel(config.motion_model, gravity)
        walk = np.repeat([imu.accelerometer_random_walk, imu.gyroscope_random_walk], 3) ** 2
        self.walk = np.diag([*np.zeros(9), *walk])
        self.begin(state.stamp_ns, state.nav, state.covariance)

    def begin(self, stamp_ns, nav, covariance):
        self.stamp_ns = stamp_ns
        force = self.buffer.samples[self.buffer.record["end"][0] - 1]["force"]
        seen = self.buffer.density(stamp_ns, stamp_ns)
        params = self.noise.params(force - self.bias.accelerometer(), self.rate, nav.attitude(), seen)
        self.start = Start(nav, covariance, params)
        self.pim = gtsam.PreintegratedImuMeasurements(params, self.bias)

    def fold(self, pim):
        start = self.start
        F = transition(pim, start.nav, self.bias)
        covariance = start.covariance + self.walk * pim.deltaTij()
        covariance[:9, :9] = F @ start.covariance @ F.T + pim.residualCovariance()
        covariance[:9, 9:] = F @ start.covariance[:, 9:]
        covariance[9:, :9] = covariance[:9, 9:].T
        self.begin(self.stamp_ns, pim.predict(start.nav, self.bias), covariance)

    def coast(self, stamp_ns):
        self.fold(self.pim)
        duration_s = (stamp_ns - self.stamp_ns) * 1e-9
        self.fold(self.motion.preintegrate(duration_s, self.start.nav, self.rate, self.bias))
        self.stamp_ns, self.from_imu = stamp_ns, False

    def replay(self):
        """Go on to the newest sample of the buffer."""
        for piece in self.buffer.pieces(self.stamp_ns, self.buffer.latest_ns):
            if piece.is_gap:
                self.coast(piece.end_ns)
            else:
                self.add(piece.end_ns)

    def add(self, stamp_ns):
        for step in self.buffer.steps(self.stamp_ns, stamp_ns):
            integrate(self.pim, step, self.bias.accelerometer(), self.bias.gyroscope())
        self.stamp_ns, self.rate = stamp_ns, self.buffer.angular_velocity(stamp_ns) - self.bias.gyroscope()
        self.from_imu = True

    def advance(self, stamp_ns, has_step):
        """Go on to the sample that has just entered the buffer."""
        if not has_step:
            self.coast(stamp_ns)
            return
        self.add(stamp_ns)
        if self.pim.deltaTij() > FOLD_S:
            self.fold(self.pim)

    def predict(self):
        F = transition(self.pim, self.start.nav, self.bias)
        covariance = F @ self.start.covariance @ F.T + self.pim.residualCovariance()
        return self.pim.predict(self.start.nav, self.bias), covariance
