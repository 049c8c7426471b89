"""The contract of a recording: topics in it, messages out of it in the order in which they arrived.

`open_recording` chooses the reader by what lies at the path. Every reader is lazy: memory does not grow with the file.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from holdfast.errors import RecordingError
from holdfast.messages import ImuSample, Message
from holdfast.printable import listed, quoted

NS_PER_S = 1_000_000_000
LONGEST_S = 1e9
"""No recording is longer; with what is, arithmetic in nanoseconds overflows."""
SHIPPED = "kitti"
"""Name of the drive that ships inside the gtsam wheel; a file or folder of this name goes first."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a recording.

    Attributes:
        type: name of the message type as in ROS 2, such as `sensor_msgs/msg/Imu`; a CSV file has the type that its
            columns stand for, and a topic that was recorded with several types has them joined by ` | `.
        count: number of messages, or None where that needs reading the whole file.
    """

    topic: str
    type: str
    count: int | None


@dataclass(frozen=True, slots=True)
class Subscription:
    """Asks for one topic as measurements of one sensor.

    Attributes:
        sensor: name that the messages carry, as in the configuration.
        kind: name of a row in `holdfast.recording.kinds`: what the messages are decoded to.
        joint_name: which joint of a JointState; needed if the message has several.
        factors: (6,) by which the readings of an IMU are multiplied, of the gyroscope first; None for as they are.
    """

    topic: str
    sensor: str
    kind: str
    joint_name: str | None = None
    factors: tuple[float, ...] | None = None

    def meant(self, message: Message) -> Message:
        """Return a decoded message as its sensor means it: what an IMU says, times the factors."""
        if self.factors is None or not isinstance(message, ImuSample):
            return message
        values = np.multiply(message.values(), self.factors)
        return ImuSample.of(message.stamp_ns, message.arrival_ns, message.sensor, values)


@dataclass(frozen=True, slots=True)
class Header:
    """What is known of any message: when it was measured, when it arrived and from whom.

    Attributes:
        stamp_ns: the header's stamp, or None if the type has no header.
        publisher: node name in ROS 1, number of the channel in ROS 2, name of the file in a CSV folder.
        frame_id: empty if the type has no header.
        message: the decoded measurement, or None if the type is none that Holdfast decodes or the message is damaged.
    """

    topic: str
    stamp_ns: int | None
    arrival_ns: int
    publisher: str
    frame_id: str
    message: Message | None


class Closing(Protocol):
    """What is closed at the end of its `with` block, also after an error."""

    def close(self) -> None:
        """Close the files."""

    def __enter__(self) -> Self:
        """Return the object itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the files."""
        self.close()


class Recording(Closing, Protocol):
    """An open recording."""

    @property
    def path(self) -> Path:
        """Return the path as the user gave it."""

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """Return the topics, sorted by name."""

    @property
    def start_ns(self) -> int | None:
        """Return the arrival of the first message of any topic, or None if it is unknown."""

    @property
    def end_ns(self) -> int | None:
        """Return the arrival of the last message of any topic, or None if that needs reading the whole file."""

    @property
    def warnings(self) -> list[str]:
        """Return what was wrong but not fatal, one line each; reading adds to it when it ends."""

    def read(
        self, subscriptions: Sequence[Subscription], start_s: float = 0.0, duration_s: float | None = None
    ) -> Iterator[Message]:
        """Yield the subscribed messages in order of arrival.

        A message that cannot be decoded is skipped, counted and named in `warnings` when the iterator ends.

        Args:
            subscriptions: several may name the same topic.
            start_s: skips what arrived earlier than this long after `start_ns`.
            duration_s: stops this long after `start_s`.

        Raises:
            RecordingError: at the call if a topic is absent or of the wrong type; later if the file is damaged.
        """

    def read_headers(self, start_s: float = 0.0, duration_s: float | None = None) -> Iterator[Header]:
        """Yield the header of every message of every topic in order of arrival; arguments and errors as in `read`."""


def open_recording(path: str | Path) -> Recording:
    """Open whatever recording lies at a path.

    A ROS 1 `.bag`, a ROS 2 `.mcap` or `.db3`, a folder of a ROS 2 bag with or without its metadata.yaml, a folder of
    CSV files, or the name `kitti` for the drive that ships inside the gtsam wheel.

    Raises:
        RecordingError: there is nothing that can be read; one line with what was found and what is allowed.
    """
    path = Path(path)
    try:
        reader, files = _choose_reader(path)
        module = import_module(f"holdfast.recording.{reader}")
        recording: Recording = module.open_files(path, files)
    except OSError as error:
        raise RecordingError(f"{error.filename or path}: cannot be opened ({error.strerror or error})") from None
    return recording


def _choose_reader(path: Path) -> tuple[str, list[Path]]:
    if path.exists():
        return _choose_folder_reader(path) if path.is_dir() else _choose_file_reader(path)
    if is_shipped(path):
        return "kitti", []
    raise RecordingError(f"{path}: no such file or folder")


def is_shipped(path: Path) -> bool:
    """Whether a path is the name of the drive that needs no file."""
    return str(path) == SHIPPED and not path.exists()


def _choose_file_reader(path: Path) -> tuple[str, list[Path]]:
    if path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty")
    if path.suffix not in {".bag", ".mcap", ".db3"}:
        raise RecordingError(f"{path}: is not a recording (allowed: .bag, .mcap, .db3, or a folder)")
    return "rosbag", [path]


def _choose_folder_reader(path: Path) -> tuple[str, list[Path]]:
    if (path / "metadata.yaml").exists():
        return "rosbag", []
    for suffix in (".mcap", ".db3", ".bag", ".csv"):
        files = sorted(file for file in path.glob(f"*{suffix}") if file.stat().st_size > 0)
        if files:
            return "csv_folder" if suffix == ".csv" else "rosbag", files
    found = sorted(file.name for file in path.iterdir())[:5]
    raise RecordingError(
        f"{path}: the folder holds no recording (found: {listed(found) or 'nothing'}; "
        "allowed: metadata.yaml with its files, or non-empty .mcap, .db3, .bag or .csv files)"
    )


def find_topic(recording: Recording, topic: str) -> TopicInfo:
    """Return one topic of a recording.

    Raises:
        RecordingError: it is absent; the line lists the topics that are there and guesses which one was meant.
    """
    topics = {info.topic: info for info in recording.topics}
    if topic in topics:
        return topics[topic]
    close = get_close_matches(topic, topics, n=1)
    guess = f"did you mean {quoted(close[0])!r}? " if close else ""
    there = listed([f"{info.topic} ({info.type})" for info in topics.values()])
    left_out = [warning for warning in recording.warnings if f"{topic}.csv:" in warning]
    missing = f"{recording.path}: has no topic {quoted(topic)!r}"
    raise RecordingError("; ".join([missing, *left_out, f"{guess}it has {there}"]))


def arrival_window(recording: Recording, start_s: float, duration_s: float | None) -> tuple[int | None, int | None]:
    """Return the first arrival that is wanted and the first that is not any more [ns]; None is without limit.

    Raises:
        RecordingError: the window is empty, or begins after the recording ends.
    """
    if not 0 <= start_s <= LONGEST_S:
        raise RecordingError(f"{recording.path}: start is {start_s} s (allowed: 0 or more, up to {LONGEST_S:g})")
    if duration_s is not None and not 0 < duration_s <= LONGEST_S:
        raise RecordingError(
            f"{recording.path}: duration is {duration_s} s (allowed: more than 0, up to {LONGEST_S:g})"
        )
    first, last = recording.start_ns, recording.end_ns
    if first is None or (start_s == 0 and duration_s is None):
        return None, None
    begin = first + round(start_s * NS_PER_S)
    if last is not None and begin > last:
        length_s = (last - first) / NS_PER_S
        raise RecordingError(f"{recording.path}: start is {start_s} s but the recording lasts {length_s:.3f} s")
    end = None if duration_s is None else begin + round(duration_s * NS_PER_S)
    return begin, end
