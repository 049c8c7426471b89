"""Writes standard ROS 2 messages into a bare .mcap file that survives a crash up to its last chunk."""

from io import BufferedWriter, FileIO
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from holdfast.errors import RecordingError
from holdfast.recording.source import Closing

CHUNK_BYTES = 1 << 18
"""About 2 s of what is written at 100 Hz: the most that a crash can lose."""


class McapWriter(Closing):
    """Writes messages in CDR, with their definitions, in chunks compressed with zstd.

    `types` makes message objects: `writer.types["std_msgs/msg/Header"](stamp=..., frame_id=...)`.

    Raises:
        RecordingError: the file cannot be created.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            self._file = _FlushedFile(FileIO(path, "wb"))
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written ({error.strerror})") from None
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._closed = False
        # the index of messages inside chunks is what rosbags and Foxglove seek by; CRCs find damaged chunks
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="holdfast")

    @property
    def types(self) -> dict[str, Any]:
        """Return the classes of the standard messages by name, such as `nav_msgs/msg/Odometry`."""
        return dict(self._store.types)

    def write(
        self, topic: str, message: object, type_name: str, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Write one message.

        Args:
            topic: a topic has one channel per type.
            message: an object of `types`, or its CDR as bytes.
            type_name: such as `nav_msgs/msg/Odometry`.
            log_time_ns: when it was recorded (arrival).
            publish_time_ns: when it was published; without it the same.

        Raises:
            RecordingError: the type is no standard message.
        """
        channel = self._channels.get((topic, type_name))
        if channel is None:
            channel = self._register(topic, type_name)
        if not isinstance(message, bytes):
            message = bytes(self._store.serialize_cdr(message, type_name))
        publish_time_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        # the times of the file have no sign
        self._writer.add_message(channel, max(log_time_ns, 0), message, max(publish_time_ns, 0))

    def note(self, name: str, data: dict[str, str]) -> None:
        """Write something about the file itself, as metadata that readers of messages do not see."""
        self._writer.add_metadata(name, data)

    def flush(self) -> None:
        """End the chunk, so that a crash loses nothing written so far."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close the file; closing twice does no harm."""
        if not self._closed:
            self._closed = True
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()

    def _register(self, topic: str, type_name: str) -> int:
        if type_name not in self._schemas:
            if type_name not in self._store.fielddefs:
                raise RecordingError(f"{topic}: {type_name!r} is no standard message (form: nav_msgs/msg/Odometry)")
            definition, _ = self._store.generate_msgdef(type_name, ros_version=2)
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", definition.encode())
        channel = self._writer.register_channel(topic, "cdr", self._schemas[type_name], {"offered_qos_profiles": ""})
        self._channels[topic, type_name] = channel
        return channel


class _FlushedFile(BufferedWriter):
    """A file that holds nothing back: the writer writes whole chunks, and each must survive a kill."""

    def write(self, data: Any, /) -> int:
        written = super().write(data)
        self.flush()
        return written
