"""The path that is published."""

import numpy as np
import pytest

from holdfast.live.idl import STORE
from holdfast.live.path import MAX_POSES, DrivenPath

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
EPOCH_NS = 1_700_000_000_123_456_789


def header(stamp_ns, frame_id):
    time = STORE.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return STORE.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)


def as_rosbags_writes_it(frame_id, stamp_ns, poses):
    types = STORE.types
    stamped = [
        types["geometry_msgs/msg/PoseStamped"](
            header=header(at_ns, frame_id),
            pose=types["geometry_msgs/msg/Pose"](
                position=types["geometry_msgs/msg/Point"](*p), orientation=types["geometry_msgs/msg/Quaternion"](*q)
            ),
        )
        for at_ns, p, q in poses
    ]
    message = types["nav_msgs/msg/Path"](header=header(stamp_ns, frame_id), poses=stamped)
    return bytes(STORE.serialize_cdr(message, "nav_msgs/msg/Path"))


@pytest.mark.parametrize("frame_id", ["", "m", "ma", "map", "odom", "world", "site_1", "site_12", "site_123"])
@pytest.mark.parametrize("count", [0, 1, 2, 3, 7])
def test_a_path_is_encoded_as_rosbags_would(frame_id, count):
    path = DrivenPath(frame_id, 0.5)
    turned = np.array([0.1, -0.2, 0.3, np.sqrt(1.0 - 0.14)])
    poses = [(EPOCH_NS + k, np.array([1.5 * k, -2.0, 1e3 + k]), turned) for k in range(count)]
    assert [path.add(*pose) for pose in poses] == [True] * count
    assert path.encode(EPOCH_NS + 99) == as_rosbags_writes_it(frame_id, EPOCH_NS + 99, poses)


def test_poses_closer_than_a_step_are_left_out():
    path = DrivenPath("map", 0.5)
    taken = [path.add(EPOCH_NS + k, np.array([0.2 * k, 0.0, 0.0]), UPRIGHT) for k in range(10)]
    assert [k for k, was_taken in enumerate(taken) if was_taken] == [0, 3, 6, 9]


def test_a_long_way_is_thinned_out_and_keeps_its_beginning_and_its_end():
    path = DrivenPath("map", 0.1)
    way_m = 4.0 * MAX_POSES * 0.1
    for k in range(round(way_m / 0.05) + 1):
        path.add(EPOCH_NS + k, np.array([0.05 * k, 0.0, 0.0]), UPRIGHT)
    message = STORE.deserialize_cdr(path.encode(EPOCH_NS), "nav_msgs/msg/Path")
    x = np.array([pose.pose.position.x for pose in message.poses])
    assert MAX_POSES // 2 <= len(x) <= MAX_POSES
    assert x[0] == 0.0
    assert way_m - x[-1] <= path.step_m
    assert (np.diff(x) > 0).all()
    assert np.diff(x).max() <= 1.5 * path.step_m  # poses came every 0.05 m, half of the first step


def test_a_path_begins_anew():
    path = DrivenPath("map", 0.5)
    path.add(EPOCH_NS, np.zeros(3), UPRIGHT)
    path.clear()
    assert path.encode(EPOCH_NS) == as_rosbags_writes_it("map", EPOCH_NS, [])
    assert path.add(EPOCH_NS, np.zeros(3), UPRIGHT)
