"""Point clouds as sensor_msgs/PointCloud2 of any layout, decoded to arrays: one sweep of the lidar."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.lidar_odometry.deskew import SHORTEST_S, Rates
from holdfast.messages import Array
from holdfast.recording.decode import UndecodableError, stamp_ns

TIME_FIELDS = ("t", "time", "timestamp", "offset_time")
INTENSITY_FIELDS = ("intensity", "reflectivity", "signal")
DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
MAX_SINCE_STAMP_S = 1e6  # larger times count from the epoch, not from the stamp
MAX_SWEEP_S = 1e4  # larger floats are nanoseconds
MAX_OFFSET_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """The returns of one revolution of the lidar, without those that are not finite.

    Attributes:
        stamp_ns: of the message.
        frame_id: of the lidar's frame L.
        points: (N, 3) each in L at its own time [m].
        offsets_s: (N,) time of each point after the stamp [s], negative before it; or None where it is unknown.
        rates: what a gyroscope measured around the sweep, or None.
        intensities: (N,) of the returns, in the unit of the driver; or None where the cloud has none.
    """

    stamp_ns: int
    frame_id: str
    points: Array
    offsets_s: Array | None
    rates: Rates | None = None
    intensities: Array | None = None

    @property
    def middle_s(self) -> float:
        """Return the instant, after the stamp [s], from which no point is farther than half a sweep."""
        if self.offsets_s is None or not len(self.offsets_s):
            return 0.0
        return float(self.offsets_s.min() + self.offsets_s.max()) / 2.0

    def phases(self) -> Array | None:
        """Return the times (N,) from 0 at the first to 1 at the last point, or None."""
        if self.offsets_s is None or not len(self.offsets_s):
            return None
        phases: Array = (self.offsets_s - self.offsets_s.min()) / max(np.ptp(self.offsets_s), SHORTEST_S)
        return phases

    def beyond(self, range_m: float) -> "Sweep":
        """Return the sweep without points nearer than a range."""
        return self.taken(np.einsum("ni,ni->n", self.points, self.points) >= range_m * range_m)

    def taken(self, chosen: NDArray[np.bool_]) -> "Sweep":
        """Return the sweep with the points that a mask (N,) chooses."""
        offsets_s = None if self.offsets_s is None else self.offsets_s[chosen]
        intensities = None if self.intensities is None else self.intensities[chosen]
        return replace(self, points=self.points[chosen], offsets_s=offsets_s, intensities=intensities)


def decode_sweep(message: Any) -> Sweep:
    """Decode a sensor_msgs/PointCloud2 with fields x, y, z of any number format, in either byte order.

    A field named t, time, timestamp or offset_time is the time of each point: integers are nanoseconds after the stamp;
    floats are seconds, or nanoseconds where no sweep could last so many seconds, after the stamp or since the epoch.
    Times that are all equal are ignored. A field named intensity, reflectivity or signal is how bright a return is.

    Raises:
        UndecodableError: fields are missing, do not fit the data or are no times of a sweep.
    """
    at_ns = stamp_ns(message)
    cloud = _structured(message)
    names = cloud.dtype.names or ()
    if not {"x", "y", "z"} <= set(names):
        raise UndecodableError(f"the cloud has no fields x, y, z (it has {', '.join(names) or 'none'})")
    points = np.column_stack([cloud[axis].astype(np.float64) for axis in "xyz"])
    finite = np.isfinite(points).all(axis=1)
    name = next((name for name in TIME_FIELDS if name in names), None)
    offsets_s = None if name is None else _offsets_s(cloud[name][finite], name, at_ns)
    bright = next((name for name in INTENSITY_FIELDS if name in names), None)
    intensities = None if bright is None else np.nan_to_num(cloud[bright][finite].astype(np.float64))
    return Sweep(at_ns, str(message.header.frame_id), points[finite], offsets_s, intensities=intensities)


def _structured(message: Any) -> NDArray[np.void]:
    """Return the points (N,) as records of the message's fields; fields of several values are left out."""
    step, width, height = int(message.point_step), int(message.width), int(message.height)
    fields = [field for field in message.fields if field.count <= 1 and field.datatype in DATATYPES]
    order = ">" if message.is_bigendian else "<"
    try:
        layout = np.dtype(
            {
                "names": [field.name for field in fields],
                "formats": [order + DATATYPES[field.datatype] for field in fields],
                "offsets": [field.offset for field in fields],
                "itemsize": step,
            }
        )
        data = np.asarray(message.data, dtype=np.uint8)
        rows = data[: height * message.row_step].reshape(height, message.row_step)
        return np.ascontiguousarray(rows[:, : width * step]).view(layout).reshape(width * height)
    except ValueError as error:
        raise UndecodableError(f"the cloud's fields do not fit its data ({error})") from None


def _offsets_s(times: NDArray[Any], name: str, at_ns: int) -> Array | None:
    if not len(times):
        return np.zeros(0)
    if times.dtype.kind in "iu":
        offsets_s = times.astype(np.float64) * 1e-9
    else:
        seconds = times.astype(np.float64)
        if not np.isfinite(seconds).all():
            raise UndecodableError(f"field {name} is not finite")
        scale = 1e-9 if np.ptp(seconds) > MAX_SWEEP_S else 1.0
        since_epoch = abs(seconds[0] * scale) > MAX_SINCE_STAMP_S
        # float64 since the epoch resolves 0.24 us, in seconds as in nanoseconds
        offsets_s = (seconds - (at_ns * 1e-9 / scale if since_epoch else 0.0)) * scale
    largest_s = float(np.abs(offsets_s).max())
    if largest_s > MAX_OFFSET_S:
        raise UndecodableError(
            f"field {name} is {largest_s:.3g} s from the stamp (allowed: {MAX_OFFSET_S:g}); is it in other units?"
        )
    return None if np.ptp(offsets_s) == 0.0 else offsets_s
