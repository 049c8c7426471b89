"""Parts of standard ROS 2 messages."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from holdfast.geometry.earth import LocalFrame

NS_PER_S = 1_000_000_000
WRAP_S = 1 << 32
ABSENT = np.array([-1.0, *[0.0] * 8])
"""Covariance of what a sensor_msgs/Imu does not contain (REP-145)."""
NOTHING = (0.0, 0.0, 0.0)
WORLD = "map"
POINT = "geometry_msgs/msg/PointStamped"

Encode = Callable[[int, int], Any]
"""Makes the message of a row with a stamp [ns]."""


class RosMessages:
    """Makes message objects of the types of a typestore; `world` is the datum of W."""

    def __init__(self, types: Mapping[str, Any], world: LocalFrame) -> None:
        self._types = types
        self.world = world

    def make(self, type_name: str, **fields: Any) -> Any:
        """Return a message of a type such as `sensor_msgs/msg/Imu`."""
        return self._types[type_name](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Return a std_msgs/Header; its seconds wrap around in 2038, as 32 bits do."""
        seconds = (stamp_ns // NS_PER_S + WRAP_S // 2) % WRAP_S - WRAP_S // 2
        time = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=stamp_ns % NS_PER_S)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame_id)

    def vector(self, values: Any) -> Any:
        """Return the geometry_msgs/Vector3 of (3,)."""
        x, y, z = values
        return self.make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def point(self, values: Any) -> Any:
        """Return the geometry_msgs/Point of (3,) [m]."""
        x, y, z = values
        return self.make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=float(z))

    def quaternion(self, values: Any) -> Any:
        """Return the geometry_msgs/Quaternion of (4,) x, y, z, w."""
        x, y, z, w = values
        return self.make("geometry_msgs/msg/Quaternion", x=float(x), y=float(y), z=float(z), w=float(w))

    def twist(self, linear: Any, angular: Any, variances: Any) -> Any:
        """Return the geometry_msgs/TwistWithCovariance of velocities (3,) and variances (6,), linear first."""
        twist = self.make("geometry_msgs/msg/Twist", linear=self.vector(linear), angular=self.vector(angular))
        covariance = np.diag(variances).ravel()
        return self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance)

    def pose(self, position: Any, quaternion: Any, variances: Any) -> Any:
        """Return the geometry_msgs/PoseWithCovariance of (3,) [m], (4,) x, y, z, w, and (6,) translation first."""
        pose = self.make(
            "geometry_msgs/msg/Pose", position=self.point(position), orientation=self.quaternion(quaternion)
        )
        covariance = np.diag(variances).ravel()
        return self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance)

    def points(self, frame_id: str, positions: Any) -> Encode:
        """Return what makes the geometry_msgs/PointStamped of positions (N, 3) [m]."""
        rows = positions.tolist()
        return lambda row, stamp_ns: self.make(
            POINT, header=self.header(stamp_ns, frame_id), point=self.point(rows[row])
        )

    def transforms(self, stamp_ns: int, poses: Mapping[tuple[str, str], tuple[Any, Any]]) -> Any:
        """Return a tf2_msgs/TFMessage of (parent, child) -> (translation, quaternion x, y, z, w)."""
        return self.make(
            "tf2_msgs/msg/TFMessage",
            transforms=[
                self.make(
                    "geometry_msgs/msg/TransformStamped",
                    header=self.header(stamp_ns, parent),
                    child_frame_id=child,
                    transform=self.make(
                        "geometry_msgs/msg/Transform",
                        translation=self.vector(translation),
                        rotation=self.quaternion(rotation),
                    ),
                )
                for (parent, child), (translation, rotation) in poses.items()
            ],
        )
