"""One decoder per message type: the object that rosbags makes of ROS 1 or ROS 2 bytes becomes a Holdfast message.

Decoders never judge a measurement: NaN in IMU and GNSS messages passes on to the estimator, which counts it. What has
no meaning at all, such as a pose whose quaternion is zero, raises `UndecodableError`; the readers skip and count it.
"""

from collections.abc import Callable
from math import atan2, hypot, isfinite, sqrt
from typing import Any

import numpy as np

from holdfast.errors import RecordingError
from holdfast.messages import Array, FixStatus, GnssFix, Heading, ImuSample, JointAngle, LidarPose, Message
from holdfast.recording.source import Kind, Subscription

Decoder = Callable[[Any, int], Message]
"""Takes the deserialised ROS message and its arrival [ns]."""

QUATERNION_NORM_TOLERANCE = 0.01
ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
STATUSES = {int(status): status for status in FixStatus}


class UndecodableError(ValueError):
    """One message has no meaning as a measurement; the text says why."""


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message that has a header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def imu_decoder(subscription: Subscription) -> Decoder:
    """Decode sensor_msgs/Imu; this is the hot path of a replay."""
    sensor = subscription.sensor

    def decode(message: Any, arrival_ns: int) -> ImuSample:
        stamp = message.header.stamp
        rate = message.angular_velocity
        force = message.linear_acceleration
        return ImuSample(
            stamp.sec * 1_000_000_000 + stamp.nanosec,
            arrival_ns,
            sensor,
            np.array((rate.x, rate.y, rate.z)),
            np.array((force.x, force.y, force.z)),
        )

    return decode


def gnss_decoder(subscription: Subscription) -> Decoder:
    """Decode sensor_msgs/NavSatFix: a covariance of unknown type, not finite or without variance is None."""

    def decode(message: Any, arrival_ns: int) -> GnssFix:
        return GnssFix(
            stamp_ns(message),
            arrival_ns,
            subscription.sensor,
            message.latitude,
            message.longitude,
            message.altitude,
            known_covariance(message.position_covariance, 3) if message.position_covariance_type != 0 else None,
            STATUSES.get(int(message.status.status), FixStatus.UNKNOWN),
        )

    return decode


def lidar_decoder(subscription: Subscription) -> Decoder:
    """Decode nav_msgs/Odometry, geometry_msgs/PoseStamped or geometry_msgs/PoseWithCovarianceStamped.

    The covariance keeps the axes that ROS gives it (those of the header's frame); only its order changes.
    """

    def decode(message: Any, arrival_ns: int) -> LidarPose:
        pose, covariance = message.pose, None
        if hasattr(pose, "covariance"):
            pose, covariance = pose.pose, rotation_first(pose.covariance)
        p = np.array((pose.position.x, pose.position.y, pose.position.z))
        if not np.isfinite(p).all():
            raise UndecodableError("position is not finite")
        return LidarPose(
            stamp_ns(message), arrival_ns, subscription.sensor, p, unit_quaternion(pose.orientation), covariance
        )

    return decode


def quaternion_heading_decoder(subscription: Subscription) -> Decoder:
    """Decode geometry_msgs/QuaternionStamped: the yaw of the body's x axis in ENU, its noise unknown."""

    def decode(message: Any, arrival_ns: int) -> Heading:
        yaw_rad = yaw_of_x_axis(unit_quaternion(message.quaternion))
        return Heading(stamp_ns(message), arrival_ns, subscription.sensor, yaw_rad, None)

    return decode


def imu_heading_decoder(subscription: Subscription) -> Decoder:
    """Decode the orientation of sensor_msgs/Imu (REP-145: covariance[0] of -1 means that there is none)."""

    def decode(message: Any, arrival_ns: int) -> Heading:
        covariance = message.orientation_covariance
        if covariance[0] == -1:
            raise UndecodableError("the message has no orientation (orientation_covariance[0] is -1)")
        variance = float(covariance[8])
        sigma_rad = sqrt(variance) if isfinite(variance) and variance > 0 else None
        yaw_rad = yaw_of_x_axis(unit_quaternion(message.orientation))
        return Heading(stamp_ns(message), arrival_ns, subscription.sensor, yaw_rad, sigma_rad)

    return decode


def joint_decoder(subscription: Subscription) -> Decoder:
    """Decode one joint of sensor_msgs/JointState.

    The decoder raises RecordingError if the message has several joints and the subscription does not say which.
    """
    wanted = subscription.joint_name

    def decode(message: Any, arrival_ns: int) -> JointAngle:
        names, angles = list(message.name), message.position
        if wanted is None:
            if len(names) > 1:
                raise RecordingError(f"{subscription.topic}: set joint_name to one of {', '.join(names)}")
            index = 0
        elif wanted in names:
            index = names.index(wanted)
        else:
            raise UndecodableError(f"joint {wanted!r} is not among {', '.join(names) or 'the joints (none)'}")
        if index >= len(angles) or not isfinite(angles[index]):
            raise UndecodableError("the joint has no finite position")
        return JointAngle(stamp_ns(message), arrival_ns, subscription.sensor, float(angles[index]))

    return decode


DECODERS: dict[Kind, dict[str, Callable[[Subscription], Decoder]]] = {
    "imu": {"sensor_msgs/msg/Imu": imu_decoder},
    "gnss": {"sensor_msgs/msg/NavSatFix": gnss_decoder},
    "lidar": {
        "nav_msgs/msg/Odometry": lidar_decoder,
        "geometry_msgs/msg/PoseStamped": lidar_decoder,
        "geometry_msgs/msg/PoseWithCovarianceStamped": lidar_decoder,
    },
    "heading": {
        "geometry_msgs/msg/QuaternionStamped": quaternion_heading_decoder,
        "sensor_msgs/msg/Imu": imu_heading_decoder,
    },
    "joint": {"sensor_msgs/msg/JointState": joint_decoder},
}


def make_decoder(subscription: Subscription, type_name: str, file: str) -> Decoder:
    """Return the decoder for messages of a type as the kind that is subscribed.

    Raises:
        RecordingError: no decoder makes that kind of that type.
    """
    allowed = DECODERS[subscription.kind]
    if type_name not in allowed:
        raise RecordingError(
            f"{file}: topic {subscription.topic!r} is {type_name}, which is no {subscription.kind} "
            f"(allowed: {', '.join(allowed)})"
        )
    return allowed[type_name](subscription)


def default_decoder(topic: str, type_name: str) -> Decoder | None:
    """Return a decoder for the first kind that a type can be, or None; the messages carry the topic as sensor.

    A JointState has none, because it does not say which of its joints is meant.
    """
    for kind, allowed in DECODERS.items():
        if type_name in allowed and kind != "joint":
            return allowed[type_name](Subscription(topic, topic, kind))
    return None


def known_covariance(values: Any, size: int) -> Array | None:
    """Return a row-major covariance as a (size, size) matrix, or None where ROS says unknown.

    Unknown is: not finite, no variance at all (all zeros), or a negative one (REP-145's -1).
    """
    matrix = np.array(values, dtype=np.float64).reshape(size, size)
    variances = matrix.diagonal()
    if not np.isfinite(matrix).all() or not variances.any() or (variances < 0).any():
        return None
    return matrix


def rotation_first(values: Any) -> Array | None:
    """Permute a ROS pose covariance (36, row-major, translation first) to GTSAM's order, (6, 6) rotation first."""
    matrix = known_covariance(values, 6)
    return None if matrix is None else matrix[np.ix_(ROTATION_FIRST, ROTATION_FIRST)]


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


def yaw_of_x_axis(q: Array) -> float:
    """Return the yaw [rad] of the rotated x axis, atan2(R_10, R_00), of a unit quaternion (4,) x, y, z, w.

    Raises:
        UndecodableError: the axis is vertical and has no yaw.
    """
    x, y, z, w = q.tolist()
    north, east = 2 * (x * y + z * w), 1 - 2 * (y * y + z * z)
    if hypot(north, east) < 1e-6:
        raise UndecodableError("the x axis is vertical and has no yaw")
    return atan2(north, east)
