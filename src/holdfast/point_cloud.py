"""A scan of a lidar as its driver published it: bytes with a description, undecoded.

It crosses the border to another process by its bytes, not by a row of numbers like the measurements in
`holdfast.messages`; the odometry that is made of it does the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import MessageError

Bytes = NDArray[np.uint8]


class PointField(NamedTuple):
    """One field of a point as in sensor_msgs/PointField: `datatype` 7 is float32, 6 uint32; `values` is its count."""

    name: str
    offset: int
    datatype: int
    values: int


class Layout(NamedTuple):
    """How the points of a cloud lie in its bytes, as sensor_msgs/PointCloud2 claims; steps in bytes."""

    fields: tuple[PointField, ...]
    height: int
    width: int
    point_step: int
    row_step: int
    is_bigendian: bool


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """One sensor_msgs/PointCloud2.

    Attributes:
        stamp_ns: of the message; the times of its points may count from it.
        frame_id: of the lidar's frame L.
        layout: as claimed; nothing of it has been checked against `data`.
        data: the bytes of the points, a view of the message.
    """

    stamp_ns: int
    arrival_ns: int
    sensor: str
    frame_id: str
    layout: Layout
    data: Bytes
    WIDTH: ClassVar[int] = 0

    def values(self) -> tuple[float, ...]:
        """Return an empty row: a cloud has no row of numbers."""
        return ()

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:  # noqa: ARG003
        """Refuse: a cloud cannot be made of a row of numbers.

        Raises:
            MessageError: always.
        """
        raise MessageError("PointCloud: cannot be made of a row of numbers")
