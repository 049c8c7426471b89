"""Files that were made to fill the memory are refused early, in one line."""

import bz2
import os
import struct
import sys
import tracemalloc

import lz4.frame
import pytest
from bags import HUMBLE, NOETIC, drive, imu
from rosbags.rosbag1 import Writer as Writer1
from test_cut_mcap import by_arrival, mcap_bytes

from holdfast.errors import RecordingError
from holdfast.recording.decompression import MAX_CHUNK_BYTES, MAX_FRAMES, OversizedError, unpack
from holdfast.recording.source import open_recording

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

PACK = {"zstd": zstd.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}
MAGIC = b"\x89MCAP0\r\n"


def peak_bytes(action):
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def mcap_of_chunks(chunks):
    """An MCAP file without an index of (compression, packed bytes, claimed size, time)."""
    parts = [MAGIC, record(1, text("ros2") + text("t"))]
    for compression, packed, claimed, at_ns in chunks:
        head = struct.pack("<QQQI", at_ns, at_ns + 10**9, claimed, 0) + text(compression)
        parts.append(record(6, head + struct.pack("<Q", len(packed)) + packed))
    return b"".join([*parts, record(15, bytes(4)), record(2, bytes(20)), MAGIC])


def read_whole(path):
    with open_recording(path) as recording:
        for _ in recording.read_headers():
            pass


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_what_was_packed_is_unpacked(compression):
    content = os.urandom(10_000) + bytes(9 << 20)
    packed = PACK[compression](content)
    assert unpack(compression, packed) == content
    assert unpack(compression, packed, len(content)) == content
    assert unpack(compression, packed + PACK[compression](b"more")) == content + b"more"
    with pytest.raises(ValueError, match="too early"):
        unpack(compression, packed[:-20])


def test_what_is_not_packed_is_left_alone_and_an_unknown_packing_is_named():
    assert unpack("", b"abc") == b"abc"
    with pytest.raises(ValueError, match="'rar' is not supported"):
        unpack("rar", b"abc")


def test_many_frames_in_one_chunk_are_refused():
    with pytest.raises(ValueError, match=f"more than {MAX_FRAMES} frames"):
        unpack("zstd", zstd.compress(b"") * (MAX_FRAMES + 1))


@pytest.mark.parametrize("claimed", [4 << 30, 1000], ids=["claims gigabytes", "hides them"])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_of_megabytes_of_zeros_is_refused_without_the_memory(tmp_path, compression, claimed):
    packed = PACK[compression](bytes(200 << 20))
    path = tmp_path / "bomb.mcap"
    path.write_bytes(mcap_of_chunks([(compression, packed, claimed, 10**18)]))
    peaks = []

    def read():
        with pytest.raises(RecordingError) as raised:
            read_whole(path)
        assert len(str(raised.value).splitlines()) == 1 and str(raised.value).startswith(f"{path}: ")
        assert "unpack" in str(raised.value)

    peaks.append(peak_bytes(read))
    assert max(peaks) < 20 << 20  # it was 200 MB, and 4 GB for a file of 0.65 MB


def test_an_index_that_claims_gigabytes_is_refused(tmp_path):
    whole = mcap_bytes(by_arrival(drive(HUMBLE, 2)), chunk_size=10**9)
    size = next(len(content) for content in chunk_contents(whole))
    path = tmp_path / "index.mcap"
    path.write_bytes(whole.replace(struct.pack("<Q", size), struct.pack("<Q", 4 << 30)))
    with pytest.raises(RecordingError, match=r"index\.mcap: .*claim to unpack to 4294967296 bytes"):
        read_whole(path)


def chunk_contents(whole):
    from io import BytesIO

    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    for one in StreamReader(BytesIO(whole), emit_chunks=True).records:
        if isinstance(one, Chunk):
            yield unpack(one.compression, one.data, one.uncompressed_size)


def test_many_chunks_that_are_each_within_bounds_are_refused_together(tmp_path):
    packed = zstd.compress(bytes(60 << 20))
    path = tmp_path / "many.mcap"
    path.write_bytes(mcap_of_chunks([("zstd", packed, 60 << 20, 10**18)] * 10))
    with pytest.raises(RecordingError, match="claim to unpack to"):
        read_whole(path)


def test_a_ros1_chunk_of_zeros_is_refused(tmp_path):
    path = tmp_path / "bomb.bag"
    writer = Writer1(path)
    writer.set_compression(Writer1.CompressionFormat.LZ4)
    with writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=NOETIC)
        data = bytes(NOETIC.serialize_ros1(imu(NOETIC, 10**18), "sensor_msgs/msg/Imu"))
        writer.write(connection, 10**18, data + bytes(80 << 20))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(RecordingError, match=f"unpacks to more than {MAX_CHUNK_BYTES} bytes"):
        read_whole(path)


def test_an_honest_chunk_may_be_large_and_another_may_be_empty_ground():
    noise = os.urandom(70 << 20)
    assert len(unpack("zstd", zstd.compress(noise), len(noise))) == len(noise)
    ground = bytes(60 << 20)
    assert len(unpack("zstd", zstd.compress(ground), len(ground))) == len(ground)
    with pytest.raises(OversizedError):
        unpack("zstd", zstd.compress(ground + ground))
