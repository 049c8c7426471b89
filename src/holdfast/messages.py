"""What the sensors say, decoded: one frozen dataclass per kind of measurement.

`stamp_ns` is the time of measurement on the sensor's clock, `arrival_ns` the time at which the recording or the live
transport received it; both are nanoseconds since the epoch. `sensor` is the sensor's name in the configuration.

A message whose fields have another type or shape than stands here raises `MessageError`. What is not finite passes,
and the estimator counts it.

A message knows its own row of numbers, `of(stamp_ns, arrival_ns, sensor, values())`, so that it can cross a border
between processes without anyone else knowing what it holds; `WIDTH` is the length of that row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import MessageError
from holdfast.measured_fields import (
    LIMIT_NS,
    Quantity,
    check_message,
    got,
    optional_matrix,
    optional_number,
    optional_row,
)

Array = NDArray[np.float64]
Row = tuple[float, ...]
AXES = (3,)


class Message(Protocol):
    """What all measurements have; the row holds every bit of the measurement beside its times and its sensor."""

    WIDTH: ClassVar[int]

    @property
    def stamp_ns(self) -> int:
        """Return the time of measurement, on the sensor's clock."""

    @property
    def arrival_ns(self) -> int:
        """Return the time of reception."""

    @property
    def sensor(self) -> str:
        """Return the sensor's name in the configuration."""

    def values(self) -> Row:
        """Return the measurement as a row of `WIDTH` numbers."""

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the message that has a row."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One reading of an inertial measurement unit, expressed in the IMU's own frame.

    Attributes:
        angular_velocity: (3,) [rad/s].
        specific_force: (3,) [m/s^2]; +9.81 along the up axis at rest (REP-145).
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    angular_velocity: Array
    specific_force: Array
    WIDTH: ClassVar[int] = 6
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "angular_velocity": Quantity((3,), "rad/s"),
        "specific_force": Quantity((3,), "m/s^2"),
    }

    def __post_init__(self) -> None:
        # hundreds a second: of a sound sample no more is asked than this
        try:
            is_sound = self.stamp_ns.__class__ is int is self.arrival_ns.__class__  # a truth value is none
            is_sound = is_sound and -LIMIT_NS <= (self.stamp_ns | self.arrival_ns) < LIMIT_NS
            if is_sound and self.angular_velocity.shape == AXES == self.specific_force.shape:
                return
        except (AttributeError, TypeError):
            pass
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return angular velocity and specific force."""
        return (*self.angular_velocity.tolist(), *self.specific_force.tolist())

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float] | Array) -> Self:
        """Return the sample that has a row."""
        readings = np.array(values)
        return cls(stamp_ns, arrival_ns, sensor, readings[:3], readings[3:])


class FixStatus(IntEnum):
    """Quality of a GNSS fix, numbered as sensor_msgs/NavSatStatus; RTK receivers report GBAS when fixed."""

    UNKNOWN = -2
    NO_FIX = -1
    FIX = 0
    SBAS = 1
    GBAS = 2


STATUSES = frozenset(FixStatus)


@dataclass(frozen=True, slots=True, eq=False)
class GnssFix:
    """Position of one GNSS antenna on the WGS84 ellipsoid.

    Attributes:
        covariance: (3, 3) east, north, up [m^2] as the receiver reports it, or None where it is unknown.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    covariance: Array | None
    status: FixStatus
    WIDTH: ClassVar[int] = 4 + 10
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "latitude_deg": Quantity((), "deg"),
        "longitude_deg": Quantity((), "deg"),
        "altitude_m": Quantity((), "m"),
        "covariance": Quantity((3, 3), "m^2", may_be_none=True),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)
        if not _is_status(self.status):
            allowed = ", ".join(f"{status.value} {status.name}" for status in FixStatus)
            raise MessageError(f"GnssFix.status: must be one of {allowed}, {got(self.status)}")

    def values(self) -> Row:
        """Return latitude, longitude, altitude, status and the covariance."""
        point = self.latitude_deg, self.longitude_deg, self.altitude_m
        return (*point, float(self.status), *optional_row(self.covariance, 9))

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the fix that has a row."""
        latitude_deg, longitude_deg, altitude_m, status = values[:4]
        point = latitude_deg, longitude_deg, altitude_m
        return cls(stamp_ns, arrival_ns, sensor, *point, optional_matrix(values[4:], 3), FixStatus(int(status)))


@dataclass(frozen=True, slots=True, eq=False)
class GnssVelocity:
    """Velocity of one GNSS antenna, by Doppler.

    Attributes:
        velocity: (3,) east, north, up [m/s].
        covariance: (3, 3) [m^2/s^2] as the receiver reports it, per axis not finite or not positive where it does not
            measure; or None where it is unknown.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    velocity: Array
    covariance: Array | None
    WIDTH: ClassVar[int] = 3 + 10
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "velocity": Quantity((3,), "m/s"),
        "covariance": Quantity((3, 3), "m^2/s^2", may_be_none=True),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return the velocity and its covariance."""
        return (*self.velocity.tolist(), *optional_row(self.covariance, 9))

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the velocity that has a row."""
        return cls(stamp_ns, arrival_ns, sensor, np.array(values[:3]), optional_matrix(values[3:], 3))


@dataclass(frozen=True, slots=True, eq=False)
class SensorPose:
    """Pose of a sensor in the frame of whoever measured it: where an odometry started, or that of a map.

    Attributes:
        position: (3,) [m].
        quaternion: (4,) x, y, z, w, of unit norm.
        covariance: (6, 6) of the tangent in GTSAM's order (rotation [rad], then translation [m]), or None.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    position: Array
    quaternion: Array
    covariance: Array | None
    WIDTH: ClassVar[int] = 7 + 37
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "position": Quantity((3,), "m"),
        "quaternion": Quantity((4,), "x, y, z, w"),
        "covariance": Quantity((6, 6), "rad^2, then m^2", may_be_none=True),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return position, quaternion and the covariance."""
        return (*self.position.tolist(), *self.quaternion.tolist(), *optional_row(self.covariance, 36))

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the pose that has a row."""
        position, quaternion = np.array(values[:3]), np.array(values[3:7])
        return cls(stamp_ns, arrival_ns, sensor, position, quaternion, optional_matrix(values[7:], 6))


@dataclass(frozen=True, slots=True, eq=False)
class Heading:
    """Yaw of a body axis where the machine is: 0 is east, counter-clockwise positive (REP-103).

    Attributes:
        sigma_rad: standard deviation as the receiver reports it, or None where it is unknown.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    yaw_rad: float
    sigma_rad: float | None
    WIDTH: ClassVar[int] = 3
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "yaw_rad": Quantity((), "rad"),
        "sigma_rad": Quantity((), "rad", may_be_none=True),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return the yaw and its sigma."""
        return (self.yaw_rad, *optional_number(self.sigma_rad))

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the heading that has a row."""
        yaw_rad, is_known, sigma_rad = values
        return cls(stamp_ns, arrival_ns, sensor, yaw_rad, sigma_rad if is_known else None)


@dataclass(frozen=True, slots=True, eq=False)
class JointAngle:
    """Angle of the cabin's turn joint: the rotation of the cabin C about the z axis of the chassis B."""

    stamp_ns: int
    arrival_ns: int
    sensor: str
    angle_rad: float
    WIDTH: ClassVar[int] = 1
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "angle_rad": Quantity((), "rad"),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return the angle."""
        return (self.angle_rad,)

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the angle that has a row."""
        return cls(stamp_ns, arrival_ns, sensor, values[0])


@dataclass(frozen=True, slots=True, eq=False)
class Twist:
    """Velocity of a frame of the machine, expressed in that frame: that of wheels or tracks.

    Attributes:
        linear: (3,) [m/s].
        angular: (3,) [rad/s].
        covariance: (6, 6) in GTSAM's order (angular, then linear), or None.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    linear: Array
    angular: Array
    covariance: Array | None
    WIDTH: ClassVar[int] = 6 + 37
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "linear": Quantity((3,), "m/s"),
        "angular": Quantity((3,), "rad/s"),
        "covariance": Quantity((6, 6), "rad^2/s^2, then m^2/s^2", may_be_none=True),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return linear and angular velocity and the covariance."""
        return (*self.linear.tolist(), *self.angular.tolist(), *optional_row(self.covariance, 36))

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the twist that has a row."""
        linear, angular = np.array(values[:3]), np.array(values[3:6])
        return cls(stamp_ns, arrival_ns, sensor, linear, angular, optional_matrix(values[6:], 6))


@dataclass(frozen=True, slots=True, eq=False)
class PointPosition:
    """Position of a point of the machine in a Cartesian frame: what a total station says of its prism.

    Attributes:
        position: (3,) [m], in W or in the site's grid.
        covariance: (3, 3) [m^2], or None where it is unknown.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    position: Array
    covariance: Array | None
    WIDTH: ClassVar[int] = 3 + 10
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "position": Quantity((3,), "m"),
        "covariance": Quantity((3, 3), "m^2", may_be_none=True),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return the position and its covariance."""
        return (*self.position.tolist(), *optional_row(self.covariance, 9))

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the position that has a row."""
        return cls(stamp_ns, arrival_ns, sensor, np.array(values[:3]), optional_matrix(values[3:], 3))


@dataclass(frozen=True, slots=True, eq=False)
class Height:
    """Height of a point of the machine in W: of a laser receiver, a barometer, or a known ground.

    Attributes:
        sigma_m: standard deviation, or None where it is unknown.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    height_m: float
    sigma_m: float | None
    WIDTH: ClassVar[int] = 3
    QUANTITIES: ClassVar[Mapping[str, Quantity]] = {
        "height_m": Quantity((), "m"),
        "sigma_m": Quantity((), "m", may_be_none=True),
    }

    def __post_init__(self) -> None:
        check_message(self, self.QUANTITIES)

    def values(self) -> Row:
        """Return the height and its sigma."""
        return (self.height_m, *optional_number(self.sigma_m))

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the height that has a row."""
        height_m, is_known, sigma_m = values
        return cls(stamp_ns, arrival_ns, sensor, height_m, sigma_m if is_known else None)


def _is_status(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value in STATUSES
