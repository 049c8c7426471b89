"""MSF: a loosely coupled error-state extended Kalman filter.

Lynen, Achtelik, Weiss, Chli, Siegwart, "A robust and modular multi-sensor fusion approach applied to MAV navigation",
IROS 2013. The IMU predicts; positions of all antennas and poses of the odometry correct. The odometry's frame V
drifts against W, so its pose T_W_V is part of the state, as the paper's drift states are.

The error state (21,) is that of `holdfast.state` (attitude, position, velocity, biases of accelerometer and gyroscope)
followed by the tangent of T_W_V; every part in the body frame of what it belongs to.
"""

from math import inf

import gtsam
import numpy as np

from holdfast.baselines.baseline import Baseline
from holdfast.baselines.filtering import FilterSystem
from holdfast.baselines.intake import Intake, Measurement, PositionFix
from holdfast.baselines.propagation import Propagation, Tuning
from holdfast.baselines.start import Start
from holdfast.config.model import Config
from holdfast.events import Outcome
from holdfast.messages import Array
from holdfast.sensors.odometry import OdometryModel, OdometryNoise, TrackPose

NO_MOTION = gtsam.Pose3()
POSE, BIAS, TRACK = slice(0, 6), slice(9, 15), slice(15, 21)
CHI_SQUARE_3, CHI_SQUARE_6 = 16.27, 22.46  # one good measurement in a thousand exceeds them


class MsfBelief:
    """State and covariance `P` (21, 21); `T_W_V` is None, and its part of `P` zero, before the first odometry."""

    __slots__ = ("P", "T_W_V", "bias", "bias_accel", "bias_gyro", "nav", "stamp_ns", "track")

    def __init__(self, stamp_ns: int, nav: gtsam.NavState, bias: gtsam.imuBias.ConstantBias, P: Array) -> None:
        self.stamp_ns, self.nav, self.P = stamp_ns, nav, P
        self.T_W_V: gtsam.Pose3 | None = None
        self.track: TrackPose | None = None  # the last one, since which V has drifted
        self.set_bias(bias)

    def set_bias(self, bias: gtsam.imuBias.ConstantBias) -> None:
        """Set the bias and its two halves."""
        self.bias, self.bias_accel, self.bias_gyro = bias, bias.accelerometer(), bias.gyroscope()

    def copy(self) -> "MsfBelief":
        """Return a copy that goes on by itself."""
        twin = MsfBelief.__new__(MsfBelief)
        twin.stamp_ns, twin.nav, twin.P = self.stamp_ns, self.nav, self.P.copy()
        twin.T_W_V, twin.track = self.T_W_V, self.track
        twin.bias, twin.bias_accel, twin.bias_gyro = self.bias, self.bias_accel, self.bias_gyro
        return twin

    def nav_covariance(self) -> Array:
        """Return the covariance (9, 9) of `nav`."""
        return self.P[:9, :9].copy()

    def covariance(self) -> Array:
        """Return the covariance (15, 15) of `nav` and `bias`."""
        return self.P[:15, :15].copy()


class MsfFilter:
    """Prediction and update; without `odometry` only positions correct."""

    def __init__(self, odometry: OdometryModel | None, tuning: Tuning) -> None:
        if odometry is not None:
            self._pose_noise = 0.5 * OdometryNoise(odometry).covariance(NO_MOTION)  # half of that between two poses
            self._max_interval_ns = odometry.max_interval_ns
        self._inflation = tuning.fix_inflation
        self._limits = (CHI_SQUARE_3, CHI_SQUARE_6) if tuning.rejects_outliers else (inf, inf)
        walk = [tuning.track_walk_rad_per_sqrt_s, tuning.track_walk_m_per_sqrt_s]
        self._track_walk = np.repeat(walk, 3) ** 2
        self._F = np.eye(21)
        self._product = np.zeros((21, 21))

    def predict(self, belief: MsfBelief, model: Propagation) -> None:
        """P <- F P F^T + Q."""
        F, P = self._F, belief.P
        F[:9, :15] = model.F[:9]
        np.matmul(F, P, out=self._product)
        np.matmul(self._product, F.T, out=P)
        P[:9, :9] += model.Q
        P.ravel()[9 * 22 : 15 * 22 : 22] += model.walk  # the diagonal of the biases

    def update(self, belief: MsfBelief, measurement: Measurement) -> Outcome:
        """Take in a position or a pose of the odometry, unless the chi-square test rejects it."""
        if isinstance(measurement.content, PositionFix):
            return self._update_position(belief, measurement.content)
        return self._update_pose(belief, measurement.content)

    def _update_position(self, belief: MsfBelief, fix: PositionFix) -> Outcome:
        """Update with z = p_W_I + R_W_I p_I_P, whose derivative by the error state is [-R (p_I_P)x, R, 0]."""
        R = belief.nav.attitude().matrix()
        innovation = fix.position.p_W_P - belief.nav.position() - R @ fix.p_I_P
        H = np.zeros((3, 21))
        H[:, :3], H[:, 3:6] = -R @ gtsam.SO3.Hat(fix.p_I_P), R
        noise = fix.position.covariance
        return correct(belief, innovation, H, noise, self._inflation, self._limits[0])

    def _update_pose(self, belief: MsfBelief, pose: TrackPose) -> Outcome:
        """Update with z = T_W_V^-1 T_W_I, whose derivatives are the identity and minus the adjoint of z^-1."""
        noise = self._pose_noise
        T_W_I = belief.nav.pose()
        last, belief.track = belief.track, pose
        if last is None or belief.T_W_V is None or pose.stamp_ns - last.stamp_ns > self._max_interval_ns:
            self._begin_track(belief, T_W_I, pose.T_I0_I, noise)
            return Outcome.USED
        walk = self._track_walk * (pose.stamp_ns - last.stamp_ns) * 1e-9
        belief.P.ravel()[15 * 22 :: 22] += walk  # the diagonal of T_W_V
        predicted = belief.T_W_V.between(T_W_I)
        innovation: Array = gtsam.Pose3.Logmap(predicted.between(pose.T_I0_I))
        H = np.zeros((6, 21))
        H[:, POSE], H[:, TRACK] = np.eye(6), -predicted.inverse().AdjointMap()
        return correct(belief, innovation, H, noise, 1.0, self._limits[1])

    def _begin_track(self, belief: MsfBelief, T_W_I: gtsam.Pose3, T_I0_I: gtsam.Pose3, noise: Array) -> None:
        """Place V by the present pose, with whose error that of V is correlated."""
        belief.T_W_V = T_W_I * T_I0_I.inverse()
        adjoint = T_I0_I.AdjointMap()
        P = belief.P
        P[TRACK, :15] = adjoint @ P[POSE, :15]
        P[:15, TRACK] = P[TRACK, :15].T
        P[TRACK, TRACK] = adjoint @ (P[POSE, POSE] + noise) @ adjoint.T


def correct(  # noqa: PLR0917 (the symbols of the update)
    belief: MsfBelief, innovation: Array, H: Array, noise: Array, inflation: float, limit: float
) -> Outcome:
    """Do the Kalman update in Joseph's form, if the innovation passes the chi-square test.

    Args:
        belief: is changed.
        innovation: (d,) measured minus predicted.
        H: (d, 21) derivative of the measurement by the error state.
        noise: (d, d) of a single measurement, by which it is tested.
        inflation: of its covariance, because the errors of its neighbours are correlated.
        limit: of the normalised innovation squared.
    """
    P = belief.P
    PHt = P @ H.T
    predicted = H @ PHt
    if innovation @ np.linalg.solve(predicted + noise, innovation) > limit:
        return Outcome.INNOVATION
    R = inflation * noise
    K = np.linalg.solve(predicted + R, PHt.T).T
    A = -K @ H
    A.ravel()[::22] += 1.0
    belief.P = A @ P @ A.T + K @ R @ K.T
    dx = K @ innovation
    belief.nav = belief.nav.retract(dx[:9])
    belief.set_bias(gtsam.imuBias.ConstantBias(belief.bias_accel + dx[9:12], belief.bias_gyro + dx[12:15]))
    if belief.T_W_V is not None:
        belief.T_W_V = belief.T_W_V.retract(dx[TRACK])
    return Outcome.USED


MSF_TUNING = Tuning(fix_inflation=30.0, track_walk_m_per_sqrt_s=0.015, track_walk_rad_per_sqrt_s=1e-3)


def make_msf(config: Config, tuning: Tuning = MSF_TUNING) -> Baseline:
    """Return MSF for a machine.

    Raises:
        ConfigError: the machine measures no position.
    """
    return Baseline(config, lambda config, intake: FilterSystem(config, intake, _start, True, tuning))


def _start(tuning: Tuning, intake: Intake, start: Start) -> tuple[MsfFilter, MsfBelief]:
    P = np.zeros((21, 21))
    P[:15, :15] = start.covariance
    return MsfFilter(intake.odometry, tuning), MsfBelief(start.stamp_ns, start.nav, start.bias, P)
