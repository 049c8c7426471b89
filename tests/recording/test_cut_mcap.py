"""MCAP files without an index."""

import io
import random
from pathlib import Path

import pytest
from bags import HUMBLE, START_NS, bare, drive, imu, odometry, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from holdfast.errors import RecordingError
from holdfast.recording.source import Subscription, open_recording

IMU = Subscription("/imu", "imu", "imu")
LIDAR = Subscription("/lidar/odometry", "lidar", "odometry")


def mcap_bytes(rows, *, close=True, profile="ros2", **options) -> bytes:
    """Return an MCAP file; without `close` it is what a killed recorder leaves."""
    stream = io.BytesIO()
    writer = Writer(stream, **options)
    writer.start(profile=profile)
    channels = {}
    for topic, arrival, message in rows:
        if topic not in channels:
            name = message.__msgtype__
            definition = HUMBLE.generate_msgdef(name, ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", definition))
        data = bytes(HUMBLE.serialize_cdr(message, message.__msgtype__))
        writer.add_message(channels[topic], arrival, data, arrival)
    if close:
        writer.finish()
    return stream.getvalue()


def by_arrival(rows):
    return sorted(rows, key=lambda row: row[1])


def read_all(path: Path):
    with open_recording(path) as recording:
        messages = list(recording.read([IMU, LIDAR]))
        return messages, list(recording.warnings)


def test_cut_off_mcap_is_read_up_to_the_cut_with_a_warning(tmp_path: Path) -> None:
    rows = [row for row in by_arrival(drive(HUMBLE, 5)) if row[0] != "/gnss/fix"]
    whole = mcap_bytes(rows, chunk_size=10_000)
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: len(whole) // 2])
    messages, (warning,) = read_all(path)
    expected = [arrival for _, arrival, _ in rows]
    assert [m.arrival_ns for m in messages] == expected[: len(messages)]
    assert len(expected) * 0.4 < len(messages) < len(expected) * 0.6
    assert f"{path}: is cut off or was never closed; read up to the cut: {len(messages)} message(s)" in warning
    assert f"the last message at {messages[-1].arrival_ns} ns" in warning


def test_a_cut_file_in_a_folder_with_or_without_metadata_is_read_too(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "b", "mcap", [row for row in drive(HUMBLE, 40) if row[0] != "/gnss/fix"])
    file = bare(folder)
    file.write_bytes(file.read_bytes()[:-50_000])  # into the second of two chunks
    for _ in range(2):
        messages, warnings = read_all(folder)
        assert 2000 < len(messages) < 4400
        assert len(warnings) == 1
        (folder / "metadata.yaml").unlink(missing_ok=True)


def test_a_file_that_only_lost_its_index_is_whole(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "b", "mcap", [row for row in drive(HUMBLE, 1) if row[0] != "/gnss/fix"])
    file = bare(folder)
    file.write_bytes(file.read_bytes()[:-100])
    messages, warnings = read_all(folder)
    assert len(messages) == 110
    assert warnings == []


def test_an_unclosed_file_loses_only_its_last_chunk(tmp_path: Path) -> None:
    rows = [("/imu", START_NS + k, imu(HUMBLE, START_NS + k)) for k in range(200)]
    path = tmp_path / "b.mcap"
    path.write_bytes(mcap_bytes(rows, close=False, chunk_size=3_000))
    messages, warnings = read_all_imu(path)
    assert 185 < len(messages) < 200
    assert len(warnings) == 1


def read_all_imu(path: Path):
    with open_recording(path) as recording:
        messages = list(recording.read([IMU]))
        return messages, list(recording.warnings)


@settings(max_examples=40, deadline=None)
@given(cut=st.floats(0.0, 1.0), compression=st.sampled_from(list(CompressionType)), chunked=st.booleans())
def test_wherever_the_cut_is_the_messages_before_it_are_read_or_the_file_is_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, cut: float, compression: CompressionType, chunked: bool
) -> None:
    rows = [("/imu", START_NS + k, imu(HUMBLE, START_NS + k)) for k in range(30)]
    whole = mcap_bytes(rows, chunk_size=2_000, compression=compression, use_chunking=chunked)
    path = tmp_path_factory.mktemp("cut") / "b.mcap"
    path.write_bytes(whole[: round(cut * len(whole))])
    try:
        messages, _ = read_all_imu(path)
    except RecordingError as error:
        assert "\n" not in str(error)
        assert cut < 0.9
        return
    assert [m.stamp_ns for m in messages] == [START_NS + k for k in range(len(messages))]
    if cut == 1.0:
        assert len(messages) == 30


def test_chunks_that_overlap_in_time_are_read_in_exact_order(tmp_path: Path) -> None:
    rows = [("/imu", START_NS + k * 1000, imu(HUMBLE, START_NS + k * 1000)) for k in range(300)]
    late = random.Random(1).sample(rows, len(rows))
    path = tmp_path / "b.mcap"
    path.write_bytes(mcap_bytes(late, close=False, chunk_size=5_000))
    messages, _ = read_all_imu(path)
    arrivals = [m.arrival_ns for m in messages]
    assert len(arrivals) > 270
    assert arrivals == sorted(arrivals)


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False, "use_statistics": False, "repeat_channels": False, "repeat_schemas": False},
        {"index_types": IndexType.NONE},
        {"index_types": IndexType.CHUNK},
        {"profile": ""},
    ],
    ids=["fastwrite", "no index", "no message index", "no profile"],
)
def test_a_whole_file_that_rosbags_cannot_seek_in_is_read_without_warning(tmp_path: Path, options) -> None:
    rows = [("/imu", START_NS + (k ^ 1), imu(HUMBLE, START_NS + (k ^ 1))) for k in range(100)]
    path = tmp_path / "b.mcap"
    path.write_bytes(mcap_bytes(rows, **options))
    messages, warnings = read_all_imu(path)
    assert [m.arrival_ns for m in messages] == [START_NS + k for k in range(100)]
    assert warnings == []


def test_a_damaged_chunk_in_a_cut_file_is_left_out_with_a_warning(tmp_path: Path) -> None:
    rows = [("/imu", START_NS + k, imu(HUMBLE, START_NS + k)) for k in range(100)]
    whole = bytearray(mcap_bytes(rows, close=False, chunk_size=3_000, compression=CompressionType.NONE))
    whole[len(whole) // 2] ^= 0xFF
    path = tmp_path / "b.mcap"
    path.write_bytes(whole)
    messages, warnings = read_all_imu(path)
    assert 70 < len(messages) < 95
    assert any("1 damaged chunk(s) left out" in warning for warning in warnings)


def test_zeros_at_the_end_are_a_cut(tmp_path: Path) -> None:
    rows = [("/imu", START_NS + k, imu(HUMBLE, START_NS + k)) for k in range(50)]
    path = tmp_path / "b.mcap"
    path.write_bytes(mcap_bytes(rows, close=False, chunk_size=3_000) + bytes(5_000))
    messages, warnings = read_all_imu(path)
    assert len(messages) > 35
    assert "is cut off" in warnings[0]


def test_start_and_duration_hold_without_an_index(tmp_path: Path) -> None:
    rows = [("/lidar/odometry", START_NS + k * 10**8, odometry(HUMBLE, START_NS + k * 10**8)) for k in range(100)]
    path = tmp_path / "b.mcap"
    path.write_bytes(mcap_bytes(rows, close=False, chunk_size=3_000))
    with open_recording(path) as recording:
        stamps = [m.stamp_ns for m in recording.read([LIDAR], start_s=2.0, duration_s=1.0)]
    assert stamps == [START_NS + k * 10**8 for k in range(20, 30)]


def test_what_is_no_mcap_or_has_not_one_message_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    path.write_bytes(b"GIF89a" * 100)
    with pytest.raises(RecordingError, match="is no MCAP file"):
        open_recording(path)
    path.write_bytes(mcap_bytes([], close=False))
    with pytest.raises(RecordingError, match="holds no messages up to its cut-off end"):
        open_recording(path)
