"""Recordings made of text files with one topic each: what the CSV folder and the KITTI drive have in common."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

from holdfast.errors import RecordingError
from holdfast.messages import Message
from holdfast.recording.merge import SkippedMessages, merge_by_arrival
from holdfast.recording.source import Closing, Header, Subscription, TopicInfo, arrival_window, find_topic

TAIL_BYTES = 4096


class Track(Protocol):
    """One topic in one text file."""

    file: Path
    info: TopicInfo
    kinds: tuple[str, ...]
    """What it can be read as; the first is what it is without a configuration."""
    start_ns: int | None
    end_ns: int | None

    def messages(self, kind: str, sensor: str, skipped: SkippedMessages, warnings: list[str]) -> Iterator[Message]:
        """Read the file line by line as measurements of one of its kinds.

        Raises:
            RecordingError: a line cannot be read; the error names it.
        """


class TrackRecording(Closing):
    """Tracks as a recording; see `holdfast.recording.source.Recording` for the contract.

    Raises:
        RecordingError: no track has a message.
    """

    def __init__(self, path: Path, tracks: Sequence[Track]) -> None:
        self.path = path
        self.warnings: list[str] = []
        self.topics = tuple(track.info for track in tracks)
        self._tracks = [track for track in tracks if track.start_ns is not None]
        if not self._tracks:
            raise RecordingError(f"{path}: holds no messages")
        self.start_ns: int | None = min(track.start_ns for track in self._tracks if track.start_ns is not None)
        ends = [track.end_ns for track in self._tracks]
        self.end_ns: int | None = None if None in ends else max(end for end in ends if end is not None)

    def read(
        self, subscriptions: Sequence[Subscription], start_s: float = 0.0, duration_s: float | None = None
    ) -> Iterator[Message]:
        """Yield the subscribed messages in order of arrival; see the contract."""
        window = arrival_window(self, start_s, duration_s)
        for subscription in subscriptions:
            find_topic(self, subscription.topic)
        chosen = [
            (track, _checked(track, subscription))
            for track in self._tracks
            for subscription in subscriptions
            if subscription.topic == track.info.topic
        ]
        return (message for _, message in self._merge(chosen, *window))

    def read_headers(self, start_s: float = 0.0, duration_s: float | None = None) -> Iterator[Header]:
        """Yield the headers of all messages in order of arrival; see the contract."""
        window = arrival_window(self, start_s, duration_s)
        wanted = [(track, Subscription(track.info.topic, track.info.topic, track.kinds[0])) for track in self._tracks]
        rows = self._merge(wanted, *window)
        return (
            Header(track.info.topic, message.stamp_ns, message.arrival_ns, track.file.name, "", message)
            for track, message in rows
        )

    def close(self) -> None:
        """Do nothing: the files are open only while they are read."""

    def _merge(
        self, chosen: Sequence[tuple[Track, Subscription]], begin_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[Track, Message]]:
        skipped = SkippedMessages()
        parts = [(one[0].start_ns or 0, partial(self._rows, *one, skipped)) for one in chosen]
        try:
            for arrival_ns, track, message in merge_by_arrival(parts):
                if end_ns is not None and arrival_ns >= end_ns:
                    return
                if begin_ns is None or arrival_ns >= begin_ns:
                    yield track, message
        finally:
            self.warnings.extend(skipped.lines(str(self.path)))

    def _rows(
        self, track: Track, subscription: Subscription, skipped: SkippedMessages
    ) -> Iterator[tuple[int, Track, Message]]:
        latest_ns, backward = 0, 0
        try:
            for message in track.messages(subscription.kind, subscription.sensor, skipped, self.warnings):
                if message.arrival_ns < latest_ns:
                    backward += 1
                latest_ns = max(latest_ns, message.arrival_ns)
                yield message.arrival_ns, track, subscription.meant(message)
        except OSError as error:
            raise RecordingError(f"{track.file}: cannot be read ({error.strerror or error})") from None
        if backward:
            self.warnings.append(
                f"{track.file}: {backward} row(s) arrived before the row above them; the order of the file was kept"
            )


def _checked(track: Track, subscription: Subscription) -> Subscription:
    if subscription.kind not in track.kinds:
        raise RecordingError(
            f"{track.file}: topic {subscription.topic!r} is {track.info.type} with the columns of "
            f"{' or '.join(track.kinds)}, which is no {subscription.kind} (allowed: a file with the columns of "
            f"{subscription.kind})"
        )
    return subscription


def last_line(file: Path) -> str:
    """Return the last line of a text file that is not blank, or an empty string."""
    with file.open("rb") as stream:
        stream.seek(0, 2)
        stream.seek(max(0, stream.tell() - TAIL_BYTES))
        lines = stream.read().decode("utf-8", "replace").splitlines()
    return next((line for line in reversed(lines) if line.strip()), "")
