"""Bags as raw messages, and their copy into an MCAP file: bytes pass through undecoded, with their own definitions."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from holdfast.errors import RecordingError
from holdfast.recording.bag_file import HEADER_TYPE, BagFile, Channel, Codec
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.merge import merge_by_arrival
from holdfast.recording.rosbag import RosbagRecording
from holdfast.recording.source import Closing, open_recording

ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


@dataclass(frozen=True, slots=True, eq=False)
class RawChannel:
    """One channel of one file of a bag."""

    file: Path
    ros1: bool
    channel: Channel

    @property
    def topic(self) -> str:
        """Return the name of the topic."""
        return self.channel.topic

    @property
    def type(self) -> str:
        """Return the type as in ROS 2, such as `sensor_msgs/msg/Imu`."""
        return self.channel.type

    def codec(self) -> Codec:
        """Return what decodes the messages.

        Raises:
            RecordingError: the definition cannot be used.
        """
        return Codec(self.channel, self.file, ros1=self.ros1)


RawRow = tuple[int, RawChannel, bytes]
"""Arrival [ns], channel, message as the bag holds it."""


class RawBag(Closing):
    """An open bag.

    Raises:
        RecordingError: there is no bag that can be read, or the recording is no bag.
    """

    def __init__(self, path: str | Path) -> None:
        recording = open_recording(path)
        if not isinstance(recording, RosbagRecording):
            recording.close()
            raise RecordingError(f"{path}: is no bag (allowed: .bag, .mcap, .db3, or the folder of a ROS 2 bag)")
        self.recording = recording
        self._files: list[tuple[BagFile, dict[int, RawChannel]]] = [
            (file, {channel.number: RawChannel(file.path, file.ros1, channel) for channel in file.channels})
            for file in recording._files
        ]
        self.channels = [channel for _, channels in self._files for channel in channels.values()]

    def messages(
        self, topics: Collection[str] | None = None, end_ns: int | None = None, begin_ns: int | None = None
    ) -> Iterator[RawRow]:
        """Yield messages in order of arrival.

        Args:
            topics: those that are wanted; None for all.
            end_ns: those that arrived before; None for all.
            begin_ns: those that did not arrive before; None for all.

        Raises:
            RecordingError: a file is damaged.
        """
        wanted = [
            (file, {number: one for number, one in channels.items() if topics is None or one.topic in topics})
            for file, channels in self._files
        ]
        return merge_by_arrival(
            [(file.start_ns, partial(_rows, file, some, begin_ns, end_ns)) for file, some in wanted if some]
        )

    def close(self) -> None:
        """Close the files."""
        self.recording.close()


def _rows(file: BagFile, channels: dict[int, RawChannel], begin_ns: int | None, end_ns: int | None) -> Iterator[RawRow]:
    for arrival_ns, number, raw in file.messages(set(channels), begin_ns, end_ns):
        yield arrival_ns, channels[number], raw


class RawCopier:
    """Copies raw messages into an MCAP file; those of ROS 1 become CDR, field by field.

    Topics whose definition the bag does not carry and that are no standard type cannot be read by anyone later: they
    are left out and listed in `left_out`.
    """

    def __init__(self, writer: McapWriter, channels: Sequence[RawChannel]) -> None:
        self._writer = writer
        self._stores: dict[RawChannel, Any] = {}
        self.left_out: list[str] = []
        for channel in channels:
            try:
                self._declare(channel)
            except Exception as error:  # the parser of definitions raises what its grammar happens to
                self.left_out.append(f"{channel.topic} ({channel.type}): its definition cannot be used: {error}")

    def copy(self, arrival_ns: int, channel: RawChannel, raw: bytes) -> None:
        """Write one message, unless its topic is left out."""
        if channel not in self._stores:
            return
        store = self._stores[channel]
        data = raw if store is None else bytes(store.ros1_to_cdr(raw, channel.type))
        self._writer.write(channel.topic, data, channel.type, arrival_ns)

    def _declare(self, channel: RawChannel) -> None:
        definition, store = channel.channel.definition, None
        encoding, text = ENCODINGS.get(definition.format, ""), definition.data
        if channel.ros1:
            store = _cdr_store(channel)
            encoding, (text, _) = "ros2msg", store.generate_msgdef(channel.type, ros_version=2)
        if encoding and text.strip():
            _define(self._writer, channel, encoding, text)
        elif channel.type not in self._writer.types:
            raise RecordingError("the bag does not carry it and it is no standard one")
        self._stores[channel] = store


def _define(writer: McapWriter, channel: RawChannel, encoding: str, text: str) -> None:
    """Make the writer write a channel with the bag's own definition in place of the standard one."""
    if (channel.topic, channel.type) not in writer._channels:
        schema = writer._writer.register_schema(channel.type, encoding, text.encode())
        qos = {"offered_qos_profiles": ""}
        writer._channels[channel.topic, channel.type] = writer._writer.register_channel(
            channel.topic, "cdr", schema, qos
        )


def _cdr_store(channel: RawChannel) -> Any:
    """Return a typestore with the ROS 1 definition of a channel and the header of ROS 2, which has no `seq`."""
    store = get_typestore(Stores.EMPTY)
    types = dict(get_types_from_msg(channel.channel.definition.data, channel.type))
    if HEADER_TYPE in types:
        types[HEADER_TYPE] = get_typestore(Stores.ROS2_HUMBLE).fielddefs[HEADER_TYPE]
    store.register(types)
    return store
