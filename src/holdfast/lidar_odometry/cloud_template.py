"""How the points of one layout of sensor_msgs/PointCloud2 are read: worked out once, used for every cloud like it.

What a cloud claims of itself is checked against its bytes before anything is read or allocated; points are views of
the message's bytes, in whatever number format, byte order and spacing a driver has chosen.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.point_cloud import Bytes, Layout, PointField
from holdfast.printable import listed, quoted
from holdfast.recording.decode import UndecodableError

TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp", "t_offset")
INTENSITY_FIELDS = ("intensity", "reflectivity", "signal")
FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
MAX_POINTS = 1 << 22  # 256 rings of 16384 columns
MAX_FIELDS = 64
KEPT_LAYOUTS = 64
MAX_SINCE_STAMP_S = 1e6  # larger times count from the epoch, not from the stamp
MAX_SWEEP_S = 1e4  # larger floats are nanoseconds
MAX_OFFSET_S = 2.0


@dataclass(frozen=True, slots=True)
class _Column:
    """One field: its format with the byte order, and where in a point it lies."""

    format: np.dtype[Any]
    offset: int


@dataclass(frozen=True, slots=True)
class _Columns:
    """The fields that are used; `time` and `intensity` with their names, None where there are none."""

    axes: tuple[_Column, _Column, _Column]
    time: tuple[str, _Column] | None
    intensity: tuple[str, _Column] | None


class CloudTemplate:
    """Reads a cloud that is laid out as it claims.

    Args:
        layout: as the message claims.
        size: of its bytes.

    Raises:
        UndecodableError: it claims more than there is, or has no usable fields x, y, z.
    """

    def __init__(self, layout: Layout, size: int) -> None:
        height, width, step, row = layout[1:5]
        if min(height, width, step, row) < 0 or height * width > MAX_POINTS:
            raise UndecodableError(f"the cloud claims {height} x {width} points (allowed: {MAX_POINTS} in all)")
        if height * width and (step < 1 or row < width * step or (height - 1) * row + width * step > size):
            claim = f"{height} rows of {row} bytes with {width} points of {step}"
            raise UndecodableError(f"the cloud's fields do not fit its data ({claim}, but there are {size} bytes)")
        self._layout = layout
        self._columns = _columns(layout.fields, step, layout.is_bigendian)

    @property
    def time_name(self) -> str | None:
        """Name of the field that tells when each point was measured, or None."""
        return None if self._columns.time is None else self._columns.time[0]

    def points(self, data: Bytes) -> NDArray[Any]:
        """Return the coordinates (N, 3) in the cloud's own number format [m]: a view of the bytes where it can be."""
        x, y, z = self._columns.axes
        step = y.offset - x.offset
        if x.format == y.format == z.format and z.offset - y.offset == step > 0:
            return self._view(data, x, (3,), (step,)).reshape(-1, 3)
        return np.column_stack([self._view(data, axis).ravel() for axis in self._columns.axes])

    def times(self, data: Bytes) -> NDArray[Any] | None:
        """Return the field of times (N,) as it is, or None."""
        return None if self._columns.time is None else self._view(data, self._columns.time[1]).reshape(-1)

    def intensities(self, data: Bytes) -> NDArray[Any] | None:
        """Return the brightness (N,) of the returns in the unit of the driver, or None."""
        return None if self._columns.intensity is None else self._view(data, self._columns.intensity[1]).reshape(-1)

    def _view(
        self, data: Bytes, column: _Column, shape: tuple[int, ...] = (), strides: tuple[int, ...] = ()
    ) -> NDArray[Any]:
        layout, size = self._layout, (self._layout.height, self._layout.width, *shape)
        if not layout.height * layout.width:
            return np.empty(size, column.format)
        steps = (layout.row_step, layout.point_step, *strides)
        return np.ndarray(size, column.format, data.data, column.offset, steps)


@lru_cache(KEPT_LAYOUTS)
def _columns(fields: tuple[PointField, ...], point_step: int, is_bigendian: bool) -> _Columns:
    if len(fields) > MAX_FIELDS:
        raise UndecodableError(f"the cloud has {len(fields)} fields (allowed: {MAX_FIELDS})")
    order, columns = ">" if is_bigendian else "<", dict[str, _Column]()
    for field in fields:
        if field.values > 1 or field.datatype not in FORMATS or field.name in columns:
            continue
        column = _Column(np.dtype(order + FORMATS[field.datatype]), field.offset)
        if field.offset < 0 or field.offset + column.format.itemsize > point_step:
            claim = f"{quoted(field.name)} at byte {field.offset} of {point_step}"
            raise UndecodableError(f"the cloud's fields do not fit its data ({claim})")
        columns[field.name] = column
    if not {"x", "y", "z"} <= columns.keys():
        raise UndecodableError(f"the cloud has no fields x, y, z (it has {listed(list(columns)) or 'none'})")
    axes = columns["x"], columns["y"], columns["z"]
    return _Columns(axes, _first(columns, TIME_FIELDS), _first(columns, INTENSITY_FIELDS))


def _first(columns: dict[str, _Column], names: tuple[str, ...]) -> tuple[str, _Column] | None:
    return next(((name, columns[name]) for name in names if name in columns), None)


def offsets_s(times: NDArray[Any], name: str, at_ns: int) -> Array | None:
    """Return the times (N,) after the stamp [s], negative before it; None where all are equal, which tells nothing.

    Integers are nanoseconds after the stamp (Ouster `t`, Livox `offset_time`). Floats are seconds, or nanoseconds where
    no sweep could last so many seconds, after the stamp (Velodyne `time`) or since the epoch (Hesai and Livox
    `timestamp`).

    Args:
        times: (N,) the field of the points, in its own format.
        name: of the field.
        at_ns: stamp of the message.

    Raises:
        UndecodableError: they are no times of a sweep.
    """
    if not len(times):
        return np.zeros(0)
    if times.dtype.kind in "iu":
        found = times.astype(np.float64) * 1e-9
    else:
        seconds = times.astype(np.float64)
        if not np.isfinite(seconds).all():
            raise UndecodableError(f"field {name} is not finite")
        scale = 1e-9 if np.ptp(seconds) > MAX_SWEEP_S or abs(seconds[0]) > 1e12 else 1.0
        since_epoch = abs(seconds[0] * scale) > MAX_SINCE_STAMP_S
        # float64 since the epoch resolves 0.24 us, in seconds as in nanoseconds
        found = (seconds - (at_ns * 1e-9 / scale if since_epoch else 0.0)) * scale
    largest_s = float(np.abs(found).max())
    if largest_s > MAX_OFFSET_S:
        raise UndecodableError(
            f"field {name} is {largest_s:.3g} s from the stamp (allowed: {MAX_OFFSET_S:g}); is it in other units?"
        )
    return None if np.ptp(found) == 0.0 else found
