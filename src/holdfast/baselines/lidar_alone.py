"""Lidar odometry alone: laid upon the first state, and never corrected.

It says where the machine is at the stamps of the lidar's poses and nowhere else: nothing carries it from one to the
next, so a judge who asks between them has to interpolate. Extrinsics are applied; roll, pitch, heading and position at
the start are those of the other baselines.
"""

import gtsam
import numpy as np

from holdfast.baselines.baseline import NO_OFFSET, Baseline
from holdfast.baselines.intake import AntennaFix, TrackPose
from holdfast.baselines.start import Start
from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.messages import Array, GnssFix, Heading, ImuSample, LidarPose, Message
from holdfast.sensors.lidar import LidarModel
from holdfast.state import Estimate, EventKind, Outcome, Output


class LidarAlone(Baseline):
    """The odometry's track behind the estimator's interface.

    Raises:
        ConfigError: the machine has no GNSS to start by, or no lidar.
    """

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        if self._intake.lidar is None:
            raise ConfigError("sensors.lidar: there is none, so its odometry cannot be judged")
        self._lidar: LidarModel = self._intake.lidar
        self._start: Start | None = None
        self._last: TrackPose | None = None
        self._T_W_V = gtsam.Pose3()
        self._P = np.zeros((6, 6))

    @property
    def initialised(self) -> bool:
        """Whether it is known where the machine started."""
        return self._start is not None

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""
        if isinstance(message, LidarPose):
            measurement = self._intake.track_pose(message)
            if measurement is not None and isinstance(measurement.content, TrackPose):
                return self._follow(message.sensor, measurement.content)
        elif self._start is not None:
            self.counts[message.sensor, Outcome.IGNORED] += 1
        else:
            self._prepare(message)
        return Output()

    def _prepare(self, message: Message) -> None:
        """Use what the others start by."""
        if isinstance(message, ImuSample) and message.sensor == "imu":
            outcome = self._buffer.check(message)
            self.counts[message.sensor, outcome] += 1
            if outcome is Outcome.USED:
                self._buffer.add(message)
        elif isinstance(message, Heading):
            self._start_by(message)
        elif isinstance(message, GnssFix):
            fix = self._intake.fix(message)
            if fix is not None and isinstance(fix.content, AntennaFix):
                self.counts[message.sensor, Outcome.BEFORE_START] += 1
                self._start = self._starter.add_fix(fix.content)
                if self._start is not None:
                    self._intake.tell(EventKind.INITIALISED, self._start.stamp_ns, "", self._starter.reason)

    def _follow(self, sensor: str, pose: TrackPose) -> Output:
        if self._start is None:
            self.counts[sensor, Outcome.BEFORE_START] += 1
            return Output()
        last = self._last
        if last is None:
            self._T_W_V = self._start.nav.pose() * pose.T_V_I.inverse()
            self._P = self._start.covariance[:6, :6]
        elif pose.stamp_ns <= last.stamp_ns:
            self.counts[sensor, Outcome.LATE] += 1
            return Output()
        else:
            self._drift(last, pose)
        self._last = pose
        self.counts[sensor, Outcome.USED] += 1
        return Output(self._estimate(last, pose, self._start))

    def _drift(self, last: TrackPose, pose: TrackPose) -> None:
        motion = last.T_V_I.between(pose.T_V_I)
        back = motion.inverse().AdjointMap()
        drift = self._lidar.drift(motion, (pose.stamp_ns - last.stamp_ns) * 1e-9)
        self._P = back @ self._P @ back.T + np.diag(drift**2)

    def _estimate(self, last: TrackPose | None, pose: TrackPose, start: Start) -> Estimate:
        """Return the state at a pose; velocity and turning are those of the motion from the one before."""
        T_W_I = self._T_W_V * pose.T_V_I
        velocity, rate = np.zeros(3), np.zeros(3)
        if last is not None:
            duration_s = (pose.stamp_ns - last.stamp_ns) * 1e-9
            velocity = (T_W_I.translation() - (self._T_W_V * last.T_V_I).translation()) / duration_s
            rate = gtsam.Rot3.Logmap(last.T_V_I.rotation().between(pose.T_V_I.rotation())) / duration_s
        nav = gtsam.NavState(T_W_I.rotation(), T_W_I.translation(), velocity)
        covariance = self._nav_covariance(1.0 if last is None else (pose.stamp_ns - last.stamp_ns) * 1e-9)
        return Estimate(pose.stamp_ns, nav, NO_OFFSET, start.bias, covariance, rate, False)

    def _nav_covariance(self, interval_s: float) -> Array:
        """Return the covariance (9, 9): drift and the noise of one scan, and of the difference between two."""
        scan = 0.5 * self._lidar.covariance(NO_OFFSET)
        covariance = np.zeros((9, 9))
        covariance[:6, :6] = self._P + scan
        covariance[6:, 6:] = 2.0 * scan[3:, 3:] / interval_s**2
        return covariance
