"""What several kinds need to make a Holdfast message of the object that rosbags makes of ROS 1 or ROS 2 bytes.

Decoders never judge a measurement: NaN passes on to the estimator, which counts it. What has no meaning at all, such
as a pose whose quaternion is zero, raises `UndecodableError`; the readers skip and count it.
"""

from collections.abc import Callable
from math import isfinite, sqrt
from operator import attrgetter
from typing import Any

import numpy as np

from holdfast.messages import Array, Message, SensorPose
from holdfast.recording.source import Subscription

Decoder = Callable[[Any, int], Message]
"""Takes the deserialised ROS message and its arrival [ns]."""
DecoderFactory = Callable[[Subscription], Decoder]

IMU = "sensor_msgs/msg/Imu"
ODOMETRY = "nav_msgs/msg/Odometry"
POINT = "geometry_msgs/msg/PointStamped"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
TWIST_COVARIANCE = "geometry_msgs/msg/TwistWithCovarianceStamped"

STAMP = "header.stamp.sec", "header.stamp.nanosec"
QUATERNION_NORM_TOLERANCE = 0.01
ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])


class UndecodableError(ValueError):
    """One message has no meaning as a measurement; the text gives the reason."""


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message that has a header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


class FieldDecoder:
    """A decoder that needs a few fields only, which `FixedLayout` reads without decoding the whole message.

    Args:
        fields: paths to them.
        build: takes the arrival [ns] and the fields in their order.
    """

    def __init__(self, fields: tuple[str, ...], build: Callable[..., Message]) -> None:
        self.fields, self.build = fields, build
        self.values_of: Callable[[Any], tuple[Any, ...]] = attrgetter(*fields)

    def __call__(self, message: Any, arrival_ns: int) -> Message:
        """Decode a deserialised message."""
        return self.build(arrival_ns, *self.values_of(message))


def decoder(convert: Callable[[int, int, str, Any], Message]) -> DecoderFactory:
    """Make decoders of a function of stamp [ns], arrival [ns], sensor and the deserialised ROS message."""

    def subscribed(subscription: Subscription) -> Decoder:
        return lambda message, arrival_ns: convert(stamp_ns(message), arrival_ns, subscription.sensor, message)

    return subscribed


@decoder
def pose_decoder(stamp_ns: int, arrival_ns: int, sensor: str, message: Any) -> SensorPose:
    """Decode nav_msgs/Odometry, geometry_msgs/PoseStamped or geometry_msgs/PoseWithCovarianceStamped.

    The covariance keeps the axes that ROS gives it (those of the header's frame); only its order changes.
    """
    pose, covariance = with_covariance(message.pose, "pose")
    position = xyz(pose.position)
    if not np.isfinite(position).all():
        raise UndecodableError("position is not finite")
    quaternion = unit_quaternion(pose.orientation)
    return SensorPose(stamp_ns, arrival_ns, sensor, position, quaternion, rotation_first(covariance))


POSE_DECODERS = dict.fromkeys((POSE, ODOMETRY, POSE_COVARIANCE), pose_decoder)


def known_covariance(values: Any, size: int) -> Array | None:
    """Return a row-major covariance as a (size, size) matrix, or None where it is unknown.

    Unknown is: not finite, no variance at all (all zeros), or a negative one (REP-145's -1).
    """
    matrix = np.array(values, dtype=np.float64).reshape(size, size)
    numbers = matrix.ravel().tolist()  # so few are looked at much faster than by NumPy
    variances = numbers[:: size + 1]
    if not all(map(isfinite, numbers)) or not any(variances) or min(variances) < 0.0:
        return None
    return matrix


def rotation_first(values: Array | None) -> Array | None:
    """Permute a ROS covariance of a pose or twist (6, 6), translation first, to GTSAM's order, rotation first."""
    matrix = None if values is None else known_covariance(values, 6)
    return None if matrix is None else matrix[np.ix_(ROTATION_FIRST, ROTATION_FIRST)]


def sigma_of(variance: float) -> float | None:
    """Return the square root of a variance, or None where it is unknown: not finite or not positive."""
    return sqrt(variance) if isfinite(variance) and variance > 0 else None


def unit_quaternion(quaternion: Any) -> Array:
    """Return a quaternion as (4,) x, y, z, w of unit norm.

    Raises:
        UndecodableError: its norm is too far from 1 for a rounding error, or not finite.
    """
    q = np.array((quaternion.x, quaternion.y, quaternion.z, quaternion.w), dtype=np.float64)
    return normalised(q)


def normalised(q: Array) -> Array:
    """Return a quaternion (4,) scaled to unit norm; raises UndecodableError like `unit_quaternion`."""
    with np.errstate(over="ignore"):
        norm = float(np.sqrt(q @ q))
    if not abs(norm - 1.0) <= QUATERNION_NORM_TOLERANCE:
        raise UndecodableError(f"quaternion has norm {norm:.3g} (allowed: 1 within {QUATERNION_NORM_TOLERANCE})")
    return q / norm


def with_covariance(field: Any, name: str) -> tuple[Any, Array | None]:
    """Return a pose or a twist, and its covariance (6, 6) as ROS has it where the type carries one."""
    if not hasattr(field, "covariance"):
        return field, None
    return getattr(field, name), np.array(field.covariance, dtype=np.float64).reshape(6, 6)


def point_of(message: Any) -> tuple[Any, Array | None]:
    """Return the point of a PointStamped or of a pose, and the covariance of the pose as `with_covariance`."""
    if hasattr(message, "point"):
        return message.point, None
    pose, covariance = with_covariance(message.pose, "pose")
    return pose.position, covariance


def xyz(vector: Any) -> Array:
    """Return a vector or a point as (3,)."""
    return np.array((vector.x, vector.y, vector.z))
