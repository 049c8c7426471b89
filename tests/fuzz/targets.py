"""What is fuzzed: every decoder and the configuration, each as a function of bytes, and the bounds that they keep.

Only `HoldfastError` may leave. Its lines are printable and not long. Memory stays below ten times the input and a
constant, time below a bound.
"""

import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import numpy as np
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from holdfast.config.load import parse_config, resolved_yaml
from holdfast.config.upgrade import upgraded
from holdfast.errors import HoldfastError
from holdfast.export.site_grid import localise, read_control_points
from holdfast.lidar_odometry.sweep import sweep_of
from holdfast.live.dds import Sample
from holdfast.live.inputs import Inputs
from holdfast.recording.bag_file import Channel, Codec
from holdfast.recording.covariance_csv import read_covariances
from holdfast.recording.decode import FieldDecoder, UndecodableError
from holdfast.recording.inspection import inspect
from holdfast.recording.kinds import KINDS
from holdfast.recording.kinds.scans import POINT_CLOUD
from holdfast.recording.recorded_frames import read_frames
from holdfast.recording.rosbag import DirectDecoder
from holdfast.recording.source import Subscription, open_recording
from holdfast.recording.tum import read_tum
from holdfast.replay.measurements import read_measurements
from holdfast.replay.results import read_events
from holdfast.replay.summary_file import read_summary
from holdfast.sim.scenario import load_scenario

MEMORY_RATIO = 10
MEMORY_BYTES = 96 << 20
"""A chunk of a bag may unpack to 64 MB, however small it is."""
SECONDS = 10.0
"""A configuration of 200 kB takes five."""
MAX_LINE = 1000
ARRIVAL_NS = 1_700_000_000_000_000_000
PAIRS = [(kind.name, type_name) for kind in KINDS.values() for type_name in kind.decoders]


class OutOfBoundsError(AssertionError):
    """A target did what it must not."""


def cdr(data: bytes) -> None:
    """One sample of the network: the first byte chooses kind and type. Both ways of reading it must agree."""
    if not data:
        return
    kind, type_name = PAIRS[data[0] % len(PAIRS)]
    inputs = _inputs(kind, type_name)
    messages = inputs.decode(Sample("/topic", type_name, data[1:]), ARRIVAL_NS)
    codec, decoder = _codec(type_name), inputs._decoders["/topic", type_name][0]
    if not messages or not isinstance(decoder, FieldDecoder):
        return
    direct = DirectDecoder(codec, decoder)
    direct.learn(data[1:], codec.deserialize(data[1:]))
    found = direct(data[1:], ARRIVAL_NS)
    if found is not None:
        same = np.array_equal(np.array(found.values()), np.array(messages[0].values()), equal_nan=True)
        if not same or found.stamp_ns != messages[0].stamp_ns:
            raise OutOfBoundsError(f"{type_name}: read directly it is another {kind}")


def csv(data: bytes) -> None:
    """The one file of a CSV folder."""
    with _file("drive", "topic.csv", data) as path:
        _read(path.parent)


def mcap(data: bytes) -> None:
    """A ROS 2 bag as MCAP."""
    with _file("", "drive.mcap", data) as path:
        _read(path)


def db3(data: bytes) -> None:
    """A ROS 2 bag as sqlite3."""
    with _file("", "drive.db3", data) as path:
        _read(path)


def bag(data: bytes) -> None:
    """A ROS 1 bag."""
    with _file("", "drive.bag", data) as path:
        _read(path)


def metadata(data: bytes) -> None:
    """The description of a ROS 2 bag, beside its file."""
    with _file("folder", "metadata.yaml", data) as path:
        path.with_name("drive.mcap").write_bytes(_small_mcap())
        _read(path.parent)


def tum(data: bytes) -> None:
    """A trajectory."""
    with _file("", "track.tum", data) as path:
        read_tum(path)


def config(data: bytes) -> None:
    """A configuration: what is accepted is written and read again as the same one."""
    text = data.decode("utf-8", "replace")
    read = parse_config(text)
    if parse_config(resolved_yaml(read)) != read:
        raise OutOfBoundsError("what was resolved is another configuration")


def cloud(data: bytes) -> None:
    """A PointCloud2 of the network, down to its points and their times."""
    for message in _inputs("scans", POINT_CLOUD).decode(Sample("/topic", POINT_CLOUD, data), ARRIVAL_NS):
        with suppress(UndecodableError):
            sweep_of(message)


def frames(data: bytes) -> None:
    """A bag with transforms and joints, from which a configuration is proposed."""
    with _file("", "drive.mcap", data) as path, open_recording(path) as recording:
        read_frames(recording, 10.0)


def scenario(data: bytes) -> None:
    """A scenario of the simulator, with its machine and site."""
    with _file("", "scenario.yaml", data) as path:
        load_scenario(str(path))


def points(data: bytes) -> None:
    """Control points of a site grid: the first byte chooses CSV or YAML."""
    with _file("", "points.csv" if data[:1] == b"," else "points.yaml", data[1:]) as path:
        localise(read_control_points(path), "grid")


def results(data: bytes) -> None:
    """What a replay has written, read again: the first byte chooses the file."""
    readers = ("summary.json", read_summary), ("events.jsonl", read_events), ("measurements.csv", read_measurements)
    name, read = readers[data[0] % len(readers)] if data else readers[0]
    with _file("out", name, data[1:]) as path:
        read(path if name.endswith(".csv") else path.parent)


def covariances(data: bytes) -> None:
    """The covariances beside a smoothed track."""
    with _file("", "imu_in_world.covariance.csv", data) as path:
        read_covariances(path)


def upgrade(data: bytes) -> None:
    """A configuration of an old form."""
    upgraded(data.decode("utf-8", "replace"), "machine.yaml")


TARGETS: dict[str, Callable[[bytes], None]] = {
    one.__name__: one
    for one in (
        *(cdr, cloud, csv, mcap, db3, bag, metadata, frames, tum, covariances, results),
        *(config, upgrade, scenario, points),
    )
}


def check(target: str, data: bytes) -> None:
    """Run a target on an input.

    Raises:
        OutOfBoundsError: it did not keep its bounds.
        Exception: whatever the target let through.
    """
    began_s, before = time.process_time(), _begin_peak()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            TARGETS[target](data)
    except HoldfastError as error:
        lines = str(error).split("\n")
        if not all(line.isprintable() and len(line) <= MAX_LINE for line in lines):
            raise OutOfBoundsError(f"an error that cannot be printed: {lines!r:.2000}") from None
    peak = _resident("VmHWM") - before
    if peak > MEMORY_RATIO * len(data) + MEMORY_BYTES:
        raise OutOfBoundsError(f"{len(data)} bytes took {peak} bytes of memory")
    if time.process_time() - began_s > SECONDS:
        raise OutOfBoundsError(f"{len(data)} bytes took {time.process_time() - began_s:.1f} s")


def _begin_peak() -> int:
    """Return the memory that this process holds [bytes], and let its peak begin anew (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _resident("VmRSS")


def _resident(name: str) -> int:
    """Return a size of this process [bytes]; 0 where there is no /proc."""
    with suppress(OSError):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))
    return 0


class _DeafNetwork:
    def subscribe(self, *_: object, **__: object) -> None:
        """Do nothing."""


@cache
def _inputs(kind: str, type_name: str) -> Inputs:
    inputs = Inputs(_DeafNetwork(), [Subscription("/topic", "sensor", kind, "turn" if kind == "joint" else None)])  # type: ignore[arg-type]
    assert ("/topic", type_name) in inputs._decoders
    return inputs


@cache
def _codec(type_name: str) -> Codec:
    none = MessageDefinition(MessageDefinitionFormat.NONE, "")
    return Codec(Channel(1, "/topic", type_name, none, "", 1), Path("drive.mcap"), ros1=False)


@contextmanager
def _file(folder: str, name: str, data: bytes):
    with tempfile.TemporaryDirectory(prefix="holdfast-fuzz-", dir=_memory()) as place:
        path = Path(place) / folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        yield path


@cache
def _memory() -> str | None:
    """Where files are not written to a disk, if there is such a place."""
    return "/dev/shm" if sys.platform.startswith("linux") and Path("/dev/shm").is_dir() else None


def _read(path: Path) -> None:
    """Read a recording in both ways: as `holdfast info` does, and what it holds as measurements."""
    with open_recording(path) as recording:
        inspect(recording)
        asked = [
            Subscription(info.topic, "sensor", kind.name, "turn" if kind.name == "joint" else None)
            for info in recording.topics
            for kind in KINDS.values()
            if info.type in kind.decoders
        ]
        for one in asked[:20]:
            try:
                for _ in recording.read([one]):
                    pass
            except HoldfastError:
                continue
        for line in recording.warnings:
            if not line.isprintable() or len(line) > MAX_LINE:
                raise OutOfBoundsError(f"a warning that cannot be printed: {line!r:.2000}")


@cache
def _small_mcap() -> bytes:
    """An MCAP file with one Imu."""
    from holdfast.recording.mcap_writer import McapWriter

    with tempfile.TemporaryDirectory(prefix="holdfast-fuzz-", dir=_memory()) as place:
        with McapWriter(Path(place) / "one.mcap") as writer:
            writer.write("/imu", example("sensor_msgs/msg/Imu"), "sensor_msgs/msg/Imu", ARRIVAL_NS)
        return (Path(place) / "one.mcap").read_bytes()


def example(type_name: str, store_name: Stores = Stores.ROS2_HUMBLE) -> bytes:
    """Return a message of a standard type as CDR (ROS 1: as ROS 1 has it), its strings and sequences not empty."""
    store = get_typestore(store_name)
    made = _made(store, type_name)
    is_ros1 = store_name is Stores.ROS1_NOETIC
    return bytes((store.serialize_ros1 if is_ros1 else store.serialize_cdr)(made, type_name))


def _made(store, type_name):
    fields = [(name, _value(store, kind)) for name, kind in store.fielddefs[type_name][1]]
    made = store.types[type_name](**dict(fields))
    if type_name == "geometry_msgs/msg/Quaternion":
        made.x = made.y = made.z = 0.0
    return made


def _value(store, description):
    kind, detail = int(description[0]), description[1]
    if kind == 1:
        return "turn" if detail[0] == "string" else True if detail[0] == "bool" else 1
    if kind == 2:
        return _made(store, detail)
    inner, count = detail
    count = count if kind == 3 else 2
    if int(inner[0]) == 1 and inner[1][0] != "string":
        code = {"float64": "d", "float32": "f", "uint8": "B", "int8": "b", "int32": "i"}.get(inner[1][0], "i")
        return np.frombuffer(struct.pack(f"<{count}{code}", *[1] * count), dtype=np.dtype(f"<{code}"))
    return [_value(store, inner) for _ in range(count)]
