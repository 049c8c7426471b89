"""Fast CDR encoders for what is written at IMU rate: nav_msgs/Odometry and tf2_msgs/TFMessage with fixed frame names.

With the frame names fixed every field has a fixed place, so a message is a template in which only numbers change, and
many messages are one structured array. The bytes are those of rosbags' `serialize_cdr`.
"""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little endian
NS_PER_S = 1_000_000_000
WRAP_S = 2**32


def ros_time(stamp_ns: Any) -> tuple[Any, Any]:
    """Return the seconds and nanoseconds of ROS for a time [ns] or (N,) times; seconds wrap in 2038, as 32 bits do."""
    seconds, nanoseconds = stamp_ns // NS_PER_S, stamp_ns % NS_PER_S
    return (seconds + WRAP_S // 2) % WRAP_S - WRAP_S // 2, nanoseconds


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

    def stamp(self) -> int:
        """Reserve a builtin_interfaces/Time and return its place."""
        return self.reserve(4, 2)

    def integer(self, value: int) -> None:
        self.align(4)
        self.body += struct.pack("<I", value)

    def string(self, text: str) -> None:
        data = text.encode() + b"\x00"
        self.integer(len(data))
        self.body += data


class _Messages:
    """Messages that differ in their stamps and numbers alone, as a structured array of their bytes.

    Args:
        template: of one message.
        places: of each part of it that has a stamp and numbers: where they begin, and how many doubles there are.
    """

    def __init__(self, template: _Template, places: Sequence[tuple[int, int, int]]) -> None:
        self._message = ENCAPSULATION + bytes(template.body)
        fields: list[tuple[str, Any, int]] = []
        for k, (stamp, numbers, count) in enumerate(places):
            fields += [(f"sec{k}", "<i4", stamp), (f"nanosec{k}", "<u4", stamp + 4)]
            fields.append((f"numbers{k}", ("<f8", (count,)), numbers))
        names, formats, offsets = zip(*fields, strict=True)
        self._parts = len(places)
        self._dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(self._message)})

    def new(self, stamps_ns: Sequence[int]) -> NDArray[np.void]:
        """Return messages with these stamps, the numbers of part k to be filled in as `numbers{k}` (N, count)."""
        messages = np.frombuffer(bytearray(self._message * len(stamps_ns)), dtype=self._dtype)
        seconds, nanoseconds = ros_time(np.array(stamps_ns, dtype=np.int64))
        for k in range(self._parts):
            messages[f"sec{k}"], messages[f"nanosec{k}"] = seconds, nanoseconds
        return messages


def _split(messages: NDArray[np.void]) -> list[bytes]:
    data, size = messages.tobytes(), messages.dtype.itemsize
    return [data[begin : begin + size] for begin in range(0, len(data), size)]


class OdometryEncoder:
    """Encodes nav_msgs/Odometry with fixed frames; the pose is that of the child in the frame (`T_frame_child`)."""

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        template = _Template()
        stamp = template.stamp()
        template.string(frame_id)
        template.string(child_frame_id)
        self._messages = _Messages(template, [(stamp, template.reserve(8, 85), 85)])

    def encode(  # noqa: PLR0917 (the fields of the message, in its order)
        self,
        stamps_ns: Sequence[int],
        positions: ArrayLike,
        quaternions_xyzw: ArrayLike,
        pose_covariances: ArrayLike,
        linear: ArrayLike,
        angular: ArrayLike,
        twist_covariances: ArrayLike,
    ) -> list[bytes]:
        """Return N serialised messages; what is given once holds for all.

        Args:
            stamps_ns: (N,) times of the estimates.
            positions: (N, 3) [m].
            quaternions_xyzw: (N, 4).
            pose_covariances: (N, 36), flattened (6, 6) in ROS order, translation first.
            linear: (N, 3) [m/s] in the child frame.
            angular: (N, 3) [rad/s] in the child frame.
            twist_covariances: (N, 36) in ROS order.
        """
        messages = self._messages.new(stamps_ns)
        numbers = messages["numbers0"]
        numbers[:, 0:3] = positions
        numbers[:, 3:7] = quaternions_xyzw
        numbers[:, 7:43] = pose_covariances
        numbers[:, 43:46] = linear
        numbers[:, 46:49] = angular
        numbers[:, 49:85] = twist_covariances
        return _split(messages)


class TransformEncoder:
    """Encodes tf2_msgs/TFMessage with fixed (parent, child) frames, all of one message with one stamp."""

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        template = _Template()
        template.integer(len(frames))
        places = []
        for parent, child in frames:
            stamp = template.stamp()
            template.string(parent)
            template.string(child)
            places.append((stamp, template.reserve(8, 7), 7))
        self._messages = _Messages(template, places)
        self._count = len(frames)

    def encode(self, stamps_ns: Sequence[int], poses: Sequence[tuple[ArrayLike, ArrayLike]]) -> list[bytes]:
        """Return N serialised messages; what is given once holds for all.

        Args:
            stamps_ns: (N,) times, each of all transforms of a message.
            poses: (translations (N, 3) [m], quaternions (N, 4) x, y, z, w) of `T_parent_child` per frame, in order.

        Raises:
            ValueError: there are not as many poses as frames.
        """
        if len(poses) != self._count:
            raise ValueError(f"{len(poses)} poses for {self._count} frames")
        messages = self._messages.new(stamps_ns)
        for k, (translations, quaternions) in enumerate(poses):
            messages[f"numbers{k}"][:, :3] = translations
            messages[f"numbers{k}"][:, 3:] = quaternions
        return _split(messages)
