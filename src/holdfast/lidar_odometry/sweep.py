"""Point clouds as sensor_msgs/PointCloud2 of any layout, decoded to arrays: one sweep of the lidar."""

from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.lidar_odometry.cloud_template import CloudTemplate, offsets_s
from holdfast.lidar_odometry.deskew import SHORTEST_S, Rates
from holdfast.messages import Array
from holdfast.point_cloud import PointCloud
from holdfast.recording.decode import stamp_ns
from holdfast.recording.kinds.scans import point_cloud


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
        own: (M, 3) points in L on the machine itself [m], which have been taken out.
    """

    stamp_ns: int
    frame_id: str
    points: Array
    offsets_s: Array | None
    rates: Rates | None = None
    intensities: Array | None = None
    own: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def middle_s(self) -> float:
        """Return the instant, after the stamp [s], from which no point is farther than half a sweep."""
        if self.offsets_s is None or not len(self.offsets_s):
            return 0.0
        return float(self.offsets_s.min() + self.offsets_s.max()) / 2.0

    @property
    def half_s(self) -> float:
        """Return half the time from its first to its last point [s]."""
        return 0.0 if self.offsets_s is None or not len(self.offsets_s) else float(np.ptp(self.offsets_s)) / 2.0

    def phases(self) -> Array | None:
        """Return the times (N,) from 0 at the first to 1 at the last point, or None."""
        if self.offsets_s is None or not len(self.offsets_s):
            return None
        phases: Array = (self.offsets_s - self.offsets_s.min()) / max(np.ptp(self.offsets_s), SHORTEST_S)
        return phases

    def beyond(self, range_m: float, limit_m: float = inf) -> "Sweep":
        """Return the sweep without points nearer than a range or farther than a limit [m]."""
        squared = np.einsum("ni,ni->n", self.points, self.points)
        return self.taken((squared >= range_m * range_m) & (squared <= limit_m * limit_m))

    def taken(self, chosen: NDArray[np.bool_]) -> "Sweep":
        """Return the sweep with the points that a mask (N,) chooses."""
        if chosen.all():
            return self
        offsets_s = None if self.offsets_s is None else self.offsets_s[chosen]
        intensities = None if self.intensities is None else self.intensities[chosen]
        return replace(self, points=self.points[chosen], offsets_s=offsets_s, intensities=intensities)


def decode_sweep(message: Any) -> Sweep:
    """Decode a sensor_msgs/PointCloud2 as `sweep_of` does."""
    return sweep_of(point_cloud(stamp_ns(message), 0, "", message))


def sweep_of(cloud: PointCloud, keep_intensities: bool = True) -> Sweep:
    """Decode a cloud with fields x, y, z of any number format, in either byte order, organised or not.

    Times of its points are read as `cloud_template.offsets_s` says; times that are all equal are ignored. A field named
    intensity, reflectivity or signal is how bright a return is.

    Raises:
        UndecodableError: fields are missing, do not fit the data or are no times of a sweep.
    """
    template = CloudTemplate(cloud.layout, cloud.data.size)
    points = template.points(cloud.data)
    x, y, z = np.isfinite(points).T
    finite = x & y & z
    is_all = bool(finite.all())

    def kept(column: NDArray[Any]) -> NDArray[Any]:
        return column if is_all else column[finite]

    times, name = template.times(cloud.data), template.time_name
    after_s = None if times is None or name is None else offsets_s(kept(times), name, cloud.stamp_ns)
    bright = template.intensities(cloud.data) if keep_intensities else None
    intensities = None if bright is None else np.nan_to_num(kept(bright).astype(np.float64))
    return Sweep(cloud.stamp_ns, cloud.frame_id, kept(points).astype(np.float64), after_s, intensities=intensities)
