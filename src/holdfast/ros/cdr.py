"""Fast CDR encoders for what is written at IMU rate: nav_msgs/Odometry and tf2_msgs/TFMessage with fixed frame names.

With the frame names fixed every field has a fixed place, so a message is a template in which only numbers change. The
bytes are those of rosbags' `serialize_cdr`.
"""

import struct
from collections.abc import Sequence

import numpy as np

from holdfast.messages import Array

ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little endian
NS_PER_S = 1_000_000_000
STAMP = struct.Struct("<iI")


class _Template:
    """Bytes under construction; alignment counts from behind the encapsulation."""

    def __init__(self) -> None:
        self.body = bytearray()

    def align(self, size: int) -> None:
        self.body += bytes(-len(self.body) % size)

    def reserve(self, size: int, count: int = 1) -> int:
        """Append `count` zeros of a size [bytes] and return where they begin in the message."""
        self.align(size)
        place = len(self.body)
        self.body += bytes(size * count)
        return place + len(ENCAPSULATION)

    def integer(self, value: int) -> None:
        self.align(4)
        self.body += struct.pack("<I", value)

    def string(self, text: str) -> None:
        data = text.encode() + b"\x00"
        self.integer(len(data))
        self.body += data


class OdometryEncoder:
    """Encodes nav_msgs/Odometry with fixed frames; the pose is that of the child in the frame (`T_frame_child`)."""

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        template = _Template()
        self._stamp = template.reserve(4, 2)
        template.string(frame_id)
        template.string(child_frame_id)
        self._numbers = template.reserve(8, 85)
        self._prefix = bytearray(ENCAPSULATION + template.body[: self._numbers - len(ENCAPSULATION)])
        self._values = np.zeros(85, dtype="<f8")

    def encode(  # noqa: PLR0917 (the fields of the message, in its order)
        self,
        stamp_ns: int,
        position: Array | Sequence[float],
        quaternion_xyzw: Array | Sequence[float],
        pose_covariance: Array | Sequence[float],
        linear: Array | Sequence[float],
        angular: Array | Sequence[float],
        twist_covariance: Array | Sequence[float],
    ) -> bytes:
        """Return the serialised message.

        Args:
            stamp_ns: time of the estimate.
            position: (3,) [m].
            quaternion_xyzw: (4,).
            pose_covariance: (36,) or flattened (6, 6) in ROS order, translation first.
            linear: (3,) [m/s] in the child frame.
            angular: (3,) [rad/s] in the child frame.
            twist_covariance: (36,) in ROS order.

        Raises:
            struct.error: the stamp lies beyond the 32 bit seconds of ROS.
        """
        STAMP.pack_into(self._prefix, self._stamp, stamp_ns // NS_PER_S, stamp_ns % NS_PER_S)
        values = self._values
        values[0:3] = position
        values[3:7] = quaternion_xyzw
        values[7:43] = pose_covariance
        values[43:46] = linear
        values[46:49] = angular
        values[49:85] = twist_covariance
        return bytes(self._prefix) + values.tobytes()


class TransformEncoder:
    """Encodes tf2_msgs/TFMessage with fixed (parent, child) frames, all with one stamp."""

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        template = _Template()
        template.integer(len(frames))
        self._places: list[tuple[int, int]] = []
        for parent, child in frames:
            stamp = template.reserve(4, 2)
            template.string(parent)
            template.string(child)
            self._places.append((stamp, template.reserve(8, 7)))
        self._message = bytearray(ENCAPSULATION + template.body)
        self._transform = struct.Struct("<7d")

    def encode(self, stamp_ns: int, poses: Sequence[tuple[Array | Sequence[float], Array | Sequence[float]]]) -> bytes:
        """Return the serialised message.

        Args:
            stamp_ns: time of all transforms.
            poses: (translation (3,) [m], quaternion (4,) x, y, z, w) of `T_parent_child` per frame, in order.

        Raises:
            ValueError: there are not as many poses as frames.
            struct.error: the stamp lies beyond the 32 bit seconds of ROS.
        """
        sec, nanosec = divmod(stamp_ns, NS_PER_S)
        message = self._message
        for (stamp, numbers), (translation, quaternion) in zip(self._places, poses, strict=True):
            STAMP.pack_into(message, stamp, sec, nanosec)
            self._transform.pack_into(message, numbers, *_floats(translation), *_floats(quaternion))
        return bytes(message)


def _floats(vector: Array | Sequence[float]) -> Sequence[float]:
    # unpacking a list is three times faster than unpacking an array
    return vector.tolist() if isinstance(vector, np.ndarray) else vector
