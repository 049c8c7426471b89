"""The standard messages as types of DDS, made of rosbags' definitions: what is recorded and what is on the wire agree.

ROS 2 calls `sensor_msgs/msg/Imu` on the wire `sensor_msgs::msg::dds_::Imu_`. Samples stay the bytes that they are, CDR
that rosbags reads and writes; DDS needs the structure only to announce it to others.
"""

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as dds
from cyclonedds.idl.annotations import final
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
BASE_TYPES: dict[str, Any] = {
    "bool": bool,
    "byte": dds.byte,
    "char": dds.uint8,
    "int8": dds.int8,
    "uint8": dds.uint8,
    "int16": dds.int16,
    "uint16": dds.uint16,
    "int32": dds.int32,
    "uint32": dds.uint32,
    "int64": dds.int64,
    "uint64": dds.uint64,
    "float32": dds.float32,
    "float64": dds.float64,
    "string": str,
}
ARRAY: Any = dds.array
SEQUENCE: Any = dds.sequence


def dds_name(type_name: str) -> str:
    """Return what a type such as `sensor_msgs/msg/Imu` is called on the wire."""
    package, _, name = type_name.split("/")
    return f"{package}::msg::dds_::{name}_"


def ros_name(name: str) -> str:
    """Return what ROS calls a type on the wire; a name that is none of ROS is returned as it is."""
    package, infix, bare = name.partition("::msg::dds_::")
    return f"{package}/msg/{bare.removesuffix('_')}" if infix else name


@cache
def dds_type(type_name: str) -> type[IdlStruct]:
    """Return the type of DDS for a standard message such as `sensor_msgs/msg/Imu`.

    Raises:
        KeyError: it is no standard message.
    """
    _, fields = STORE.fielddefs[type_name]
    structure: type[IdlStruct] = make_idl_struct(
        type_name.replace("/", "_"),
        dds_name(type_name),
        {name: _field(description) for name, description in fields},
    )
    final(structure)
    return structure


def _field(description: Any) -> Any:
    kind, content = description
    if kind == Nodetype.BASE:
        return BASE_TYPES[content[0]]
    if kind == Nodetype.NAME:
        return dds_type(content)
    entry, length = _field(content[0]), content[1]
    if kind == Nodetype.ARRAY:
        return ARRAY[entry, length]
    return SEQUENCE[entry, length] if length else SEQUENCE[entry]
