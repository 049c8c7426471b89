"""A ROS 2 node that publishes clouds as the driver of a lidar does; `live_scans.py --ros` starts it.

Runs in an environment of its own that has rclpy and nothing of Holdfast: `ros_clouds.py FILE TOPIC BEGAN_S SHIFT_NS`.
FILE holds a cloud behind another: when it is due after the beginning [s], its length in bytes, and its CDR. What is
published has a stamp that is moved by SHIFT_NS; the beginning is that of the clock of `time.perf_counter`.
"""

import struct
import sys
import time
from pathlib import Path

FRAME = struct.Struct("<dQ")
STAMP = struct.Struct("<iI")  # behind the four bytes of the encapsulation


def stamped(raw: bytes, shift_ns: int) -> bytes:
    """Return a message with its stamp moved."""
    data = bytearray(raw)
    sec, nanosec = STAMP.unpack_from(data, 4)
    STAMP.pack_into(data, 4, *divmod(sec * 10**9 + nanosec + shift_ns, 10**9))
    return bytes(data)


def main(path: str, topic: str, began_s: str, shift_ns: str) -> None:
    import rclpy  # not where `live_scans.py` reads what else is here
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import PointCloud2

    rclpy.init()
    publisher = rclpy.create_node("lidar").create_publisher(PointCloud2, topic, qos_profile_sensor_data)
    with Path(path).open("rb") as file:
        while frame := file.read(FRAME.size):
            due_s, size = FRAME.unpack(frame)
            data = stamped(file.read(size), int(shift_ns))
            time.sleep(max(0.0, float(began_s) + due_s - time.perf_counter()))
            publisher.publish(data)
    time.sleep(1.0)
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
