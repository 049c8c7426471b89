"""One file of a ROS bag: its channels, and raw messages in order of arrival.

rosbags reads what has an index; `holdfast.recording.cut_mcap` reads MCAP files that lost theirs.
"""

import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import index
from pathlib import Path
from typing import Any, Protocol

from rosbags.interfaces import ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from holdfast.errors import RecordingError
from holdfast.printable import one_line, quoted
from holdfast.recording.decompression import MAX_FILE_BYTES, bound_rosbags, check_size
from holdfast.recording.fixed_layout import FixedLayout

bound_rosbags()

RawMessage = tuple[int, int, bytes]
"""Arrival [ns], number of the channel, serialised message."""

REMEDIES = {
    ".bag": "a bag that was not closed can be mended with `rosbag reindex`",
    ".db3": "what is left of it can be saved with `sqlite3 FILE .recover`",
    ".mcap": "what is left of it can be saved with `mcap recover`",
}
IDL_SEPARATOR = "=" * 80 + "\n"
HEADER_TYPE = "std_msgs/msg/Header"


@dataclass(frozen=True, slots=True)
class Channel:
    """One stream of messages in one file; a topic can have several.

    Attributes:
        number: the file's own number of the channel.
        publisher: name of the node in ROS 1, `channel N` in ROS 2, which does not record the node.
    """

    number: int
    topic: str
    type: str
    definition: MessageDefinition
    publisher: str
    count: int


class BagFile(Protocol):
    """An open file of a bag."""

    path: Path
    ros1: bool
    channels: list[Channel]
    start_ns: int
    end_ns: int
    warnings: list[str]

    def messages(self, numbers: set[int], begin_ns: int | None, end_ns: int | None) -> Iterator[RawMessage]:
        """Yield the messages of some channels that arrived in [begin, end), in order of arrival.

        Raises:
            RecordingError: the file is damaged.
        """

    def close(self) -> None:
        """Close the file."""


class IndexedBagFile:
    """A file, or a folder with compressed files, that rosbags reads by its index.

    Raises:
        RecordingError: rosbags refuses it; the line gives the reason and the remedy.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ros1 = path.suffix == ".bag"
        self.warnings: list[str] = []
        try:
            self._reader = Reader1(path) if self.ros1 else Reader2(path)
            self._reader.open()
            claimed = sum(chunk.uncompressed_size for chunk in self._chunks)
            check_size(path.stat().st_size, claimed, MAX_FILE_BYTES)
            # end_time of rosbags is one past the last message
            self.start_ns, self.end_ns = index(self._reader.start_time), index(self._reader.end_time) - 1
            self.channels = [
                Channel(
                    connection.id,
                    one_line(connection.topic),
                    one_line(connection.msgtype),
                    connection.msgdef,
                    _publisher(connection.id, connection.ext),
                    connection.msgcount,
                )
                for connection in self._reader.connections
            ]
        except Exception as error:  # rosbags lets TypeError, struct.error and others escape on damaged files
            self.close()
            raise self._damaged("cannot be opened", error) from None
        log = path.with_name(path.name + "-wal")
        if path.suffix == ".db3" and log.exists() and log.stat().st_size > 0:
            self.warnings.append(
                f"{path}: the newest messages are still in {log.name} and are not read; "
                "`sqlite3 FILE 'PRAGMA wal_checkpoint'` moves them over"
            )

    @property
    def indexed(self) -> bool:
        """Return whether an MCAP file has an index of its chunks; without it rosbags fails on unsorted messages."""
        return any(chunk.channel_count for chunk in self._chunks)

    @property
    def _chunks(self) -> list[Any]:
        """Return what the index of an MCAP file says of its chunks."""
        return getattr(getattr(self._reader, "storage", None), "chunks", [])

    def messages(self, numbers: set[int], begin_ns: int | None, end_ns: int | None) -> Iterator[RawMessage]:
        """Yield raw messages; see `BagFile.messages`."""
        connections = [connection for connection in self._reader.connections if connection.id in numbers]
        arrival_ns = self.start_ns
        try:
            for connection, arrival_ns, raw in self._reader.messages(connections, begin_ns, end_ns):
                yield index(arrival_ns), connection.id, raw  # sqlite keeps text and fractions in a column of integers
        except Exception as error:  # as above: many kinds, all of them damage
            raise self._damaged(f"is damaged after {arrival_ns} ns", error) from None

    def _damaged(self, what: str, error: Exception) -> RecordingError:
        reason = quoted(" ".join(str(error).split())).rstrip(".") or type(error).__name__
        remedy = REMEDIES.get(self.path.suffix, "")
        return RecordingError(f"{self.path}: {what} ({reason})" + (f"; {remedy}" if remedy else ""))

    def close(self) -> None:
        """Close the file; closing twice does no harm."""
        with suppress(Exception):
            self._reader.close()


def _publisher(number: int, ext: Any) -> str:
    if isinstance(ext, ConnectionExtRosbag1):
        return one_line(ext.callerid or "") or f"connection {number}"
    return f"channel {number}"


class Codec:
    """Decodes the messages of one channel by the definition that the file carries, else by the standard one.

    Every channel has a typestore of its own: a definition that cannot be parsed, or that contradicts another's, spoils
    no other topic. Without a definition the types of ROS 2 Humble (ROS 1 Noetic) serve: files of later versions carry
    their definitions.

    Raises:
        RecordingError: the definition cannot be parsed, or is missing and no standard one.
    """

    def __init__(self, channel: Channel, file: Path, *, ros1: bool) -> None:
        self._type = channel.type
        self._ros1 = ros1
        try:
            self._store = get_typestore(Stores.EMPTY)
            self._store.register(_definitions(channel, ros1=ros1))
            self._store.get_msgdef(channel.type)
            fields = self._store.fielddefs[channel.type][1]
        except Exception as error:  # the parser raises what its grammar happens to
            raise RecordingError(
                f"{file}: the definition of {channel.type} (topic {channel.topic!r}) cannot be used: "
                f"{quoted(repr(error))}"
            ) from None
        self.has_header = bool(fields) and fields[0][1][1] == HEADER_TYPE
        self._decode = self._store.deserialize_ros1 if ros1 else self._store.deserialize_cdr

    def deserialize(self, raw: bytes) -> Any:
        """Return the message as an object with the fields of its definition."""
        return self._decode(raw, self._type)

    def layout(self, fields: Sequence[str], raw: bytes) -> FixedLayout | None:
        """Return where some fields lie in messages like a decoded one; None where that cannot be told."""
        try:
            return None if self._ros1 else FixedLayout(self._store.fielddefs, self._type, fields, raw)
        except (ValueError, KeyError, struct.error):
            return None

    def peek(self, raw: bytes) -> tuple[int, str]:
        """Return stamp [ns] and frame_id of a message that begins with a header, without decoding the rest.

        CDR has its 4 bytes of encapsulation where ROS 1 has `seq`, so the stamp lies at byte 4 in both.

        Raises:
            struct.error: the message is too short.
        """
        big_endian = not self._ros1 and raw[1:2] == b"\x00"
        sec, nanosec, length = struct.unpack_from(">iII" if big_endian else "<iII", raw, 4)
        frame_id = raw[16 : 16 + length].rstrip(b"\x00").decode("utf-8", "replace")
        return sec * 1_000_000_000 + nanosec, quoted(frame_id)


def _definitions(channel: Channel, *, ros1: bool) -> Any:
    definition = channel.definition
    if definition.format == MessageDefinitionFormat.MSG and definition.data.strip():
        return get_types_from_msg(definition.data, channel.type)
    if definition.format == MessageDefinitionFormat.IDL:
        parts = definition.data.split(IDL_SEPARATOR)
        texts = [part.split("\n", 1)[1] for part in parts if part.startswith("IDL: ")] or [definition.data]
        return {name: fields for text in texts for name, fields in get_types_from_idl(text).items()}
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE).fielddefs
