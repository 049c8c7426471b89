"""Coordinate reference systems by pyproj: which operation is used, and what it does to the heights.

PROJ falls back to coarser operations without a word where a grid is not installed. Here that is told, and heights are
above sea level only where a geoid says so.

Importing it needs pyproj: the extra `export`.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import TransformerGroup

from holdfast.errors import ConfigError
from holdfast.export.target import Heights
from holdfast.geometry.earth import Geodetic
from holdfast.messages import Array

WGS84 = "EPSG:4979"  # latitude, longitude, ellipsoidal height
ELLIPSOIDAL = "ellipsoidal_height_m"
SHIFT = (
    "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +inv +proj=vgridshift +grids={file} "
    "+multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
)


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceSystem:
    """A coordinate reference system as a target; `reference_system` makes one."""

    name: str
    columns: tuple[str, str]
    heights: Heights
    crs: Any
    notes: Sequence[str]
    _horizontal: Any
    _vertical: Any

    def transform(self, points: Array) -> Array:
        """Return (N, 3) east, north, height of points (N, 3): latitude, longitude [deg], ellipsoidal height [m].

        Raises:
            ConfigError: a point lies where an operation is not defined.
        """
        latitude, longitude, height = points.T
        east, north = self._horizontal.transform(longitude, latitude, height)[:2]
        if self._vertical is not None:
            height = self._vertical.transform(longitude, latitude, height)[2]
        found = np.column_stack([east, north, height])
        if not np.isfinite(found).all():
            first = points[np.flatnonzero(~np.isfinite(found).all(axis=1))[0]]
            where = f"{first[0]:.6f} deg N, {first[1]:.6f} deg E"
            raise ConfigError(f"{self.name}: is not defined at {where}, or its geoid ends before it")
        return found


def reference_system(text: str, datum: Geodetic, geoid: Path | None = None) -> ReferenceSystem:
    """Return a coordinate reference system to export to.

    Args:
        text: EPSG code, compound ones joined by a plus (`EPSG:2056+5728`), WKT or a PROJ string.
        datum: of the track, which must be within the system's area of use.
        geoid: a grid of geoid heights for the heights (GTX, GeoTIFF).

    Raises:
        ConfigError: PROJ does not know it, it lies elsewhere, or the geoid cannot be read.
    """
    crs = _parse(text)
    horizontal_crs, vertical_crs = (crs.sub_crs_list[0], crs.sub_crs_list[1]) if crs.is_compound else (crs, None)
    _check_area(text, horizontal_crs, datum)
    if not (horizontal_crs.is_projected or horizontal_crs.is_geographic):
        raise ConfigError(f"--crs {text}: is neither projected nor geographic (allowed: such as EPSG:2056)")
    horizontal, notes = _horizontal(text, horizontal_crs)
    if geoid is not None:
        heights, vertical = Heights("height_m", is_above_sea=True), _geoid(geoid)
    elif vertical_crs is not None:
        heights, vertical = _vertical(text, crs, vertical_crs)
    else:
        has_heights = len(crs.axis_info) == 3
        which = "heights" if has_heights else f"{text} has no heights: those"
        note = f"{which} above the WGS84 ellipsoid are written (a compound system such as EPSG:2056+5728, or --geoid,"
        heights, vertical = Heights(ELLIPSOIDAL, f"{note} gives heights above sea)"), None
    columns = _columns(horizontal_crs)
    known = crs if heights.is_above_sea or not crs.is_compound else horizontal_crs
    return ReferenceSystem(text, columns, heights, known, notes, horizontal, vertical)


def _parse(text: str) -> CRS:
    try:
        return CRS.from_user_input(text)
    except CRSError:
        allowed = "an EPSG code such as EPSG:2056 or EPSG:25832+7837, WKT, or a PROJ string"
        raise ConfigError(f"--crs {text}: PROJ knows no such system (allowed: {allowed})") from None


def _check_area(text: str, crs: CRS, datum: Geodetic) -> None:
    area = crs.area_of_use
    if area is None:
        return
    inside_longitude = (datum.longitude_deg - area.west) % 360.0 <= (area.east - area.west) % 360.0 or (
        area.east - area.west >= 360.0
    )
    if not (inside_longitude and area.south <= datum.latitude_deg <= area.north):
        where = f"{datum.latitude_deg:.4f} deg N, {datum.longitude_deg:.4f} deg E"
        raise ConfigError(f"--crs {text}: is for {area.name.rstrip('.')}, the track is at {where}")


def _group(to: CRS) -> TransformerGroup:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the best is not available is told in our own words
        return TransformerGroup(WGS84, to, always_xy=True)


def _missing(group: TransformerGroup) -> str:
    grids = {grid.short_name for operation in group.unavailable_operations[:1] for grid in operation.grids}
    return ", ".join(sorted(grids)) or "a grid"


def _horizontal(text: str, crs: CRS) -> tuple[Any, list[str]]:
    group = _group(crs)
    sound = [one for one in group.transformers if "ballpark" not in one.description.lower()]
    if not sound:
        raise ConfigError(f"--crs {text}: PROJ has no operation from WGS84 to it without {_missing(group)}")
    best = sound[0]
    if group.best_available:
        return best, []
    return best, [f"{text}: the grid {_missing(group)} is not installed; without it PROJ claims {best.accuracy:g} m"]


def _vertical(text: str, crs: CRS, vertical: CRS) -> tuple[Heights, Any]:
    group = _group(crs)
    sound = [one for one in group.transformers if "ballpark" not in one.description.lower()]
    if sound:
        return Heights("height_m", is_above_sea=True), sound[0]
    note = f"{text}: the grid {_missing(group)} is not installed, so there is no {vertical.name}: heights above the"
    return Heights(ELLIPSOIDAL, f"{note} WGS84 ellipsoid are written"), None


def _geoid(file: Path) -> Any:
    if not file.is_file():
        raise ConfigError(f"--geoid {file}: no such file")
    try:
        return Transformer.from_pipeline(SHIFT.format(file=file.absolute()))
    except ProjError:
        raise ConfigError(f"--geoid {file}: is no grid that PROJ can read (allowed: GTX, GeoTIFF)") from None


def _columns(crs: CRS) -> tuple[str, str]:
    unit = crs.axis_info[0].unit_name
    if crs.is_geographic:
        return "longitude_deg", "latitude_deg"
    suffix = {"metre": "m", "US survey foot": "us_ft", "foot": "ft"}.get(unit, unit.replace(" ", "_"))
    return f"east_{suffix}", f"north_{suffix}"
