"""Sensor readings as numbers, for a program that has no messages."""

from time import monotonic_ns, time_ns
from typing import Protocol

from numpy.typing import ArrayLike

from holdfast.config.model import Config
from holdfast.config.sensors import BaseImuConfig, DriftingConfig, GnssConfig, HeadingConfig, JointConfig
from holdfast.measured_fields import array_of
from holdfast.messages import Array, FixStatus, GnssFix, Heading, ImuSample, JointAngle, Message, SensorPose
from holdfast.state import Output

CLOCK_NS = time_ns() - monotonic_ns()  # arrivals go on evenly when the clock of this machine is set


class Intake(Protocol):
    """What both engines take in beside messages: `add_*` makes a message and processes it."""

    config: Config

    def process(self, message: Message) -> Output:
        """Take in one message, in the order of arrival."""

    def add_imu(
        self, stamp_ns: int, angular_velocity: ArrayLike, specific_force: ArrayLike, arrival_ns: int | None = None
    ) -> Output:
        """Take in a sample of the primary IMU: (3,) [rad/s] and (3,) [m/s^2], as in `ImuSample`.

        Here as in what follows, `arrival_ns` is the time at which it came; now, if it is left out. `sensor` is the name
        in the configuration; it may be left out where there is one of the kind. Other kinds go through `process`.

        Raises:
            MessageError: an argument has another type or shape; the text names it.
            ConfigError: the configuration has no such sensor, or several.
            EstimatorError: the estimator is closed.
        """
        readings = _readings(angular_velocity, specific_force)
        return self.process(ImuSample(stamp_ns, _arrival(arrival_ns), self.config.imu_name, *readings))

    def add_gnss(
        self,
        stamp_ns: int,
        latitude_deg: float,
        longitude_deg: float,
        altitude_m: float,
        *,
        covariance: ArrayLike | None = None,
        status: FixStatus = FixStatus.GBAS,
        sensor: str | None = None,
        arrival_ns: int | None = None,
    ) -> Output:
        """Take in a fix of an antenna, with its covariance (3, 3) [m^2], as in `GnssFix`."""
        name, point = self.config.only(GnssConfig, sensor), (latitude_deg, longitude_deg, altitude_m)
        known = None if covariance is None else array_of(covariance, (3, 3), "covariance", "m^2")
        return self.process(GnssFix(stamp_ns, _arrival(arrival_ns), name, *point, known, status))

    def add_heading(
        self,
        stamp_ns: int,
        yaw_rad: float,
        sigma_rad: float | None = None,
        *,
        sensor: str | None = None,
        arrival_ns: int | None = None,
    ) -> Output:
        """Take in a heading: 0 is east, counter-clockwise, as in `Heading`."""
        name = self.config.only(HeadingConfig, sensor)
        return self.process(Heading(stamp_ns, _arrival(arrival_ns), name, yaw_rad, sigma_rad))

    def add_odometry(
        self,
        stamp_ns: int,
        position: ArrayLike,
        quaternion: ArrayLike,
        *,
        covariance: ArrayLike | None = None,
        sensor: str | None = None,
        arrival_ns: int | None = None,
    ) -> Output:
        """Take in a pose of an odometry: (3,) [m], (4,) x, y, z, w, covariance (6, 6), as in `SensorPose`."""
        name = self.config.only(DriftingConfig, sensor)
        pose = array_of(position, (3,), "position", "m"), array_of(quaternion, (4,), "quaternion", "x, y, z, w")
        known = None if covariance is None else array_of(covariance, (6, 6), "covariance", "rad^2, then m^2")
        return self.process(SensorPose(stamp_ns, _arrival(arrival_ns), name, *pose, known))

    def add_joint(self, stamp_ns: int, angle_rad: float, arrival_ns: int | None = None) -> Output:
        """Take in the angle of the turn joint, as in `JointAngle`."""
        return self.process(JointAngle(stamp_ns, _arrival(arrival_ns), self.config.only(JointConfig, None), angle_rad))

    def add_base_imu(
        self, stamp_ns: int, angular_velocity: ArrayLike, specific_force: ArrayLike, arrival_ns: int | None = None
    ) -> Output:
        """Take in a sample of the IMU on the chassis, as `add_imu`."""
        name, readings = self.config.only(BaseImuConfig, None), _readings(angular_velocity, specific_force)
        return self.process(ImuSample(stamp_ns, _arrival(arrival_ns), name, *readings))


def _arrival(arrival_ns: int | None) -> int:
    return CLOCK_NS + monotonic_ns() if arrival_ns is None else arrival_ns  # 0 is where a simulated clock begins


def _readings(angular_velocity: ArrayLike, specific_force: ArrayLike) -> tuple[Array, Array]:
    rate = array_of(angular_velocity, (3,), "angular_velocity", "rad/s")
    return rate, array_of(specific_force, (3,), "specific_force", "m/s^2")
