"""Headings of a dual-antenna receiver or a compass."""

from collections.abc import Sequence
from math import atan2, hypot, isfinite
from typing import Any

import numpy as np

from holdfast.config.assignment import Rule
from holdfast.messages import Array, Heading
from holdfast.recording.columns import Columns, positive
from holdfast.recording.decode import (
    IMU,
    STAMP,
    Decoder,
    FieldDecoder,
    UndecodableError,
    decoder,
    normalised,
    sigma_of,
    unit_quaternion,
)
from holdfast.recording.kinds import DERIVED, Kind, register
from holdfast.recording.source import Subscription

QUATERNION = "geometry_msgs/msg/QuaternionStamped"


@decoder
def quaternion_decoder(stamp_ns: int, arrival_ns: int, sensor: str, message: Any) -> Heading:
    """Decode geometry_msgs/QuaternionStamped: the yaw of the body's x axis in ENU, its noise unknown."""
    return Heading(stamp_ns, arrival_ns, sensor, yaw_of_x_axis(unit_quaternion(message.quaternion)), None)


def orientation_decoder(subscription: Subscription) -> Decoder:
    """Decode the orientation of sensor_msgs/Imu (REP-145: covariance[0] of -1 means that there is none)."""

    def build(arrival_ns: int, sec: int, nanosec: int, covariance: Sequence[float], *quaternion: float) -> Heading:
        if covariance[0] == -1:
            raise UndecodableError("the message has no orientation (orientation_covariance[0] is -1)")
        yaw_rad = yaw_of_x_axis(normalised(np.array(quaternion)))
        stamp_ns = sec * 1_000_000_000 + nanosec
        return Heading(stamp_ns, arrival_ns, subscription.sensor, yaw_rad, sigma_of(covariance[8]))

    return FieldDecoder((*STAMP, "orientation_covariance", *(f"orientation.{axis}" for axis in "xyzw")), build)


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


def _of_line(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Heading:
    if not isfinite(v[0]):
        raise UndecodableError("yaw is not finite")
    return Heading(stamp_ns, arrival_ns, sensor, v[0], positive(v[1]))


register(
    Kind(
        "heading",
        Heading,
        {QUATERNION: quaternion_decoder, IMU: orientation_decoder},
        Columns(("yaw_rad",), _of_line, (("sigma_rad",),)),
        rules=(Rule("heading", ("heading", "yaw", "compass", "dual", "baseline", "relpos"), DERIVED, named=True),),
        gap="the gyroscope carries the heading meanwhile",
        rank=20,
    )
)
