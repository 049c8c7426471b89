"""Odometry alone: its track is aligned with the first state, and never corrected.

It gives the pose at the stamps of the odometry and nowhere else: nothing propagates it from one to the next, so a judge
who asks between them has to interpolate. Extrinsics are applied; roll, pitch, heading and position at the start are
those of the other baselines.
"""

import gtsam
import numpy as np

from holdfast.baselines.baseline import IDENTITY, Baseline
from holdfast.baselines.intake import Intake, PositionFix
from holdfast.baselines.start import StandstillStart, Start
from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.events import EventKind, Outcome
from holdfast.messages import Array, ImuSample, Message
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.odometry import OdometryModel, OdometryNoise, TrackPose
from holdfast.state import Estimate, Output


def make_odometry_alone(config: Config) -> Baseline:
    """Return the first odometry of a machine as a system.

    Raises:
        ConfigError: the machine has no GNSS to start by, or no odometry.
    """
    return Baseline(config, _system)


def _system(config: Config, intake: Intake) -> "OdometryAlone":
    if intake.odometry is None:
        raise ConfigError("sensors: none has `kind: odometry`, so there is none to be judged")
    return OdometryAlone(config, intake, intake.odometry)


class OdometryAlone:
    """The track of one odometry as a system."""

    def __init__(self, config: Config, intake: Intake, odometry: OdometryModel) -> None:
        self._intake = intake
        self._odometry_name = odometry.name
        self._noise = OdometryNoise(odometry)
        self._imu_name = config.imu_name
        self._buffer = ImuBuffer(config.imu)
        self._starter = StandstillStart(config, intake, self._buffer)
        self._start: Start | None = None
        self._last: TrackPose | None = None
        self._T_W_V = gtsam.Pose3()
        self._P = np.zeros((6, 6))

    @property
    def initialised(self) -> bool:
        """Whether it is known where the machine started."""
        return self._start is not None

    @property
    def waiting_for(self) -> str:
        """What keeps it from starting."""
        return self._starter.reason

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""
        if message.sensor == self._odometry_name:
            measurement = self._intake.track_pose(message)
            if measurement is not None and isinstance(measurement.content, TrackPose):
                return self._follow(message.sensor, measurement.content)
        elif self._start is not None:
            self._intake.ignore(message)
        else:
            self._prepare(message)
        return Output()

    def _prepare(self, message: Message) -> None:
        """Collect what the start needs."""
        counts = self._intake.counts
        if isinstance(message, ImuSample) and message.sensor == self._imu_name:
            outcome = self._buffer.check(message)
            counts[message.sensor, outcome] += 1
            if outcome is Outcome.USED:
                self._buffer.add(message)
        elif self._starter.takes_heading(message):
            self._starter.add_heading(message)
        elif message.sensor in self._intake.positions:
            fix = self._intake.position(message)
            if fix is not None and isinstance(fix.content, PositionFix):
                counts[message.sensor, Outcome.BEFORE_START] += 1
                self._start = self._starter.add_fix(fix.content)
                if self._start is not None:
                    self._intake.report(EventKind.INITIALISED, self._start.stamp_ns, "", self._starter.reason)

    def _follow(self, sensor: str, pose: TrackPose) -> Output:
        counts = self._intake.counts
        if self._start is None:
            counts[sensor, Outcome.BEFORE_START] += 1
            return Output()
        last = self._last
        if last is None:
            self._T_W_V = self._start.nav.pose() * pose.T_I0_I.inverse()
            self._P = self._start.covariance[:6, :6]
        elif pose.stamp_ns <= last.stamp_ns:
            counts[sensor, Outcome.LATE] += 1
            return Output()
        else:
            self._drift(last, pose)
        self._last = pose
        counts[sensor, Outcome.USED] += 1
        return Output(self._estimate(last, pose, self._start))

    def _drift(self, last: TrackPose, pose: TrackPose) -> None:
        motion = last.T_I0_I.between(pose.T_I0_I)
        back = motion.inverse().AdjointMap()
        drift = self._noise.drift(motion, (pose.stamp_ns - last.stamp_ns) * 1e-9)
        self._P = back @ self._P @ back.T + np.diag(drift**2)

    def _estimate(self, last: TrackPose | None, pose: TrackPose, start: Start) -> Estimate:
        """Return the state at a pose; the velocities are those of the motion from the pose before."""
        T_W_I = self._T_W_V * pose.T_I0_I
        velocity, rate = np.zeros(3), np.zeros(3)
        if last is not None:
            duration_s = (pose.stamp_ns - last.stamp_ns) * 1e-9
            velocity = (T_W_I.translation() - (self._T_W_V * last.T_I0_I).translation()) / duration_s
            rate = gtsam.Rot3.Logmap(last.T_I0_I.rotation().between(pose.T_I0_I.rotation())) / duration_s
        nav = gtsam.NavState(T_W_I.rotation(), T_W_I.translation(), velocity)
        covariance = self._nav_covariance(1.0 if last is None else (pose.stamp_ns - last.stamp_ns) * 1e-9)
        return Estimate.of(pose.stamp_ns, nav, IDENTITY, start.bias, covariance, rate, False)

    def _nav_covariance(self, interval_s: float) -> Array:
        """Return the covariance (9, 9): drift and the noise of one pose, and of the difference between two."""
        noise = 0.5 * self._noise.covariance(IDENTITY)
        covariance = np.zeros((9, 9))
        covariance[:6, :6] = self._P + noise
        covariance[6:, 6:] = 2.0 * noise[3:, 3:] / interval_s**2
        return covariance
