"""Coming up: at standstill (checked, not assumed) or in motion; refuses bad data and says why.

Standstill gives roll and pitch from gravity, the gyroscope's bias from its mean, the accelerometer's along gravity, and
position through the lever arm (paper, IV-A.5); heading comes from the configuration, a heading message or two
antennas. Without a heading the machine has to move: then a batch of GNSS, IMU and, if there is one, the lidar's track.
"""

from collections import deque

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.graph.alignment import BatchAligner, level_attitude
from holdfast.messages import Array
from holdfast.sensors.gnss import AntennaPosition, GnssModel
from holdfast.sensors.heading import AxisYaw, HeadingModel
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lidar import LidarModel
from holdfast.sensors.preintegration import ImuNoise
from holdfast.sensors.standstill import (
    ENGINE,
    fixes_stand,
    gyro_bias_sigma_rad_s,
    quiet_window,
    standstill_covariance,
)
from holdfast.state import OptimisedState

PLAUSIBLE_FORCE = (7.0, 13.0)  # [m/s^2] mean specific force of a machine on the ground
MIN_TRAVEL_M = 2.0
RETRY_NS = 1_000_000_000
SIMULTANEOUS_NS = 20_000_000


class Initializer:
    """Collects measurements until the first state is certain; `reason` says what is still missing."""

    def __init__(  # noqa: PLR0917 (the sensors that there may be)
        self,
        config: Config,
        buffer: ImuBuffer,
        antennas: dict[str, GnssModel],
        lidar: LidarModel | None,
        heading: HeadingModel | None,
        gravity: float,
    ) -> None:
        imu = config.sensors.imu
        self._config = config
        self._buffer = buffer
        self._antennas = antennas
        self._lidar = lidar
        self._heading_model = heading
        self._gravity = gravity
        self._positions: deque[AntennaPosition] = deque()
        self._headings: deque[AxisYaw] = deque()
        self._track: deque[tuple[int, gtsam.Pose3]] = deque()
        self._bias = gtsam.imuBias.ConstantBias()
        self._bias_sigmas = np.repeat([imu.accelerometer_bias_sigma, imu.gyroscope_bias_sigma], 3)
        self._last_try_ns = 0
        self._noise = ImuNoise(imu, config.graph.position_integration_sigma, gravity)
        self.reason = "no usable GNSS fix has come" if antennas else "no IMU sample has come"

    def add_position(self, position: AntennaPosition) -> None:
        """Take in a checked fix."""
        self._positions.append(position)
        self._forget(position.stamp_ns)

    def add_heading(self, heading: AxisYaw) -> None:
        """Take in a checked heading."""
        self._headings.append(heading)

    def add_track(self, stamp_ns: int, T_I0_I: gtsam.Pose3) -> None:
        """Take in a pose of the IMU along the lidar's track."""
        self._track.append((stamp_ns, T_I0_I))

    def _forget(self, now_ns: int) -> None:
        horizon = now_ns - round(self._config.initialisation.window_s * 1e9)
        while self._positions and self._positions[0].stamp_ns < horizon:
            self._positions.popleft()
        while self._track and self._track[0][0] < horizon:
            self._track.popleft()
        while self._headings and self._headings[0].stamp_ns < horizon:
            self._headings.popleft()

    def attempt(self) -> OptimisedState | None:
        """Return the first state, or None with `reason` set."""
        now = self._buffer.latest_ns
        standstill_s = self._config.initialisation.standstill_s
        recent = self._buffer.window(now - round(standstill_s * 1e9), now)
        if recent is None:
            self.reason = f"the IMU has not been heard without a gap for {standstill_s:g} s"
            return None
        force = float(np.linalg.norm(recent[0].mean(axis=0)))
        if not PLAUSIBLE_FORCE[0] < force < PLAUSIBLE_FORCE[1]:
            hint = ": is the accelerometer in g?" if 0.8 < force < 1.3 else ""
            self.reason = (
                f"mean specific force is {force:.2f} m/s^2, on the ground it is near {self._gravity:.2f}{hint}"
            )
            return None
        quiet = quiet_window(self._config.standstill, self._buffer, now, standstill_s, ENGINE)
        if quiet is not None and self._is_standing(now):
            return self._at_standstill(now, *quiet)
        return self._in_motion(now)

    def _is_standing(self, now_ns: int) -> bool:
        """GNSS must agree that the machine stands: an even motion is as quiet as standstill."""
        if not self._antennas:
            return True
        sensor = next(iter(self._antennas))
        since = now_ns - round(max(3.0, 2 * self._config.initialisation.standstill_s) * 1e9)
        fixes = [p for p in self._positions if p.sensor == sensor and p.stamp_ns >= since]
        stand = fixes_stand(fixes)
        if stand is None:
            self.reason = "waiting for two GNSS fixes at standstill"
        return bool(stand)

    def _at_standstill(self, now_ns: int, force: Array, rate: Array) -> OptimisedState | None:
        imu, standstill_s = self._config.sensors.imu, self._config.initialisation.standstill_s
        level = level_attitude(force)
        excess = (np.linalg.norm(force) - self._gravity) * force / np.linalg.norm(force)
        bias = gtsam.imuBias.ConstantBias(excess, rate)
        gyro_sigma = gyro_bias_sigma_rad_s(imu, standstill_s)
        self._bias, self._bias_sigmas = bias, np.repeat([imu.accelerometer_bias_sigma, gyro_sigma], 3)
        self.reason = "standing still without a heading: give initialisation.heading_deg, a heading topic, or move"
        heading = self._heading(now_ns, level)
        if heading is None:
            return None
        yaw, yaw_sigma = heading
        R_W_I = gtsam.Rot3.Yaw(yaw).compose(level)
        position, position_covariance, arm = self._position(now_ns, R_W_I)
        up, in_imu = force / np.linalg.norm(force), R_W_I.matrix().T @ position_covariance @ R_W_I.matrix()
        covariance = standstill_covariance(imu, standstill_s, self._gravity, up, yaw_sigma, in_imu, arm)
        self.reason = "standstill"
        nav = gtsam.NavState(R_W_I, position, np.zeros(3))
        return OptimisedState(now_ns, nav, bias, covariance, np.zeros(3))

    def _position(self, now_ns: int, R_W_I: gtsam.Rot3) -> tuple[Array, Array, Array]:
        """Return p_W_I, its covariance in W, and the lever arm through which it was found."""
        if not self._antennas:
            return np.zeros(3), np.eye(3) * 1e-4, np.zeros(3)
        sensor = next(iter(self._antennas))
        since = now_ns - round(self._config.initialisation.standstill_s * 1e9)
        fixes = [p for p in self._positions if p.sensor == sensor and p.stamp_ns >= since]
        fixes = fixes or [p for p in self._positions if p.sensor == sensor][-1:]
        mean: Array = np.mean([p.p_W_G for p in fixes], axis=0)
        position: Array = mean - R_W_I.rotate(self._antennas[sensor].p_I_G)
        return position, fixes[-1].covariance, self._antennas[sensor].p_I_G

    def _heading(self, now_ns: int, level: gtsam.Rot3) -> tuple[float, float] | None:
        """Return the heading of the IMU's x axis and its sigma [rad], from the first source that there is."""
        start = self._config.initialisation
        measured = self._measured_heading(level)
        if measured is not None:
            return measured
        if len(self._antennas) == 2:
            baseline = self._baseline_heading(now_ns, level)
            if baseline is not None:
                return baseline
        if start.heading_deg is not None:
            return np.radians(start.heading_deg), np.radians(start.heading_sigma_deg)
        if not self._antennas:
            return 0.0, 1e-3  # W is where the machine starts: heading is zero by definition
        return None

    def _measured_heading(self, level: gtsam.Rot3) -> tuple[float, float] | None:
        """Heading from the newest heading message, against its axis in the levelled IMU frame."""
        if not self._headings or self._heading_model is None:
            return None
        return self._heading_model.of_imu(self._headings[-1], level)

    def _baseline_heading(self, now_ns: int, level: gtsam.Rot3) -> tuple[float, float] | None:
        """Heading from the vector between two antennas, against the same vector in the levelled IMU frame."""
        (left, left_model), (right, right_model) = self._antennas.items()
        arm = level.rotate(right_model.p_I_G - left_model.p_I_G)
        length = float(np.hypot(arm[0], arm[1]))
        since = now_ns - round(max(1.0, self._config.initialisation.standstill_s) * 1e9)
        pairs = [
            (a, b)
            for a in self._positions
            for b in self._positions
            if a.sensor == left and b.sensor == right and a.stamp_ns >= since
            if abs(a.stamp_ns - b.stamp_ns) < SIMULTANEOUS_NS
        ]
        if length < 0.2 or not pairs:
            return None
        baseline = np.mean([b.p_W_G - a.p_W_G for a, b in pairs], axis=0)
        sigma = float(np.sqrt(np.trace(pairs[-1][0].covariance[:2, :2] + pairs[-1][1].covariance[:2, :2]) / 2)) / length
        measured = float(np.linalg.norm(baseline))
        expected = float(np.linalg.norm(arm))
        if abs(measured - expected) > 5.0 * sigma * length + 0.02 * expected:
            self.reason = f"the antennas are {measured:.2f} m apart, the extrinsics say {expected:.2f} m"
            return None
        yaw = float(np.arctan2(baseline[1], baseline[0]) - np.arctan2(arm[1], arm[0]))
        return yaw, max(sigma, 1e-3)

    def _in_motion(self, now_ns: int) -> OptimisedState | None:
        if not self._antennas:
            self.reason = "moving, and no GNSS is configured: start at standstill"
            return None
        fixes = self._covered(now_ns)
        if len(fixes) < 3:
            self.reason = f"{len(fixes)} usable GNSS fixes since the IMU is heard without a gap; 3 are needed"
            return None
        travel = max(_travel_m([fix for fix in fixes if fix.sensor == name]) for name in self._antennas)
        needed = max(MIN_TRAVEL_M, 20.0 * float(np.sqrt(fixes[-1].covariance[:2, :2].max())))
        if travel < needed:
            self.reason = f"moved {travel:.1f} m; a heading from motion needs {needed:.1f} m"
            return None
        if fixes[-1].stamp_ns - self._last_try_ns < RETRY_NS:
            return None
        self._last_try_ns = fixes[-1].stamp_ns
        aligner = BatchAligner(self._buffer, self._noise, self._antennas, self._bias_sigmas)
        limit = np.radians(self._config.initialisation.max_heading_sigma_deg)
        alignment = aligner.solve(fixes, self._bias, self._lidar_factors(fixes), float(limit))
        self.reason = alignment.reason
        return alignment.state

    def _covered(self, now_ns: int) -> list[AntennaPosition]:
        """Fixes since the last IMU gap, at times that the IMU has reached."""
        start = self._buffer.oldest_ns
        for piece in self._buffer.pieces(start, now_ns):
            if piece.is_gap:
                start = piece.end_ns
        return sorted((p for p in self._positions if start < p.stamp_ns <= now_ns), key=lambda p: p.stamp_ns)

    def _lidar_factors(self, fixes: list[AntennaPosition]) -> list[gtsam.NonlinearFactor]:
        """Relative factors between the times of the fixes, from the lidar's track interpolated to them."""
        if self._lidar is None or len(self._track) < 2:
            return []
        stamps = sorted({fix.stamp_ns for fix in fixes})
        poses = [self._track_at(stamp) for stamp in stamps]
        factors = []
        for k in range(len(stamps) - 1):
            before, after = poses[k], poses[k + 1]
            if before is not None and after is not None:
                motion = before.between(after)
                factors.append(self._lidar.factor(gtsam.symbol("x", k), gtsam.symbol("x", k + 1), motion))
        return factors

    def _track_at(self, stamp_ns: int) -> gtsam.Pose3 | None:
        for (t0, T0), (t1, T1) in zip(self._track, list(self._track)[1:], strict=False):
            if t0 <= stamp_ns <= t1:
                return T0.slerp((stamp_ns - t0) / (t1 - t0), T1)
        return None


def _travel_m(fixes: list[AntennaPosition]) -> float:
    """Return how far one antenna has been from its first fix [m]."""
    return max((float(np.linalg.norm(fix.p_W_G - fixes[0].p_W_G)) for fix in fixes), default=0.0)
