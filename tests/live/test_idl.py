"""The types that are announced on the network describe the bytes that are sent."""

from itertools import count

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from holdfast.live.idl import STORE, dds_name, dds_type, ros_name
from holdfast.recording.kinds import KINDS

ACCEPTED = {name for kind in KINDS.values() for name in kind.types}
PUBLISHED = {
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/NavSatFix",
    "rcl_interfaces/msg/Log",
    "std_msgs/msg/Empty",
}
WHOLE = {"byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"}


def filled(name, numbers):
    """A message in which every field has another value."""
    values = {field: value(description, numbers) for field, description in STORE.fielddefs[name][1]}
    return STORE.types[name](**values)


def value(description, numbers):
    kind, content = description
    if kind == Nodetype.NAME:
        return filled(content, numbers)
    if kind == Nodetype.BASE:
        number = next(numbers)
        if content[0] == "bool":
            return number % 2 == 0
        return f"text {number}" if content[0] == "string" else number % 100 if content[0] in WHOLE else number + 0.5
    entries = [value(content[0], numbers) for _ in range(content[1] or 3)]
    is_number = content[0][0] == Nodetype.BASE and content[0][1][0] != "string"
    return np.array(entries, dtype=np.dtype(content[0][1][0])) if is_number else entries


def plain(message):
    if hasattr(message, "__dataclass_fields__"):
        names = [name for name in message.__dataclass_fields__ if not name.isupper() and name != "__msgtype__"]
        return {name: plain(getattr(message, name)) for name in names}
    return [plain(entry) for entry in message] if isinstance(message, list | np.ndarray) else message


@pytest.mark.parametrize("name", sorted(ACCEPTED | PUBLISHED))
def test_dds_reads_every_field_of_what_rosbags_writes(name):
    message = filled(name, count(1))
    data = bytes(STORE.serialize_cdr(message, name))
    assert plain(dds_type(name).deserialize(data)) == plain(message)


@pytest.mark.parametrize("name", sorted(ACCEPTED | PUBLISHED))
def test_dds_writes_the_same_bytes_as_rosbags(name):
    data = bytes(STORE.serialize_cdr(filled(name, count(1)), name))
    again = dds_type(name).deserialize(data).serialize(use_version_2=False)
    assert again[:2] == data[:2]  # the encoding; behind it stands the padding at the end, which may be left zero
    assert again[4:] == data[4:]


def test_types_have_the_names_that_ros_gives_them_on_the_wire():
    assert dds_name("sensor_msgs/msg/Imu") == "sensor_msgs::msg::dds_::Imu_"
    assert ros_name("sensor_msgs::msg::dds_::Imu_") == "sensor_msgs/msg/Imu"
    assert ros_name("Square") == "Square"
