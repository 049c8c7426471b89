"""Valid inputs of every target, from which fuzzing begins: small, and made anew when they are needed."""

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from targets import ARRIVAL_NS, PAIRS, example

from holdfast.covariances import Covariances
from holdfast.recording.covariance_csv import CovarianceWriter
from holdfast.recording.kinds import KINDS
from holdfast.replay.measurements import COLUMNS

ROOT = Path(__file__).parents[2]
TYPES = sorted({type_name for _, type_name in PAIRS} & get_typestore(Stores.ROS2_HUMBLE).fielddefs.keys())
CONTAINED = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState")
CONTAINED_TOPICS = {f"/t{k}": name for k, name in enumerate(CONTAINED)}
OLD = """\
preset: paper
sensors:
  imu: {topic: /imu}
  lidar: {topic: /lidar}
  joint:
graph: {main_lidar: relative, lag_s: 2}
gate: {witness: true}
extrinsics: [{parent: imu, child: lidar, translation_m: [0, 0, 1]}]
"""
METADATA = """\
rosbag2_bagfile_information:
  version: 5
  relative_file_paths: [drive.mcap]
  compression_mode: ''
"""


POINTS = """\
name,latitude_deg,longitude_deg,altitude_m,east_m,north_m,height_m
a,47.0,8.0,400,1000,2000,350
b,47.001,8.0,401,1000,2111.2,351
c,47.0,8.001,402,1076,2000,
"""
POINT_LIST = """\
height: plane
points:
  - {latitude_deg: 47.0, longitude_deg: 8.0, altitude_m: 400, east_m: 1000, north_m: 2000, height_m: 350}
  - {latitude_deg: 47.001, longitude_deg: 8.0, altitude_m: 401, east_m: 1000, north_m: 2111.2, height_m: 351}
  - {latitude_deg: 47.0, longitude_deg: 8.001, altitude_m: 402, east_m: 1076, north_m: 2000, height_m: 352}
"""


def seeds(target: str) -> dict[str, bytes]:
    """Return valid inputs by name."""
    makers = {
        "cdr": _cdr, "csv": _csv, "mcap": _mcap, "db3": _db3, "bag": _bag, "config": _config,
        "cloud": _cloud, "frames": _frames, "covariances": _covariances, "results": _results, "scenario": _scenario,
        "points": lambda: {"table": b"," + POINTS.encode(), "list": b"-" + POINT_LIST.encode()},
        "metadata": lambda: {"metadata": METADATA.encode()}, "upgrade": lambda: _config() | {"old": OLD.encode()},
        "tum": lambda: {"track": b"# t x y z qx qy qz qw\n1.000000001 1 2 3 0 0 0 1\n2.0 1e0 2 3 0 0 0.6 0.8\n"},
    }  # fmt: skip
    return makers[target]()


def _cdr() -> dict[str, bytes]:
    return {
        f"{kind}-{type_name.rpartition('/')[2]}": bytes([number]) + example(type_name)
        for number, (kind, type_name) in enumerate(PAIRS)
        if type_name in TYPES
    }


def _cloud() -> dict[str, bytes]:
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, name = store.types, "sensor_msgs/msg/PointCloud2"
    fields = [
        types["sensor_msgs/msg/PointField"](name=field, offset=4 * k, datatype=datatype, count=1)
        for k, (field, datatype) in enumerate([("x", 7), ("y", 7), ("z", 7), ("t", 6)])
    ]
    rows = np.zeros(20, dtype=[("xyz", "<f4", 3), ("t", "<u4")])
    rows["xyz"], rows["t"] = np.arange(60).reshape(20, 3), np.arange(20) * 1_000_000
    header = types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](1, 2), frame_id="lidar")
    made = types[name](
        header=header,
        height=1,
        width=20,
        fields=fields,
        is_bigendian=False,
        point_step=16,
        row_step=320,
        data=np.frombuffer(rows.tobytes(), dtype=np.uint8),
        is_dense=True,
    )
    return {"cloud": bytes(store.serialize_cdr(made, name))}


def _frames() -> dict[str, bytes]:
    names = ("tf2_msgs/msg/TFMessage", "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu")
    return {
        "frames": _ros2(StoragePlugin.MCAP, ".mcap", dict(zip(("/tf_static", "/joints", "/imu"), names, strict=True)))
    }


def _covariances() -> dict[str, bytes]:
    def write(place: Path) -> bytes:
        with CovarianceWriter(place / "one.csv") as writer:
            writer.extend(Covariances.of_triangles(np.array([ARRIVAL_NS]), np.eye(9)[np.triu_indices(9)][None]))
        return (place / "one.csv").read_bytes()

    return {"covariances": _written(write)}


def _results() -> dict[str, bytes]:
    summary = {key: {} for key in ("recording", "counts", "timing", "held_out", "versions", "config")}
    event = {"stamp_ns": ARRIVAL_NS, "kind": "health", "sensor": "", "reason": "nominal"}
    row = f"{ARRIVAL_NS},gnss,used,1.5,3,64,1,2,3"
    return {
        "summary": b"\0" + json.dumps(summary).encode(),
        "events": b"\1" + (json.dumps(event) + "\n").encode() * 2,
        "measurements": b"\2" + "\n".join([",".join(COLUMNS), row, row.replace("used", "held_out"), ""]).encode(),
    }


def _scenario() -> dict[str, bytes]:
    folder = ROOT / "src" / "holdfast" / "sim" / "scenarios"
    return {name: (folder / f"{name}.yaml").read_bytes() for name in ("quick", "clocks", "wrong-mount")}


def _csv() -> dict[str, bytes]:
    found = {}
    for kind in KINDS.values():
        if kind.columns is not None:
            names = ("stamp_ns", "arrival_ns", *kind.columns.names)
            rows = [
                [str(ARRIVAL_NS + k), str(ARRIVAL_NS + k + 5), *["0.5"] * len(kind.columns.names)] for k in range(2)
            ]
            text = "\n".join([",".join(names), *map(",".join, rows), ""])
            found[kind.name] = text.encode()
    return found


def _written(write) -> bytes:
    with tempfile.TemporaryDirectory(prefix="holdfast-fuzz-") as place:
        return write(Path(place))


def _ros2(storage: StoragePlugin, suffix: str, topics: Mapping[str, str] = CONTAINED_TOPICS) -> bytes:
    def write(place: Path) -> bytes:
        with Writer2(place / "bag", version=9, storage_plugin=storage) as writer:
            for k, (topic, name) in enumerate(topics.items()):
                connection = writer.add_connection(topic, name, typestore=get_typestore(Stores.ROS2_HUMBLE))
                writer.write(connection, ARRIVAL_NS + k, example(name))
        return next((place / "bag").glob(f"*{suffix}")).read_bytes()

    return _written(write)


def _mcap() -> dict[str, bytes]:
    whole = _ros2(StoragePlugin.MCAP, ".mcap")
    return {"whole": whole, "cut": whole[: len(whole) // 2]}


def _db3() -> dict[str, bytes]:
    return {"whole": _ros2(StoragePlugin.SQLITE3, ".db3")}


def _bag() -> dict[str, bytes]:
    def write(place: Path, packing: Writer1.CompressionFormat | None) -> bytes:
        writer = Writer1(place / "drive.bag")
        if packing is not None:
            writer.set_compression(packing)
        with writer:
            for k, name in enumerate(CONTAINED):
                connection = writer.add_connection(f"/t{k}", name, typestore=get_typestore(Stores.ROS1_NOETIC))
                writer.write(connection, ARRIVAL_NS + k, example(name, Stores.ROS1_NOETIC))
        return (place / "drive.bag").read_bytes()

    packings = {"plain": None, "lz4": Writer1.CompressionFormat.LZ4, "bz2": Writer1.CompressionFormat.BZ2}
    return {name: _written(lambda place, one=packing: write(place, one)) for name, packing in packings.items()}


def _config() -> dict[str, bytes]:
    files = [*(ROOT / "examples").glob("*.yaml"), *(ROOT / "benchmarks" / "configs").glob("*.yaml")]
    return {file.stem: file.read_bytes() for file in files}


if __name__ == "__main__":  # so that libFuzzer finds them: python seeds.py TARGET FOLDER
    folder = Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in seeds(sys.argv[1]).items():
        (folder / f"seed-{name}").write_bytes(data)
