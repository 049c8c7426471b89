"""ROS 1 and ROS 2 bags: one file or several, whole or cut off, read as one recording."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from holdfast.errors import RecordingError
from holdfast.measured_fields import is_stamp
from holdfast.messages import Message
from holdfast.printable import listed
from holdfast.recording.bag_file import BagFile, Channel, Codec, IndexedBagFile
from holdfast.recording.cut_mcap import StreamedMcap, has_summary
from holdfast.recording.decode import Decoder, FieldDecoder
from holdfast.recording.fixed_layout import FixedLayout
from holdfast.recording.kinds import default_decoder, make_decoder
from holdfast.recording.merge import SkippedMessages, merge_by_arrival
from holdfast.recording.source import Closing, Header, Subscription, TopicInfo, arrival_window, find_topic

MAX_METADATA_BYTES = 500_000
"""Of a metadata.yaml; reading it takes 15 s at most."""


@dataclass(slots=True)
class Route:
    """What happens to the messages of one channel."""

    topic: str
    publisher: str
    codec: Codec | None
    decoders: list[Decoder] = field(default_factory=list)
    direct: "DirectDecoder | None" = None


class DirectDecoder:
    """Reads what the one decoder of a channel needs from the bytes of messages that are laid out like the first."""

    def __init__(self, codec: Codec, decoder: FieldDecoder) -> None:
        self._codec, self._decoder = codec, decoder
        self._layout: FixedLayout | None = None
        self._has_learnt = False

    def __call__(self, raw: bytes, arrival_ns: int) -> Message | None:
        """Return the measurement; None where only the general decoder can tell it, or what is wrong."""
        values = None if self._layout is None else self._layout.read(raw)
        try:
            return None if values is None else self._decoder.build(arrival_ns, *values)
        except Exception:  # the general decoder raises it again
            return None

    def learn(self, raw: bytes, message: Any) -> None:
        """Take in how the first message is laid out, if that leads to what the general decoder made of it."""
        if self._has_learnt:
            return
        self._has_learnt = True
        layout = self._codec.layout(self._decoder.fields, raw)
        if layout is None:  # what the file defines may lack the fields at all
            return
        expected = [one if np.isscalar(one) else tuple(one) for one in self._decoder.values_of(message)]
        if layout.read(raw) == tuple(expected):
            self._layout = layout


Routes = dict[int, Route]
Routed = tuple[int, Route, bytes]


def open_files(path: Path, files: Sequence[Path]) -> "RosbagRecording":
    """Open a bag; without `files` the folder's metadata.yaml names them.

    Raises:
        RecordingError: a file cannot be read, or there is no message in any.
    """
    warnings: list[str] = []
    if not files:
        files = _files_of_metadata(path, warnings)
    opened: list[BagFile] = []
    try:
        for file in files:
            opened.append(_open_file(file))  # noqa: PERF401 (what was opened must be closed if the next one fails)
        recording = RosbagRecording(path, opened, warnings)
        if not any(info.count for info in recording.topics):
            raise RecordingError(f"{path}: the bag holds no messages")
    except BaseException:
        for bag in opened:
            bag.close()
        raise
    return recording


def _files_of_metadata(folder: Path, warnings: list[str]) -> list[Path]:
    """Return the files of a ROS 2 bag folder, or the folder itself if they are compressed as a whole.

    A folder whose metadata.yaml was lost in a crash is read by the files that lie in it.
    """
    from ruamel.yaml import YAML

    try:
        if (folder / "metadata.yaml").stat().st_size > MAX_METADATA_BYTES:
            raise ValueError("too large")
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
        metadata: Any = YAML(typ="safe", pure=True).load(text)["rosbag2_bagfile_information"]
        names = [PurePath(name).name for name in metadata["relative_file_paths"]]
        given = metadata.get("compression_mode", "") or "none"
        mode = given.lower() if isinstance(given, str) else "none"
    except Exception as error:  # any kind of damage to the file has the same consequence
        files = sorted(file for file in folder.iterdir() if file.suffix in {".mcap", ".db3"} and file.stat().st_size)
        if not files:
            raise RecordingError(
                f"{folder / 'metadata.yaml'}: is damaged ({type(error).__name__}), no bag beside it"
            ) from None
        warnings.append(
            f"{folder / 'metadata.yaml'}: is damaged, so {', '.join(f.name for f in files)} is read without it"
        )
        return files
    if mode in {"file", "message"}:
        return [folder]
    missing = [name for name in names if not (folder / name).exists()]
    if missing or not names:
        raise RecordingError(f"{folder}: metadata.yaml names files that are missing: {listed(missing) or 'none given'}")
    return [folder / name for name in names]


def _open_file(path: Path) -> BagFile:
    if path.suffix != ".mcap":
        return IndexedBagFile(path)
    if not has_summary(path):
        return StreamedMcap(path)
    try:
        indexed = IndexedBagFile(path)
    except RecordingError:
        return StreamedMcap(path)
    if indexed.indexed:
        return indexed
    indexed.close()
    return StreamedMcap(path)


class RosbagRecording(Closing):
    """A bag as a recording; see `holdfast.recording.source.Recording` for the contract."""

    def __init__(self, path: Path, files: Sequence[BagFile], warnings: list[str]) -> None:
        self.path = path
        self._files = [file for file in files if any(channel.count for channel in file.channels)]
        self.warnings = [*warnings, *(warning for file in files for warning in file.warnings)]
        self.topics = _list_topics([channel for file in files for channel in file.channels])
        self.start_ns = min((file.start_ns for file in self._files), default=None)
        self.end_ns = max((file.end_ns for file in self._files), default=None)
        self._closers: list[Callable[[], None]] = [file.close for file in files]

    def read(
        self, subscriptions: Sequence[Subscription], start_s: float = 0.0, duration_s: float | None = None
    ) -> Iterator[Message]:
        """Yield the subscribed messages in order of arrival; see the contract."""
        begin_ns, end_ns = arrival_window(self, start_s, duration_s)
        for subscription in subscriptions:
            find_topic(self, subscription.topic)
        routes = [self._subscribed_routes(file, subscriptions) for file in self._files]
        return self._decode(self._merge(routes, begin_ns, end_ns))

    def read_headers(self, start_s: float = 0.0, duration_s: float | None = None) -> Iterator[Header]:
        """Yield the headers of all messages in order of arrival; see the contract."""
        begin_ns, end_ns = arrival_window(self, start_s, duration_s)
        routes = [self._all_routes(file) for file in self._files]
        return self._peek(self._merge(routes, begin_ns, end_ns))

    def close(self) -> None:
        """Close the files."""
        for close in self._closers:
            close()

    def _subscribed_routes(self, file: BagFile, subscriptions: Sequence[Subscription]) -> Routes:
        routes: Routes = {}
        for channel in file.channels:
            asked = [subscription for subscription in subscriptions if subscription.topic == channel.topic]
            decoders = [make_decoder(subscription, channel.type, str(file.path)) for subscription in asked]
            if decoders:
                codec = Codec(channel, file.path, ros1=file.ros1)
                only = decoders[0] if len(decoders) == 1 else None
                direct = DirectDecoder(codec, only) if isinstance(only, FieldDecoder) else None
                routes[channel.number] = Route(channel.topic, channel.publisher, codec, decoders, direct)
        return routes

    def _all_routes(self, file: BagFile) -> Routes:
        routes: Routes = {}
        for channel in file.channels:
            decoder = default_decoder(channel.topic, channel.type)
            try:
                codec = Codec(channel, file.path, ros1=file.ros1)
            except RecordingError:
                codec = None
            routes[channel.number] = Route(channel.topic, channel.publisher, codec, [decoder] if decoder else [])
        return routes

    def _merge(self, routes: Sequence[Routes], begin_ns: int | None, end_ns: int | None) -> Iterator[Routed]:
        pairs = list(zip(self._files, routes, strict=True))
        if len(pairs) == 1:
            return _routed(*pairs[0], begin_ns, end_ns)
        return merge_by_arrival(
            [(file.start_ns, partial(_routed, file, routes_, begin_ns, end_ns)) for file, routes_ in pairs]
        )

    def _decode(self, messages: Iterator[Routed]) -> Iterator[Message]:
        skipped = SkippedMessages()
        try:
            for arrival_ns, route, raw in messages:
                assert route.codec is not None
                direct = None if route.direct is None else route.direct(raw, arrival_ns)
                if direct is not None:
                    yield direct
                    continue
                try:
                    message = route.codec.deserialize(raw)
                except Exception as error:  # damaged bytes raise anything; one message must not end a replay
                    skipped.add(route.topic, arrival_ns, error)
                    continue
                if route.direct is not None:
                    route.direct.learn(raw, message)
                for decode in route.decoders:  # of several sensors: what is none of one may well be another
                    try:
                        decoded = decode(message, arrival_ns)
                    except RecordingError as error:
                        raise RecordingError(f"{self.path}: {error} (at {arrival_ns} ns)") from None
                    except Exception as error:
                        skipped.add(route.topic, arrival_ns, error)
                    else:
                        yield decoded
        finally:
            self.warnings.extend(skipped.lines(str(self.path)))

    def _peek(self, messages: Iterator[Routed]) -> Iterator[Header]:
        skipped = SkippedMessages()
        try:
            for arrival_ns, route, raw in messages:
                if not is_stamp(arrival_ns):
                    skipped.add(route.topic, arrival_ns, ValueError("its time of arrival has more than 64 bits"))
                    continue
                stamp_ns, frame_id, message = None, "", None
                try:
                    if route.codec is not None and route.codec.has_header:
                        stamp_ns, frame_id = route.codec.peek(raw)
                    if route.codec is not None and route.decoders:
                        message = route.decoders[0](route.codec.deserialize(raw), arrival_ns)
                except Exception as error:  # as above
                    skipped.add(route.topic, arrival_ns, error)
                yield Header(route.topic, stamp_ns, arrival_ns, route.publisher, frame_id, message)
        finally:
            self.warnings.extend(skipped.lines(str(self.path)))


def _routed(file: BagFile, routes: Routes, begin_ns: int | None, end_ns: int | None) -> Iterator[Routed]:
    if not routes:  # rosbags takes an empty selection for all channels
        return
    for arrival_ns, number, raw in file.messages(set(routes), begin_ns, end_ns):
        yield arrival_ns, routes[number], raw


def _list_topics(channels: Sequence[Channel]) -> tuple[TopicInfo, ...]:
    by_topic: dict[str, list[Channel]] = {}
    for channel in channels:
        by_topic.setdefault(channel.topic, []).append(channel)
    return tuple(
        TopicInfo(
            topic, " | ".join(sorted({channel.type for channel in group})), sum(channel.count for channel in group)
        )
        for topic, group in sorted(by_topic.items())
    )
