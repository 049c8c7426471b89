"""The map as LAS 1.4 or LAZ in a coordinate reference system (ASPRS LAS 1.4 R15, points of format 7: time and RGB)."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.errors import ConfigError
from holdfast.export.formats import ADJUSTED_S, FIRST_UTC_NS, LAS_SCALE_M, gps_seconds
from holdfast.geometry.earth import Geodetic
from holdfast.mapping.colours import Colouring
from holdfast.mapping.site_map import SiteMap
from holdfast.mapping.sorted_runs import Records
from holdfast.messages import Array

if TYPE_CHECKING:
    from holdfast.export.crs import ReferenceSystem

FULL = 65535
TO_GEODETIC = (
    "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lon_0={1:.12f} +lat_0={0:.12f} +h_0={2:.6f} "
    "+step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
)


class Grid:
    """Where the coordinates of a file come from: W as it is, or a projected reference system.

    Args:
        datum: of W; None where W is nowhere on the earth.
        crs: such as EPSG:2056; None takes the zone of UTM in which the datum lies.
        geoid: a grid of geoid heights for heights above the sea.

    Raises:
        ConfigError: there is no datum for a reference system, or it cannot be used there.
    """

    def __init__(self, datum: Geodetic | None, crs: str | None, geoid: Path | None = None) -> None:
        self.system: ReferenceSystem | None = None
        if datum is None:
            if crs is not None:
                raise ConfigError(f"--crs {crs}: W is nowhere on the earth (needed: GNSS, or frames.datum)")
            return
        from pyproj import Transformer

        from holdfast.export.crs import reference_system

        self.system = reference_system(crs or utm(datum), datum, geoid)
        if self.system.columns[0].endswith("_deg"):
            raise ConfigError(f"--crs {crs}: a map takes metres (allowed: a projected system such as {utm(datum)})")
        self._to_geodetic = Transformer.from_pipeline(TO_GEODETIC.format(*datum))

    @property
    def name(self) -> str:
        """Return what the coordinates are."""
        return "W, without a reference system" if self.system is None else self.system.name

    def coordinates(self, points: Array) -> Array:
        """Return east, north, height (N, 3) of points (N, 3) in W [m]."""
        if self.system is None:
            return points
        east, north, up = points.T
        longitude, latitude, height = self._to_geodetic.transform(east, north, up)
        return self.system.transform(np.column_stack([latitude, longitude, height]))


def utm(datum: Geodetic) -> str:
    """Return the zone of UTM on WGS84 in which a datum lies."""
    zone = min(int((datum.longitude_deg + 180.0) // 6.0) % 60 + 1, 60)
    return f"EPSG:{326 if datum.latitude_deg >= 0.0 else 327}{zone:02d}"


def write_las(site_map: SiteMap, colouring: Colouring, grid: Grid, file: Path) -> None:
    """Write a point per voxel, block by block; the suffix says whether it is compressed.

    `sigma_m` and `scans` are extra bytes; an intensity up to 1 is spread over the 16 bits of LAS, another one rounded.

    Raises:
        OSError: the file cannot be written.
    """
    import laspy

    header = laspy.LasHeader(point_format=7, version="1.4")
    middle = (site_map.low + site_map.high) / 2.0
    header.offsets = np.floor(grid.coordinates(middle[None])[0])
    header.scales = np.full(3, LAS_SCALE_M)
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.generating_software = "Holdfast"
    header.add_extra_dims([laspy.ExtraBytesParams("sigma_m", "f4"), laspy.ExtraBytesParams("scans", "u4")])
    if grid.system is not None:
        header.add_crs(grid.system.crs)
    largest = max(float(block["intensity"].max()) for block in site_map.blocks()) if site_map.has_intensity else 0.0
    gain = FULL if largest <= 1.0 else 1.0
    with laspy.open(str(file), mode="w", header=header) as writer:
        for block in site_map.blocks():
            writer.write_points(_points(laspy, header, block, grid.coordinates(block["point"]), colouring, gain))


def _points(  # noqa: PLR0917
    laspy: Any, header: Any, block: Records, coordinates: Array, colouring: Colouring, gain: float
) -> Any:
    points = laspy.ScaleAwarePointRecord.zeros(len(block), header=header)
    points.x, points.y, points.z = coordinates.T
    points.intensity = np.clip(np.rint(block["intensity"] * gain), 0, FULL).astype(np.uint16)
    points.return_number[:] = points.number_of_returns[:] = 1
    points.red, points.green, points.blue = colouring.colours(block).astype(np.uint16).T * 257
    if int(block["stamp_ns"].min()) >= FIRST_UTC_NS:
        points.gps_time = gps_seconds(block["stamp_ns"]) - ADJUSTED_S
    points["sigma_m"], points["scans"] = block["sigma_m"], block["scans"]
    return points
