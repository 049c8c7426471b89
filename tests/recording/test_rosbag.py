"""Bags of every kind, read in order of arrival."""

import sqlite3
import tracemalloc
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from bags import HUMBLE, KINDS, START_NS, bare, drive, fix, imu, joints, odometry, store_of, write_bag
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from holdfast.errors import RecordingError
from holdfast.messages import GnssFix, ImuSample, SensorPose
from holdfast.recording.source import Subscription, open_recording

IMU = Subscription("/imu", "imu", "imu")
GNSS = Subscription("/gnss/fix", "gnss", "gnss")
LIDAR = Subscription("/lidar/odometry", "lidar", "odometry")
ALL = (IMU, GNSS, LIDAR)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_gives_the_same_messages_in_order_of_arrival(tmp_path: Path, kind: str) -> None:
    rows = list(drive(store_of(kind)))
    with open_recording(write_bag(tmp_path / "b", kind, rows)) as recording:
        messages = list(recording.read(ALL))
        assert {info.topic: info.count for info in recording.topics} == {
            "/imu": 100, "/gnss/fix": 10, "/lidar/odometry": 10
        }  # fmt: skip
        assert recording.start_ns == START_NS + 2_000_000
        assert recording.end_ns == max(arrival for _, arrival, _ in rows)
        assert recording.warnings == []
    assert [m.arrival_ns for m in messages] == sorted(arrival for _, arrival, _ in rows)
    kinds = [type(m) for m in messages]
    assert [kinds.count(t) for t in (ImuSample, GnssFix, SensorPose)] == [100, 10, 10]
    third = [m for m in messages if isinstance(m, ImuSample)][2]
    assert third.stamp_ns == START_NS + 20_000_000
    assert third.sensor == "imu"
    assert third.specific_force.tolist() == [0.2, 0.0, 9.8]
    assert third.angular_velocity.tolist() == [0.01 * np.sin(2), 0.0, 0.1]


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_a_bag_is_read_as_folder_as_bare_file_and_without_its_metadata(tmp_path: Path, kind: str) -> None:
    folder = write_bag(tmp_path / "b", kind, drive(store_of(kind), 0.2))
    stamps = []
    for path in (folder, bare(folder), folder):
        with open_recording(path) as recording:
            stamps.append([m.stamp_ns for m in recording.read(ALL)])
        (folder / "metadata.yaml").unlink(missing_ok=True)
    assert len(stamps[0]) == 24
    assert stamps[0] == stamps[1] == stamps[2]


@pytest.mark.parametrize(("mode", "plugin"), [("FILE", "SQLITE3"), ("MESSAGE", "SQLITE3"), ("STORAGE", "MCAP")])
def test_compressed_bags_are_read(tmp_path: Path, mode: str, plugin: str) -> None:
    store = store_of("mcap")
    writer = Writer2(tmp_path / "b", version=9, storage_plugin=StoragePlugin[plugin])
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for topic, arrival, message in drive(store, 0.3):
            if topic == "/imu":
                writer.write(connection, arrival, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
    with open_recording(tmp_path / "b") as recording:
        assert len(list(recording.read([IMU]))) == 30


def test_a_message_in_big_endian_is_read(tmp_path: Path) -> None:
    store = store_of("mcap")
    message = imu(store, START_NS + 5, frame_id="imu_link")
    raw = bytes(store.serialize_cdr(message, "sensor_msgs/msg/Imu", little_endian=False))
    path = write_bag(tmp_path / "b", "mcap", [("/imu", START_NS, message)], raw={0: raw})
    with open_recording(path) as recording:
        (sample,) = recording.read([IMU])
        (seen,) = recording.read_headers()
    assert sample.specific_force.tolist() == [1.0, 2.0, 9.8]
    assert (seen.stamp_ns, seen.frame_id) == (START_NS + 5, "imu_link")


def test_a_topic_whose_definition_is_broken_spoils_no_other(tmp_path: Path) -> None:
    store = store_of("bag")
    path = tmp_path / "b.bag"
    with Writer1(path) as writer:
        bad = writer.add_connection("/bad", "x_msgs/msg/Bad", msgdef="uint8 uint8 [[[", md5sum="0" * 32)
        writer.write(bad, START_NS, b"x")
        good = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        writer.write(good, START_NS + 1, store.serialize_ros1(imu(store, START_NS), "sensor_msgs/msg/Imu"))
    with open_recording(path) as recording:
        assert len(list(recording.read([IMU]))) == 1
        assert [header.topic for header in recording.read_headers()] == ["/bad", "/imu"]


def test_a_folder_with_damaged_metadata_is_read_by_its_files_with_a_warning(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "b", "mcap", drive(store_of("mcap"), 0.2))
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n  files: [")
    with open_recording(folder) as recording:
        assert len(list(recording.read(ALL))) == 24
        assert "metadata.yaml: is damaged" in recording.warnings[0]


def test_several_files_are_merged_by_arrival(tmp_path: Path) -> None:
    rows = list(drive(store_of("mcap")))
    folder = tmp_path / "all"
    folder.mkdir()
    for number in range(3):
        part = write_bag(tmp_path / f"part{number}", "mcap", rows[number::3])
        bare(part).rename(folder / f"part{number}.mcap")
    with open_recording(folder) as recording:
        arrivals = [m.arrival_ns for m in recording.read(ALL)]
    assert arrivals == sorted(arrival for _, arrival, _ in rows)


@pytest.mark.parametrize("kind", KINDS)
def test_start_and_duration_select_by_arrival(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path / "b", kind, drive(store_of(kind)))
    with open_recording(path) as recording:
        messages = list(recording.read([IMU], start_s=0.25, duration_s=0.5))
        assert messages[0].stamp_ns == START_NS + 250_000_000
        assert messages[-1].stamp_ns == START_NS + 740_000_000
        with pytest.raises(RecordingError, match=r"start is 5 s but the recording lasts 0\.990 s"):
            recording.read([IMU], start_s=5)
        with pytest.raises(RecordingError, match="duration is 0"):
            recording.read([IMU], duration_s=0)


def test_an_absent_topic_is_an_error_that_names_file_and_topics_and_guesses(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "b", "mcap", drive(store_of("mcap"), 0.1))
    with open_recording(path) as recording, pytest.raises(RecordingError) as caught:
        recording.read([Subscription("/imu/data", "imu", "imu")])
    text = str(caught.value)
    assert text.startswith(f"{path}: has no topic '/imu/data'; did you mean '/imu'? it has /gnss/fix (sensor_msgs/msg/")
    assert "\n" not in text


def test_a_wrong_type_is_an_error_that_names_the_types_allowed(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "b", "bag", drive(store_of("bag"), 0.1))
    with open_recording(path) as recording, pytest.raises(RecordingError) as caught:
        recording.read([Subscription("/gnss/fix", "imu", "imu")])
    assert str(caught.value) == (
        f"{path}: topic '/gnss/fix' is sensor_msgs/msg/NavSatFix, which is no imu (allowed: sensor_msgs/msg/Imu)"
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_message_in_the_middle_is_skipped_counted_and_named(tmp_path: Path, kind: str) -> None:
    rows = [row for row in drive(store_of(kind), 0.3) if row[0] == "/imu"]
    path = write_bag(tmp_path / "b", kind, rows, raw={12: b"\x00\x01\x00\x00rubbish", 20: b"\x00\x01\x00\x00"})
    with open_recording(path) as recording:
        stamps = [m.stamp_ns for m in recording.read([IMU])]
        assert stamps == [START_NS + k * 10_000_000 for k in range(30) if k not in (12, 20)]
        (warning,) = recording.warnings
    assert (
        f"2 messages of /imu could not be decoded and were skipped, the first at {START_NS + 122_000_000} ns" in warning
    )


def test_one_topic_can_serve_two_sensors(tmp_path: Path) -> None:
    store = store_of("mcap")
    path = write_bag(tmp_path / "b", "mcap", [("/imu", START_NS, imu(store, START_NS))])
    with open_recording(path) as recording:
        messages = list(recording.read([IMU, Subscription("/imu", "compass", "heading")]))
    assert [m.sensor for m in messages] == ["imu", "compass"]


def test_several_joints_without_a_name_are_a_clear_error(tmp_path: Path) -> None:
    store = store_of("mcap")
    rows = [("/joint_states", START_NS, joints(store, START_NS, ("boom", "turn"), (0.1, 0.2)))]
    path = write_bag(tmp_path / "b", "mcap", rows)
    with open_recording(path) as recording:
        with pytest.raises(RecordingError, match="/joint_states: set joint_name to one of boom, turn"):
            list(recording.read([Subscription("/joint_states", "joint", "joint")]))
        (message,) = recording.read([Subscription("/joint_states", "joint", "joint", "turn")])
    assert message.angle_rad == 0.2


def test_headers_carry_stamp_frame_publisher_and_measurement(tmp_path: Path) -> None:
    for kind in KINDS:
        store = store_of(kind)
        rows = [
            ("/imu", START_NS + 5, imu(store, START_NS, frame_id="imu_link")),
            ("/text", START_NS + 6, store.types["std_msgs/msg/String"]("no header here")),
            ("/joint_states", START_NS + 7, joints(store, START_NS + 1, ("a", "b"), (0.0, 0.0))),
        ]
        with open_recording(write_bag(tmp_path / kind, kind, rows)) as recording:
            first, text, joint = recording.read_headers()
            assert recording.warnings == []
        assert (first.topic, first.stamp_ns, first.arrival_ns) == ("/imu", START_NS, START_NS + 5)
        assert first.frame_id == "imu_link"
        assert isinstance(first.message, ImuSample)
        assert first.publisher
        assert (text.stamp_ns, text.frame_id, text.message) == (None, "", None)
        assert (joint.stamp_ns, joint.message) == (START_NS + 1, None)


def test_reading_is_lazy_and_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    store = store_of("mcap")

    def rows(count: int):
        for k in range(count):
            yield "/lidar/odometry", START_NS + k * 10_000_000, odometry(store, START_NS + k * 10_000_000)

    peaks = []
    for number, count in enumerate((3_000, 9_000)):
        path = write_bag(tmp_path / f"b{number}", "mcap", rows(count))
        with open_recording(path) as recording:
            assert sum(1 for _ in recording.read([LIDAR], duration_s=0.1)) == 10  # warms the codec up
            tracemalloc.start()
            seen = sum(1 for _ in recording.read([LIDAR]))
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
        assert seen == count
    assert peaks[1] < 1.5 * peaks[0]


def test_damaged_bags_are_refused_in_one_line_with_the_remedy(tmp_path: Path) -> None:
    ros1 = write_bag(tmp_path / "a", "bag", drive(store_of("bag")))
    ros1.write_bytes(ros1.read_bytes()[: ros1.stat().st_size // 2])
    with pytest.raises(RecordingError, match="rosbag reindex") as caught:
        open_recording(ros1)
    assert "\n" not in str(caught.value)

    sqlite = bare(write_bag(tmp_path / "b", "db3", drive(store_of("db3"))))
    sqlite.write_bytes(sqlite.read_bytes()[: sqlite.stat().st_size // 2])
    with pytest.raises(RecordingError, match=r"sqlite3 FILE \.recover") as caught, open_recording(sqlite) as recording:
        list(recording.read([IMU]))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("topics SET name = x'ff'", "cannot be opened"),
        ("topics SET type = x'ff'", "cannot be opened"),
        ("messages SET timestamp = 'soon'", "cannot be opened"),
        ("messages SET timestamp = 1.5 WHERE id = 7", "cannot be opened"),
        ("messages SET timestamp = 1e300 WHERE id = 7", "cannot be opened"),
        ("messages SET timestamp = 'soon' WHERE id = 7", "is damaged after soon ns"),
    ],
)
def test_columns_of_sqlite_that_hold_another_type_are_damage(tmp_path: Path, change: str, words: str) -> None:
    """Sqlite keeps what it is given: a name of bytes or a time of text ended `info` in a traceback."""
    file = bare(write_bag(tmp_path / "b", "db3", drive(store_of("db3"), 0.5)))
    with closing(sqlite3.connect(file)) as database, database:
        database.execute(f"UPDATE {change}")
    with pytest.raises(RecordingError, match=words) as caught, open_recording(file) as recording:
        list(recording.read_headers())
    assert "\n" not in str(caught.value)


def test_a_bag_without_messages_is_refused(tmp_path: Path) -> None:
    with Writer1(tmp_path / "empty.bag"):
        pass
    empties = [tmp_path / "empty.bag"]
    empties += [write_bag(tmp_path / kind, kind, []) for kind in ("db3", "mcap")]
    for path in empties:
        with pytest.raises(RecordingError, match="holds no messages"):
            open_recording(path)


def test_two_nodes_on_one_topic_are_told_apart_in_ros_1(tmp_path: Path) -> None:
    store = store_of("bag")
    path = tmp_path / "b.bag"
    with Writer1(path) as writer:
        for number, node in enumerate(("/driver", "/relay")):
            connection = writer.add_connection("/gnss/fix", "sensor_msgs/msg/NavSatFix", typestore=store, callerid=node)
            data = store.serialize_ros1(fix(store, START_NS + number), "sensor_msgs/msg/NavSatFix")
            writer.write(connection, START_NS + number, data)
    with open_recording(path) as recording:
        assert [header.publisher for header in recording.read_headers()] == ["/driver", "/relay"]
        assert len(list(recording.read([GNSS]))) == 2


def test_one_odometry_serves_two_sensors_and_a_bad_pose_costs_the_twist_nothing(tmp_path: Path) -> None:
    rows = [("/odom", START_NS + k, odometry(HUMBLE, START_NS + k, xyzw=(0.0, 0.0, 0.0, 1.0 - k))) for k in range(2)]
    both = [Subscription("/odom", "wheels", "odometry"), Subscription("/odom", "speed", "twist")]
    with open_recording(write_bag(tmp_path / "b", "mcap", rows)) as recording:
        assert [message.sensor for message in recording.read(both)] == ["wheels", "speed", "speed"]
        (warning,) = recording.warnings
    assert "1 message of /odom could not be decoded" in warning
