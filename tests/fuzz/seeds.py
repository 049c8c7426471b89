"""Valid inputs of every target, from which fuzzing begins: small, and made anew when they are needed."""

import sys
import tempfile
from pathlib import Path

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from targets import ARRIVAL_NS, PAIRS, example

from holdfast.recording.kinds import KINDS

ROOT = Path(__file__).parents[2]
TYPES = sorted({type_name for _, type_name in PAIRS} & get_typestore(Stores.ROS2_HUMBLE).fielddefs.keys())
CONTAINED = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState")
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


def seeds(target: str) -> dict[str, bytes]:
    """Return valid inputs by name."""
    makers = {
        "cdr": _cdr, "csv": _csv, "mcap": _mcap, "db3": _db3, "bag": _bag, "config": _config,
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


def _ros2(storage: StoragePlugin, suffix: str) -> bytes:
    def write(place: Path) -> bytes:
        with Writer2(place / "bag", version=9, storage_plugin=storage) as writer:
            for k, name in enumerate(CONTAINED):
                connection = writer.add_connection(f"/t{k}", name, typestore=get_typestore(Stores.ROS2_HUMBLE))
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
