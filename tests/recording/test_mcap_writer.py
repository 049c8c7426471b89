"""Writing MCAP, and the fast encoders against rosbags' own."""

import random
from pathlib import Path

import numpy as np
import pytest
from bags import HUMBLE, START_NS, header, pose, vector
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from holdfast.errors import RecordingError
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.source import Subscription, open_recording
from holdfast.ros.cdr import OdometryEncoder, TransformEncoder, ros_time

NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
FLOATS = st.floats(allow_nan=False)


def floats(count: int):
    return st.lists(FLOATS, min_size=count, max_size=count)


def ros_odometry(stamp_ns, frame, child, p, q, pose_cov, linear, angular, twist_cov):  # noqa: PLR0917
    types = HUMBLE.types
    return types["nav_msgs/msg/Odometry"](
        header(HUMBLE, stamp_ns, frame),
        child,
        types["geometry_msgs/msg/PoseWithCovariance"](pose(HUMBLE, p, q), np.array(pose_cov)),
        types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](vector(HUMBLE, linear), vector(HUMBLE, angular)), np.array(twist_cov)
        ),
    )


@given(
    stamp_ns=STAMPS, frame=NAMES, child=NAMES, p=floats(3), q=floats(4), linear=floats(3), angular=floats(3),
    pose_cov=floats(36), twist_cov=floats(36),
)  # fmt: skip
def test_encoded_odometry_is_byte_identical_to_rosbags(  # noqa: PLR0917
    stamp_ns, frame, child, p, q, linear, angular, pose_cov, twist_cov
) -> None:
    encoder = OdometryEncoder(frame, child)
    message = ros_odometry(stamp_ns, frame, child, p, q, pose_cov, linear, angular, twist_cov)
    expected = bytes(HUMBLE.serialize_cdr(message, "nav_msgs/msg/Odometry"))
    nines = [[9.0] * size for size in (3, 4, 36, 3, 3, 36)]  # nothing of a neighbour may show
    rows = [np.array(both) for both in zip(nines, (p, q, pose_cov, linear, angular, twist_cov), strict=True)]
    assert encoder.encode([1, stamp_ns], *rows)[1] == expected


@given(stamp_ns=STAMPS, frames=st.lists(st.tuples(NAMES, NAMES), min_size=1, max_size=4), data=st.data())
def test_encoded_transforms_are_byte_identical_to_rosbags(stamp_ns, frames, data) -> None:
    poses = [(data.draw(floats(3)), data.draw(floats(4))) for _ in frames]
    types = HUMBLE.types
    transforms = [
        types["geometry_msgs/msg/TransformStamped"](
            header(HUMBLE, stamp_ns, parent),
            child,
            types["geometry_msgs/msg/Transform"](vector(HUMBLE, p), types["geometry_msgs/msg/Quaternion"](*q)),
        )
        for (parent, child), (p, q) in zip(frames, poses, strict=True)
    ]
    expected = bytes(HUMBLE.serialize_cdr(types["tf2_msgs/msg/TFMessage"](transforms), "tf2_msgs/msg/TFMessage"))
    encoder = TransformEncoder(frames)
    assert encoder.encode([stamp_ns], poses) == [expected]
    many = [(np.array([[9.0] * 3, p]), np.array([[9.0] * 4, q])) for p, q in poses]
    assert encoder.encode([1, stamp_ns], many)[1] == expected


def test_encoders_refuse_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match="1 poses for 2 frames"):
        TransformEncoder([("a", "b"), ("b", "c")]).encode([0], [([0, 0, 0], [0, 0, 0, 1])])


@pytest.mark.parametrize(
    ("stamp_ns", "seconds"),
    [(2**31 * 10**9 - 1, 2**31 - 1), (2**31 * 10**9, -(2**31)), (-1, -1), (2**63 - 1, 633437444)],
)
def test_seconds_wrap_in_2038_as_32_bits_do(stamp_ns, seconds) -> None:
    """A replay of stamps beyond 2038 ended in a traceback."""
    assert ros_time(stamp_ns) == (seconds, stamp_ns % 10**9)
    (message,) = TransformEncoder([("a", "b")]).encode([stamp_ns], [([0, 0, 0], [0, 0, 0, 1])])
    time = HUMBLE.deserialize_cdr(message, "tf2_msgs/msg/TFMessage").transforms[0].header.stamp
    assert (time.sec, time.nanosec) == (seconds, stamp_ns % 10**9)


def write_odometry(writer: McapWriter, count: int) -> None:
    encoder = OdometryEncoder("map", "base_link")
    noise = random.Random(1)
    for k in range(count):
        position = [noise.random() for _ in range(3)]
        cov = [noise.random() for _ in range(36)]
        stamp = START_NS + k * 10_000_000
        (data,) = encoder.encode([stamp], position, [0, 0, 0, 1], cov, [0] * 3, [0] * 3, cov)
        writer.write("/odometry", data, "nav_msgs/msg/Odometry", stamp + 5, stamp)


def test_rosbags_reads_what_is_written(tmp_path: Path) -> None:
    path = tmp_path / "o.mcap"
    with McapWriter(path) as writer:
        write_odometry(writer, 1000)
        text = writer.types["std_msgs/msg/String"](data="hello")
        writer.write("/text", text, "std_msgs/msg/String", START_NS + 10**12)
    with AnyReader([path]) as reader:
        messages = [(c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages()]
    assert [t for _, t, _ in messages[:-1]] == [START_NS + k * 10_000_000 + 5 for k in range(1000)]
    assert messages[7][2].header.frame_id == "map"
    assert messages[7][2].child_frame_id == "base_link"
    assert messages[7][2].header.stamp.nanosec == 70_000_000
    assert messages[-1][0] == "/text"
    assert messages[-1][2].data == "hello"


def test_a_crash_loses_at_most_the_last_chunk(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "o.mcap")
    write_odometry(writer, 2000)
    left = tmp_path / "left.mcap"
    left.write_bytes((tmp_path / "o.mcap").read_bytes())  # before close: this is what a kill leaves
    writer.flush()
    flushed = tmp_path / "flushed.mcap"
    flushed.write_bytes((tmp_path / "o.mcap").read_bytes())
    writer.close()
    writer.close()
    counts = []
    for path in (left, flushed):
        with open_recording(path) as recording:
            counts.append(len(list(recording.read([Subscription("/odometry", "l", "odometry")]))))
            assert "is cut off or was never closed" in recording.warnings[0]
    assert 2000 - (1 << 18) / 700 - 1 < counts[0] < 2000
    assert counts[1] == 2000


def test_a_type_that_is_not_standard_is_refused(tmp_path: Path) -> None:
    with (
        McapWriter(tmp_path / "o.mcap") as writer,
        pytest.raises(RecordingError, match="'my_msgs/msg/Thing' is no standard"),
    ):
        writer.write("/t", b"", "my_msgs/msg/Thing", 0)


def test_a_file_that_cannot_be_created_is_an_error_of_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot be written \(No such file or directory\)"):
        McapWriter(tmp_path / "missing" / "o.mcap")
