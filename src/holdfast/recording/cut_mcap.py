"""MCAP files without an index: cut off, never closed, or written without one.

The file is walked record by record up to the first that is not whole. Whole chunks are remembered with their times, so
that reading is in exact order of arrival however the chunks overlap, with only the overlapping ones in memory.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, Schema
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from holdfast.errors import RecordingError
from holdfast.printable import one_line
from holdfast.recording.bag_file import Channel, RawMessage
from holdfast.recording.decompression import MAX_FILE_BYTES, OversizedError, check_size, unpack
from holdfast.recording.merge import merge_by_arrival

MAGIC = b"\x89MCAP0\r\n"
RUN_BYTES = 1 << 20
FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}
CLAIM_OFFSET = 16
"""Of the size of a chunk when unpacked, behind the times of its first and last message."""
FOOTER = struct.Struct("<BQQQI8s")
"""Opcode, length, offset of the summary and of its offsets, checksum, magic."""
MESSAGE_PREFIX = struct.Struct("<HIQQ")


def has_summary(path: Path) -> bool:
    """Return whether an MCAP file ends with a footer that names a summary."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - FOOTER.size))
        end = file.read()
    return len(end) == FOOTER.size and end.endswith(MAGIC) and FOOTER.unpack(end)[2] != 0


@dataclass(slots=True)
class Segment:
    """A chunk, or a run of records outside of chunks: where it lies [bytes] and when its messages arrived [ns]."""

    offset: int
    length: int
    chunked: bool
    start_ns: int
    end_ns: int


class StreamedMcap:
    """An MCAP file that is read without an index.

    Raises:
        RecordingError: it is no MCAP file, not one whole message is left, or it unpacks to far more than it is.
    """

    ros1 = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        self._size = path.stat().st_size
        self._file: BinaryIO = path.open("rb")
        self._segments: list[Segment] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, ChannelRecord] = {}
        self._counts: Counter[int] = Counter()
        self._damaged: list[int] = []
        try:
            if self._file.read(len(MAGIC)) != MAGIC:
                raise RecordingError(f"{path}: is no MCAP file (its first bytes are wrong)")
            self._check_claims()
            self._whole_bytes, self._complete = self._scan()
            if not self._segments:
                raise RecordingError(
                    f"{path}: holds no messages" + ("" if self._complete else " up to its cut-off end")
                )
        except BaseException:
            self._file.close()
            raise
        self.start_ns = min(segment.start_ns for segment in self._segments)
        self.end_ns = max(segment.end_ns for segment in self._segments)
        self.channels = [self._channel(record) for record in self._channels.values()]
        self._warn()

    def messages(self, numbers: set[int], begin_ns: int | None, end_ns: int | None) -> Iterator[RawMessage]:
        """Yield raw messages; see `BagFile.messages`."""
        begin = self.start_ns if begin_ns is None else begin_ns
        end = self.end_ns + 1 if end_ns is None else end_ns
        return merge_by_arrival(
            [
                (segment.start_ns, partial(self._segment_messages, segment, numbers, begin, end))
                for segment in self._segments
                if segment.end_ns >= begin and segment.start_ns < end
            ]
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _check_claims(self) -> None:
        """Refuse a file whose chunks claim to unpack to far more than it is, before any is unpacked."""
        claimed = 0
        for opcode, offset, _ in self._walk():
            if opcode == Opcode.CHUNK:
                self._file.seek(offset + CLAIM_OFFSET)
                claimed += int.from_bytes(self._file.read(8), "little")
        try:
            check_size(self._size, claimed, MAX_FILE_BYTES)
        except OversizedError as error:
            raise OversizedError(f"{self.path}: {error}") from None

    def _scan(self) -> tuple[int, bool]:
        """Find segments, schemas and channels; return where whole records end [bytes] and whether all data is there."""
        run: Segment | None = None
        position = len(MAGIC)
        for opcode, offset, length in self._walk():
            position = offset + length
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return position, True
            if opcode == Opcode.CHUNK:
                run = None
                self._note(Segment(offset, length, True, 0, -1))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                if run is None or run.length > RUN_BYTES:
                    run = Segment(offset - 9, 0, False, 0, -1)
                record = Segment(offset - 9, length + 9, False, 0, -1)
                run = self._grow(run, record)
        return position, False

    def _walk(self) -> Iterator[tuple[int, int, int]]:
        """Yield opcode, offset and length [bytes] of the content of each whole top-level record."""
        position = len(MAGIC)
        while position + 9 <= self._size:
            self._file.seek(position)
            opcode, length = struct.unpack("<BQ", self._file.read(9))
            # zeros are what a file system leaves in a file whose last blocks were never written
            if opcode == 0 or position + 9 + length > self._size:
                return
            yield opcode, position + 9, length
            position += 9 + length

    def _note(self, segment: Segment) -> bool:
        """Read a segment's schemas, channels and times; keep it if it has messages. False if it is damaged."""
        times: list[int] = []
        try:
            for opcode, content in _records(self._content(segment)):
                if opcode == Opcode.SCHEMA:
                    schema = Schema.read(ReadDataStream(BytesIO(content)))
                    self._schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = ChannelRecord.read(ReadDataStream(BytesIO(content)))
                    self._channels[channel.id] = channel
                elif opcode == Opcode.MESSAGE:
                    number, _, log_time_ns, _ = MESSAGE_PREFIX.unpack_from(content)
                    self._counts[number] += 1
                    times.append(log_time_ns)
        except OversizedError as error:
            raise OversizedError(f"{self.path}: {error}") from None
        except Exception:  # decompressors and parsers raise what they like on damaged bytes; the chunk is left out
            self._damaged.append(segment.offset)
            return False
        if times:
            segment.start_ns, segment.end_ns = min(times), max(times)
            self._segments.append(segment)
        return True

    def _grow(self, run: Segment, record: Segment) -> Segment:
        """Add one top-level record to the run of records before it, so that a run is one segment."""
        known = len(self._segments)
        if self._note(record) and len(self._segments) > known:
            self._segments.pop()
            if run.end_ns < 0:
                run.start_ns, run.end_ns = record.start_ns, record.end_ns
                self._segments.append(run)
            run.start_ns, run.end_ns = min(run.start_ns, record.start_ns), max(run.end_ns, record.end_ns)
        run.length = record.offset + record.length - run.offset
        return run

    def _content(self, segment: Segment) -> bytes:
        self._file.seek(segment.offset)
        if not segment.chunked:
            return self._file.read(segment.length)
        chunk = Chunk.read(ReadDataStream(BytesIO(self._file.read(segment.length))))
        content = unpack(chunk.compression, chunk.data, chunk.uncompressed_size)
        if len(content) != chunk.uncompressed_size or (
            chunk.uncompressed_crc and crc32(content) != chunk.uncompressed_crc
        ):
            raise RecordingError(f"{self.path}: the chunk at byte {segment.offset} is damaged")
        return content

    def _segment_messages(self, segment: Segment, numbers: set[int], begin: int, end: int) -> Iterator[RawMessage]:
        messages: list[RawMessage] = []
        for opcode, content in _records(self._content(segment)):
            if opcode == Opcode.MESSAGE:
                number, _, log_time_ns, _ = MESSAGE_PREFIX.unpack_from(content)
                if number in numbers and begin <= log_time_ns < end:
                    messages.append((log_time_ns, number, content[MESSAGE_PREFIX.size :]))
        messages.sort(key=lambda message: message[0])
        return iter(messages)

    def _channel(self, record: ChannelRecord) -> Channel:
        schema = self._schemas.get(record.schema_id)
        definition = MessageDefinition(MessageDefinitionFormat.NONE, "")
        if schema is not None and schema.encoding in FORMATS:
            definition = MessageDefinition(FORMATS[schema.encoding], schema.data.decode("utf-8", "replace"))
        name = one_line(schema.name) if schema is not None else "unknown"
        return Channel(
            record.id, one_line(record.topic), name, definition, f"channel {record.id}", self._counts.get(record.id, 0)
        )

    def _warn(self) -> None:
        if not self._complete:
            seconds = (self.end_ns - self.start_ns) / 1e9
            self.warnings.append(
                f"{self.path}: is cut off or was never closed; read up to the cut: {self._counts.total()} message(s), "
                f"{seconds:.3f} s, {self._whole_bytes} of {self._size} bytes, the last message at {self.end_ns} ns"
            )
        if self._damaged:
            self.warnings.append(
                f"{self.path}: {len(self._damaged)} damaged chunk(s) left out, the first at byte {self._damaged[0]}"
            )


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record in a run of records."""
    position = 0
    while position < len(content):
        opcode, length = struct.unpack_from("<BQ", content, position)
        position += 9
        if opcode == 0:
            raise ValueError("no record is of type 0")  # megabytes of zeros are no records of length 0
        yield opcode, content[position : position + length]
        position += length
