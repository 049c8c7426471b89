"""The driven path, as nav_msgs/Path: poses some distance apart, thinned out so that the message stays small."""

import struct

import numpy as np

from holdfast.messages import Array
from holdfast.ros.cdr import ENCAPSULATION, ros_time

MAX_POSES = 2000
"""150 kB, written once a second at most."""
POSE_WIDTH = 7


class DrivenPath:
    """Keeps the poses of a path and encodes them; the bytes are those of rosbags' `serialize_cdr`.

    Args:
        frame_id: frame of the poses.
        step_m: distance between two poses; it doubles whenever the path has grown to `MAX_POSES`.
    """

    def __init__(self, frame_id: str, step_m: float) -> None:
        self._frame = _text(frame_id)
        self._first_step_m = step_m
        # behind the first pose each entry begins on eight bytes, so that all of them look alike
        self._entry = np.dtype(
            [
                ("stamp", "<i4", 2),
                ("frame", f"V{len(self._frame)}"),
                ("gap", f"V{-(8 + len(self._frame)) % 8}"),
                ("pose", "<f8", POSE_WIDTH),
            ]
        )
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self.step_m = self._first_step_m
        self._rows = np.zeros(MAX_POSES, dtype=self._entry)
        self._rows["frame"] = np.void(self._frame)
        self._count = 0

    def __len__(self) -> int:
        """Return the number of poses."""
        return self._count

    def add(self, stamp_ns: int, position: Array, quaternion_xyzw: Array) -> bool:
        """Take in a pose if it is far enough from the last one, and return whether it was.

        Args:
            stamp_ns: time of the pose.
            position: (3,) [m].
            quaternion_xyzw: (4,).
        """
        if self._count and float(np.linalg.norm(position - self._rows["pose"][self._count - 1, :3])) < self.step_m:
            return False
        if self._count == MAX_POSES:
            self._count = MAX_POSES // 2
            self._rows[: self._count] = self._rows[::2].copy()
            self.step_m *= 2.0
        row = self._rows[self._count]
        row["stamp"] = ros_time(stamp_ns)
        row["pose"][:3], row["pose"][3:] = position, quaternion_xyzw
        self._count += 1
        return True

    def encode(self, stamp_ns: int) -> bytes:
        """Return the serialised message with all poses."""
        head = struct.pack("<iI", *ros_time(stamp_ns)) + self._frame
        head += bytes(-len(head) % 4) + struct.pack("<I", self._count)
        if not self._count:
            return ENCAPSULATION + head
        first = self._rows[0]
        opening = head + first["stamp"].tobytes() + self._frame
        opening += bytes(-len(opening) % 8) + first["pose"].tobytes()
        return bytes(ENCAPSULATION + opening + self._rows[1 : self._count].tobytes())


def _text(text: str) -> bytes:
    """Return a string in CDR, filled up to four bytes: what follows it is a number."""
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)
