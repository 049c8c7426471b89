"""Where a scene is shown, and what is drawn into it: a recording, the results of a replay, or a live stream."""

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import rerun as rr

from holdfast.errors import ConfigError
from holdfast.geometry.earth import Geodetic
from holdfast.printable import one_line
from holdfast.recording.bag_file import Codec
from holdfast.recording.raw import RawBag, RawChannel
from holdfast.replay.outputs import ESTIMATES, EVENTS, SUMMARY
from holdfast.replay.results import read_events
from holdfast.replay.summary_file import datum_in, read_summary
from holdfast.viz.scene import DATUM, FIX, Scene
from holdfast.viz.viewer import DISPLAYS, a_display, check_viewer, open_viewer

APPLICATION = "holdfast"
FLUSH_ROWS = 20_000
LIVE_FLUSH_S = 0.25
FOR_EVER_S = 1e38  # as the SDK has it
LIVE_END_S = 3.0  # for what is left at the end of a live stream
WITHOUT_DISPLAY = "write a file *.rrd, or name a viewer that runs, as --help says"


def open_sink(target: str, name: str) -> rr.RecordingStream:
    """Return a recording of Rerun.

    Args:
        target: `window` opens the viewer, `....rrd` writes a file, `rerun+http://HOST:PORT/proxy` joins a viewer.
        name: what the recording is called.

    Raises:
        ConfigError: the target cannot be opened.
    """
    if target == "window" and sys.platform == "linux" and not any(map(os.environ.get, DISPLAYS)):
        raise ConfigError(f"window: there is no display ({', '.join(DISPLAYS)} are not set): {WITHOUT_DISPLAY}")
    if target != "window" and not target.endswith(".rrd"):
        check_viewer(target)
    recording = rr.RecordingStream(APPLICATION)
    recording.send_recording_name(one_line(name))
    try:
        if target == "window":
            recording.connect_grpc(open_viewer())
        elif target.endswith(".rrd"):
            recording.save(target)
        else:
            recording.connect_grpc(target)
    except (OSError, RuntimeError) as error:
        raise ConfigError(f"{target}: cannot be opened ({error})") from None
    return recording


def close_sink(recording: rr.RecordingStream, target: str, within_s: float = FOR_EVER_S) -> None:
    """Send what is left to where a recording was opened, and end it.

    Raises:
        ConfigError: not all could be sent: the viewer is gone, or the disk is full.
    """
    where = f"{target} at {a_display()}" if target == "window" else target
    try:
        recording.flush(timeout_sec=within_s)
    except RuntimeError as error:
        reason = "is the disk full?" if target.endswith(".rrd") else "does the viewer run?"
        raise ConfigError(f"{where}: not all could be drawn ({error}): {reason}") from None
    recording.disconnect()


def draw_recording(path: Path, recording: rr.RecordingStream, progress: Callable[[int], None] | None = None) -> None:
    """Draw a bag, or the output folder of a replay.

    Args:
        path: of either.
        recording: where to draw; `close_sink` sends what is left.
        progress: called with the arrival [ns] every now and then.

    Raises:
        RecordingError: it cannot be read.
    """
    is_replay = (path / ESTIMATES).is_file()
    with RawBag(path / ESTIMATES if is_replay else path) as bag:
        codecs = {channel: channel.codec() for channel in bag.channels}
        scene = Scene(recording, _datum_of_replay(path) if is_replay else _first_datum(bag, codecs))
        for count, (time_ns, channel, raw) in enumerate(bag.messages()):
            if scene.wants(channel.topic, channel.type, time_ns):
                scene.add(channel.topic, channel.type, codecs[channel].deserialize(raw), time_ns)
            if count % FLUSH_ROWS == FLUSH_ROWS - 1:
                scene.flush()
                if progress is not None:
                    progress(time_ns)
        if is_replay:
            _add_events(path, scene)
        scene.flush()


def _datum_of_replay(folder: Path) -> Geodetic | None:
    return datum_in(read_summary(folder)) if (folder / SUMMARY).is_file() else None


def _first_datum(bag: RawBag, codecs: Mapping[RawChannel, Codec]) -> Geodetic | None:
    """Return the datum that a log of a live node holds: the first fixes come before it."""
    if any(channel.topic.endswith(DATUM) and channel.type == FIX for channel in bag.channels):
        for _, channel, raw in bag.messages():
            if channel.topic.endswith(DATUM) and channel.type == FIX:
                message = codecs[channel].deserialize(raw)
                return Geodetic(message.latitude, message.longitude, message.altitude)
    return None


def _add_events(folder: Path, scene: Scene) -> None:
    for event in read_events(folder) if (folder / EVENTS).is_file() else []:
        sensor = f"{event['sensor']}: " if event["sensor"] else ""
        scene.write("log/events", f"{sensor}{event['kind']}: {event['reason']}", "INFO", event["stamp_ns"])


class LiveRecord(Protocol):
    """One message of a live node."""

    topic: str
    type_name: str
    data: bytes
    time_ns: int


class LiveFeed(Protocol):
    """What feeds a live stream."""

    def batches(self, timeout_s: float | None = None) -> Iterable[Sequence[LiveRecord]]:
        """Iterate over lists of messages; an empty one if none came for so long."""

    def complain(self, text: str) -> None:
        """Report a fault to the node."""


def draw_live(feed: LiveFeed, target: str) -> None:
    """Draw the inputs and outputs of a live node until its feed ends; to be run in a process of its own."""
    from time import monotonic

    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        recording = open_sink(target, "live")
    except ConfigError as error:
        feed.complain(f"--view {error}")
        return
    scene, flushed = Scene(recording, awaits_datum=True), monotonic()
    for batch in feed.batches(LIVE_FLUSH_S):
        for record in batch:
            if scene.wants(record.topic, record.type_name, record.time_ns):
                message = store.deserialize_cdr(record.data, record.type_name)
                scene.add(record.topic, record.type_name, message, record.time_ns)
        if monotonic() - flushed > LIVE_FLUSH_S:
            flushed = monotonic()
            scene.flush()
    scene.flush()
    try:
        close_sink(recording, target, LIVE_END_S)
    except ConfigError as error:
        feed.complain(f"--view {error}")
