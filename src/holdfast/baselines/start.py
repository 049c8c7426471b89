"""The first state, from a standstill: what the estimator's initialisation knows, no more and no less.

Roll and pitch from gravity, the gyroscope's bias from its mean, the accelerometer's along gravity, the heading from a
message or two antennas, the position through the lever arm (paper, IV-A.5). None of them can start in motion.
"""

from collections import deque
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.baselines.intake import AntennaFix, Intake
from holdfast.config.model import Config
from holdfast.messages import Array
from holdfast.sensors.heading import AxisYaw, yaw_of
from holdfast.sensors.imu import ImuBuffer

MAX_MEAN_RATE_RAD_S = 0.05  # turning evenly is not standing
BATCHES = 10  # parts of the window whose means are compared
CHANGE_SHARE = 0.1  # of the allowed spread, by which the mean may change within the window
ENGINE = 10.0  # an idling engine shakes so many times as much as a motion may
KEPT_FIXES = 200
SIMULTANEOUS_NS = 20_000_000
STANDSTILL_VELOCITY_SIGMA = 0.05  # [m/s]
GRAVITY_SIGMA = 1e-3  # [m/s^2]
STANDING_SPEED_M_S = 0.1


class Start(NamedTuple):
    """The first state; `covariance` (15, 15) in the order of `holdfast.state`."""

    stamp_ns: int
    nav: gtsam.NavState
    bias: gtsam.imuBias.ConstantBias
    covariance: Array


class StandstillStart:
    """Collects fixes and headings until the machine is seen standing; `reason` says what is missing."""

    def __init__(self, config: Config, intake: Intake, buffer: ImuBuffer) -> None:
        self._config = config
        self._intake = intake
        self._buffer = buffer
        self._fixes: deque[AntennaFix] = deque(maxlen=KEPT_FIXES)
        self._heading: AxisYaw | None = None
        self.reason = "no usable GNSS fix has come"

    def add_heading(self, heading: AxisYaw) -> None:
        """Take in a heading."""
        self._heading = heading

    def add_fix(self, fix: AntennaFix) -> Start | None:
        """Take in a fix; return the first state, or None with `reason` set."""
        self._fixes.append(fix)
        now = self._buffer.latest_ns
        start = self._config.initialisation
        readings = self._buffer.window(now - round(start.standstill_s * 1e9), now)
        if readings is None:
            self.reason = f"the IMU has not been heard without a gap for {start.standstill_s:g} s"
            return None
        force, rate = readings[0].mean(axis=0), readings[1].mean(axis=0)
        still = self._config.standstill
        quiet = _is_quiet(readings[0], still.max_acceleration) and _is_quiet(readings[1], still.max_angular_rate_rad_s)
        if not (quiet and np.linalg.norm(rate) <= MAX_MEAN_RATE_RAD_S and self._fixes_stand(now)):
            self.reason = "the machine has not stood still: the baselines cannot start in motion"
            return None
        g = self._intake.gravity
        level = gtsam.Rot3.RzRyRx(np.arctan2(force[1], force[2]), np.arctan2(-force[0], np.hypot(*force[1:])), 0.0)
        heading = self._yaw(now, level)
        if heading is None:
            self.reason = "standing still without a heading: give initialisation.heading_deg or a heading topic"
            return None
        self.reason = "standstill"
        up = force / np.linalg.norm(force)
        bias = gtsam.imuBias.ConstantBias((np.linalg.norm(force) - g) * up, rate)
        R_W_I = gtsam.Rot3.Yaw(heading[0]).compose(level)
        fixes = self._recent(now, start.standstill_s)
        mean: Array = np.mean([one.position.p_W_G for one in fixes], axis=0)
        nav = gtsam.NavState(R_W_I, mean - R_W_I.rotate(fixes[-1].p_I_G), np.zeros(3))
        R = R_W_I.matrix()
        position_covariance = R.T @ fixes[-1].position.covariance @ R
        return Start(now, nav, bias, self._covariance(up, heading[1], position_covariance, fixes[-1].p_I_G))

    def _recent(self, now_ns: int, window_s: float) -> list[AntennaFix]:
        """Return the fixes of the first antenna within a window before now, or its newest one."""
        first = next(iter(self._intake.antennas))
        of_first = [fix for fix in self._fixes if fix.position.sensor == first]
        recent = [fix for fix in of_first if fix.position.stamp_ns >= now_ns - round(window_s * 1e9)]
        return recent or of_first[-1:]

    def _fixes_stand(self, now_ns: int) -> bool:
        """Whether the fixes stand, too: even motion is as quiet as standstill."""
        fixes = [fix.position for fix in self._recent(now_ns, 3.0)]
        if len(fixes) < 2 or fixes[-1].stamp_ns - fixes[0].stamp_ns < 200_000_000:
            return False
        moved = np.linalg.norm(fixes[-1].p_W_G[:2] - fixes[0].p_W_G[:2])
        noise = 3.0 * np.sqrt(fixes[0].covariance[:2, :2].trace() + fixes[-1].covariance[:2, :2].trace())
        return bool(moved < noise + STANDING_SPEED_M_S * (fixes[-1].stamp_ns - fixes[0].stamp_ns) * 1e-9)

    def _yaw(self, now_ns: int, level: gtsam.Rot3) -> tuple[float, float] | None:
        """Return the heading of the IMU's x axis and its sigma [rad], from the first source that there is."""
        start, model = self._config.initialisation, self._intake.heading
        if self._heading is not None and model is not None:
            axis_yaw = yaw_of(level.rotate(model.axis))
            if axis_yaw is not None:
                return self._heading.yaw_rad - axis_yaw, self._heading.sigma_rad
        if len(self._intake.antennas) == 2:
            between = self._yaw_of_antennas(now_ns, level)
            if between is not None:
                return between
        if start.heading_deg is not None:
            return float(np.radians(start.heading_deg)), float(np.radians(start.heading_sigma_deg))
        return None

    def _yaw_of_antennas(self, now_ns: int, level: gtsam.Rot3) -> tuple[float, float] | None:
        left, right = self._intake.antennas
        since = now_ns - 1_000_000_000
        recent = [fix.position for fix in self._fixes if fix.position.stamp_ns >= since]
        pairs = [
            (a, b)
            for a in recent
            for b in recent
            if a.sensor == left and b.sensor == right and abs(a.stamp_ns - b.stamp_ns) < SIMULTANEOUS_NS
        ]
        arm = level.rotate(self._intake.antennas[right].p_I_G - self._intake.antennas[left].p_I_G)
        length = float(np.hypot(arm[0], arm[1]))
        if not pairs or length < 0.2:
            return None
        between = np.mean([b.p_W_G - a.p_W_G for a, b in pairs], axis=0)
        variance = np.trace(pairs[-1][0].covariance[:2, :2] + pairs[-1][1].covariance[:2, :2]) / 2.0
        yaw = float(np.arctan2(between[1], between[0]) - np.arctan2(arm[1], arm[0]))
        return yaw, max(float(np.sqrt(variance)) / length, 1e-3)

    def _covariance(self, up: Array, yaw_sigma: float, position_covariance: Array, arm: Array) -> Array:
        """Return the covariance (15, 15) of the state: (22) in docs/math.md."""
        imu, standstill_s = self._config.sensors.imu, self._config.initialisation.standstill_s
        g = self._intake.gravity
        noise = imu.accelerometer_noise_density / np.sqrt(standstill_s)
        gyro_sigma = 2.0 * imu.gyroscope_noise_density / np.sqrt(standstill_s) + 1e-5
        along = np.outer(up, up)
        across = np.eye(3) - along
        # columns: what is uncertain, independently; rows: how it shows in the state
        J = np.zeros((15, 18))
        J[:3, :3] = cross_matrix(up) / g  # accelerometer's bias across gravity is taken for tilt
        J[:3, 3:6] = cross_matrix(up) / g
        J[:3, 6:9] = along
        J[3:6, :9] = cross_matrix(arm) @ J[:3, :9]
        J[3:6, 9:12] = np.eye(3)
        J[6:9, 12:15] = np.eye(3)
        J[9:12, :3] = across
        J[9:12, 3:6] = along
        J[12:, 15:] = np.eye(3)
        S = np.zeros((18, 18))
        S[:3, :3] = np.eye(3) * imu.accelerometer_bias_sigma**2
        S[3:6, 3:6] = np.eye(3) * (noise**2 + GRAVITY_SIGMA**2)
        S[6:9, 6:9] = np.eye(3) * yaw_sigma**2
        S[9:12, 9:12] = position_covariance
        S[12:15, 12:15] = np.eye(3) * STANDSTILL_VELOCITY_SIGMA**2
        S[15:, 15:] = np.eye(3) * gyro_sigma**2
        covariance: Array = J @ S @ J.T
        return covariance


def _is_quiet(readings: Array, bound: float) -> bool:
    """Whether readings (N, 3) spread as at standstill: an engine may shake them, but moves no mean of a tenth."""
    means = np.array([part.mean(axis=0) for part in np.array_split(readings, min(BATCHES, len(readings)))])
    half = len(readings) // 2
    change = abs(readings[half:].mean(axis=0) - readings[:half].mean(axis=0))
    spread = means.std(axis=0, ddof=1)
    allowed = CHANGE_SHARE * bound + 3.0 * spread * np.sqrt(4.0 / len(means))
    return bool(spread.max() <= bound and readings.std(axis=0).max() <= ENGINE * bound and (change <= allowed).all())


def cross_matrix(v: Array) -> Array:
    """Return the matrix (3, 3) of the cross product with v (3,)."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
