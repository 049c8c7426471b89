"""Makes small bags of every kind."""

import itertools
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

NOETIC = get_typestore(Stores.ROS1_NOETIC)
HUMBLE = get_typestore(Stores.ROS2_HUMBLE)
START_NS = 1_700_000_000_000_000_000
KINDS = ("bag", "db3", "mcap")


def header(store, stamp_ns, frame_id="f"):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    seq = {"seq": 0} if store is NOETIC else {}
    return store.types["std_msgs/msg/Header"](**seq, stamp=time, frame_id=frame_id)


def vector(store, xyz):
    return store.types["geometry_msgs/msg/Vector3"](*xyz)


def quaternion(store, xyzw=(0.0, 0.0, 0.0, 1.0)):
    return store.types["geometry_msgs/msg/Quaternion"](*xyzw)


def imu(  # noqa: PLR0917
    store, stamp_ns, rate=(0.1, 0.2, 0.3), force=(1.0, 2.0, 9.8), xyzw=(0, 0, 0, 1.0), orientation_cov=None, **kw
):
    zeros = np.zeros(9)
    return store.types["sensor_msgs/msg/Imu"](
        header(store, stamp_ns, **kw),
        quaternion(store, xyzw),
        zeros if orientation_cov is None else np.array(orientation_cov, dtype=float),
        vector(store, rate),
        zeros,
        vector(store, force),
        zeros,
    )


def fix(  # noqa: PLR0917
    store, stamp_ns, status=2, cov=None, cov_type=2, position=(49.0, 8.4, 116.0)
):
    cov = np.diag([0.01, 0.02, 0.03]).ravel() if cov is None else np.array(cov, dtype=float)
    return store.types["sensor_msgs/msg/NavSatFix"](
        header(store, stamp_ns),
        store.types["sensor_msgs/msg/NavSatStatus"](status=status, service=1),
        *position,
        cov,
        cov_type,
    )


def pose(store, position=(1.0, 2.0, 3.0), xyzw=(0.0, 0.0, 0.0, 1.0)):
    point = store.types["geometry_msgs/msg/Point"](*position)
    return store.types["geometry_msgs/msg/Pose"](point, quaternion(store, xyzw))


def pose_with_covariance(store, cov=None, **kw):
    cov = np.zeros(36) if cov is None else np.array(cov, dtype=float)
    return store.types["geometry_msgs/msg/PoseWithCovariance"](pose(store, **kw), cov)


def twist(store, linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0)):
    return store.types["geometry_msgs/msg/Twist"](vector(store, linear), vector(store, angular))


def twist_with_covariance(store, cov=None, **kw):
    cov = np.zeros(36) if cov is None else np.array(cov, dtype=float)
    return store.types["geometry_msgs/msg/TwistWithCovariance"](twist(store, **kw), cov)


def odometry(store, stamp_ns, cov=None, moving=None, **kw):
    return store.types["nav_msgs/msg/Odometry"](
        header(store, stamp_ns),
        "child",
        pose_with_covariance(store, cov, **kw),
        moving or twist_with_covariance(store),
    )


def stamped(store, stamp_ns, type_name, content):
    """A message of a header and one field, such as geometry_msgs/TwistStamped."""
    return store.types[f"geometry_msgs/msg/{type_name}"](header(store, stamp_ns), content)


def point(store, xyz):
    return stamped(store, START_NS, "PointStamped", store.types["geometry_msgs/msg/Point"](*xyz))


def joints(store, stamp_ns, names=("turn",), positions=(0.5,)):
    empty = np.zeros(0)
    return store.types["sensor_msgs/msg/JointState"](
        header(store, stamp_ns), list(names), np.array(positions, dtype=float), empty, empty
    )


def drive(store, seconds=1.0, start_ns=START_NS):
    """Yield (topic, arrival, message): IMU at 100 Hz, GNSS and lidar at 10 Hz, arriving 2, 60 and 40 ms late."""
    for k in range(round(seconds * 100)):
        stamp = start_ns + k * 10_000_000
        yield "/imu", stamp + 2_000_000, imu(store, stamp, rate=(0.01 * np.sin(k), 0.0, 0.1), force=(0.1 * k, 0.0, 9.8))
        if k % 10 == 0:
            yield "/gnss/fix", stamp + 60_000_000, fix(store, stamp)
            yield "/lidar/odometry", stamp + 40_000_000, odometry(store, stamp)


def store_of(kind):
    return NOETIC if kind == "bag" else HUMBLE


def write_bag(path: Path, kind: str, messages, *, raw=None):
    """Write (topic, arrival, message) rows; `raw` replaces the bytes of rows by number. Return what to open."""
    store = store_of(kind)
    if kind == "bag":
        path = path.with_suffix(".bag")
        writer = Writer1(path)
    else:
        writer = Writer2(
            path, version=9, storage_plugin=StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        )
    serialize = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
    connections = {}
    with writer:
        for number, (topic, arrival, message) in enumerate(messages):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
            data = (raw or {}).get(number) or serialize(message, message.__msgtype__)
            writer.write(connections[topic], arrival, data)
    return path


def bare(folder: Path) -> Path:
    """Return the only storage file of a ROS 2 bag folder."""
    return next(itertools.chain(folder.glob("*.mcap"), folder.glob("*.db3")))
