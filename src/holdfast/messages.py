"""What the sensors say, decoded: one frozen dataclass per kind of measurement.

`stamp_ns` is the time of measurement on the sensor's clock, `arrival_ns` the time at which the recording or the live
transport received it; both are nanoseconds since the epoch. `sensor` is the sensor's name in the configuration.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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


class FixStatus(IntEnum):
    """Quality of a GNSS fix, numbered as sensor_msgs/NavSatStatus; RTK receivers report GBAS when fixed."""

    UNKNOWN = -2
    NO_FIX = -1
    FIX = 0
    SBAS = 1
    GBAS = 2


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


@dataclass(frozen=True, slots=True, eq=False)
class LidarPose:
    """Pose of the lidar in the frame in which its odometry started: T_L0_L.

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


@dataclass(frozen=True, slots=True, eq=False)
class Heading:
    """Yaw of a body axis in the world: 0 is east, counter-clockwise positive (REP-103).

    Attributes:
        sigma_rad: standard deviation as the receiver reports it, or None where it is unknown.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    yaw_rad: float
    sigma_rad: float | None


@dataclass(frozen=True, slots=True, eq=False)
class JointAngle:
    """Angle of the cabin's turn joint: the rotation of the cabin C about the z axis of the chassis B."""

    stamp_ns: int
    arrival_ns: int
    sensor: str
    angle_rad: float


Message = ImuSample | GnssFix | LidarPose | Heading | JointAngle
