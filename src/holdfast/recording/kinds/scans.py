"""Scans of a lidar, of which Holdfast makes an odometry itself (`holdfast.lidar_odometry`)."""

from typing import Any

import numpy as np

from holdfast.config.assignment import Rule
from holdfast.point_cloud import Layout, PointCloud, PointField
from holdfast.recording.decode import decoder
from holdfast.recording.kinds import DERIVED, Kind, register

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LIDARS = ("lidar", "laser", "points", "cloud", "scan", "ouster", "velodyne", "hesai", "livox", "rslidar")
NO_SCANS = (*DERIVED, "map", "camera", "depth", "stereo", "radar", "ground", "obstacle", "local")


def point_cloud(stamp_ns: int, arrival_ns: int, sensor: str, message: Any) -> PointCloud:
    """Take over a sensor_msgs/PointCloud2 as it is: its points are decoded by whoever needs them."""
    fields = tuple(PointField(one.name, int(one.offset), int(one.datatype), int(one.count)) for one in message.fields)
    size = int(message.height), int(message.width), int(message.point_step), int(message.row_step)
    data = np.asarray(message.data, dtype=np.uint8)
    layout = Layout(fields, *size, bool(message.is_bigendian))
    return PointCloud(stamp_ns, arrival_ns, sensor, str(message.header.frame_id), layout, data)


cloud_decoder = decoder(point_cloud)

register(
    Kind(
        "scans",
        PointCloud,
        {POINT_CLOUD: cloud_decoder},
        rules=(
            Rule("lidar", LIDARS, NO_SCANS),
            Rule("lidar", avoid=NO_SCANS, every=True, spare=True),
        ),
        gap="its odometry begins a new map if it lasts for more than a second",
        rank=31,
    )
)
