"""Velocities of wheels or tracks."""

from typing import Any

import numpy as np

from holdfast.config.assignment import Rule
from holdfast.messages import Twist
from holdfast.recording.columns import Columns, axes, diagonal
from holdfast.recording.decode import ODOMETRY, TWIST, TWIST_COVARIANCE, decoder, rotation_first, with_covariance, xyz
from holdfast.recording.kinds import COMMAND, DERIVED, INERTIAL, SATELLITE, WHEEL, Kind, register


@decoder
def twist_decoder(stamp_ns: int, arrival_ns: int, sensor: str, message: Any) -> Twist:
    """Decode geometry_msgs/TwistStamped, TwistWithCovarianceStamped or the twist of nav_msgs/Odometry.

    All three are expressed in the moving frame: that of the header, of an Odometry `child_frame_id`.
    """
    twist, covariance = with_covariance(message.twist, "twist")
    return Twist(stamp_ns, arrival_ns, sensor, xyz(twist.linear), xyz(twist.angular), rotation_first(covariance))


def _of_line(stamp_ns: int, arrival_ns: int, sensor: str, v: list[float]) -> Twist:
    covariance = None
    if (linear := diagonal(v[6:])) is not None:
        covariance = np.zeros((6, 6))  # as in ROS, no variance is an unknown one
        covariance[3:, 3:] = linear
    return Twist(stamp_ns, arrival_ns, sensor, np.array(v[:3]), np.array(v[3:6]), covariance)


register(
    Kind(
        "twist",
        Twist,
        {TWIST: twist_decoder, TWIST_COVARIANCE: twist_decoder, ODOMETRY: twist_decoder},
        Columns(axes("v?_m_s"), _of_line, (axes("w?_rad_s"), axes("sigma_v?_m_s"))),
        rules=(
            Rule(
                "twist",
                (*WHEEL, "speed", "vel"),
                (*DERIVED, *COMMAND, *SATELLITE, *INERTIAL),
                every=True,
                on_chassis=True,
                types=(TWIST, TWIST_COVARIANCE),  # of an Odometry the pose is proposed
            ),
        ),
        gap="the other sensors alone bound the speed meanwhile",
        rank=40,
    )
)
