"""A site grid from control points ("localisation"): what a surveyor's controller does on a site without a system.

Horizontally a similarity of four parameters, E = a x - b y + c, N = b x + a y + d, from a transverse Mercator plane
x, y at the height of the site; vertically a shift, H = h + e, or a plane, H = h + e + f x + g y, where the surveyor
asks for it. Both by least squares, with every residual told.

Importing it needs pyproj: the extra `export`.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import Transformer

from holdfast.config.document import plain
from holdfast.errors import ConfigError
from holdfast.export.crs import ELLIPSOIDAL
from holdfast.export.target import Heights
from holdfast.messages import Array
from holdfast.printable import quoted

SMALLEST_SPREAD_M = 5.0  # between the two points that are furthest apart
LARGEST_SCALE = 0.01  # off one: feet, or other points
MIRRORED = 0.1  # a mirrored grid fits so much better where east and north are swapped
EARTH_RADIUS_M = 6_371_000.0
GEODETIC = ("latitude_deg", "longitude_deg", "altitude_m")
KEYS = ("name", *GEODETIC, "east_m", "north_m", "height_m")


@dataclass(frozen=True, slots=True, eq=False)
class ControlPoints:
    """Points that are known in both systems.

    Attributes:
        names: (N,).
        geodetic: (N, 3) latitude, longitude [deg], height above the WGS84 ellipsoid [m].
        local: (N, 3) east, north, height of the site [m]; the height is NaN where it is not known.
        is_plane: whether the heights are fitted by a plane.
    """

    names: Sequence[str]
    geodetic: Array
    local: Array
    is_plane: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SiteGrid:
    """A site grid as a target; `localise` makes one.

    Attributes:
        scale: of the grid to the plane at the height of the site.
        rotation_deg: of the grid's north against true north, counter-clockwise.
        residuals: (N, 3) given minus transformed, of each control point [m]; NaN where it has no height.
    """

    name: str
    columns: tuple[str, str]
    heights: Heights
    crs: None
    notes: Sequence[str]
    points: ControlPoints
    scale: float
    rotation_deg: float
    residuals: Array
    _plane: Any
    _similarity: Array
    _height: Array

    def transform(self, points: Array) -> Array:
        """Return (N, 3) east, north, height of points (N, 3): latitude, longitude [deg], ellipsoidal height [m]."""
        at = _projected(self._plane, points)
        local = _design(at) @ self._similarity
        up = points[:, 2] + np.column_stack([np.ones(len(at)), at]) @ self._height
        return np.column_stack([local.reshape(-1, 2), up])


def read_control_points(file: Path) -> ControlPoints:
    """Read control points: a CSV file with a header, or YAML (`points:` a list, `height: shift` or `plane`).

    Raises:
        ConfigError: names the file, the point and what is wrong.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: {(getattr(error, 'strerror', '') or 'is no text').lower()}") from None
    height, rows = "shift", list[Mapping[str, Any]]()
    if file.suffix.lower() == ".csv":
        rows = list(csv.DictReader(text.splitlines()))
    else:
        none = "holds no control points (allowed: `points:` a list, or a .csv file)"
        try:
            content = plain(text, str(file))
            height, rows = content.get("height", "shift"), list(content["points"])
        except ConfigError as error:
            raise ConfigError(f"{error}: {none}") from None
        except (KeyError, TypeError):
            raise ConfigError(f"{file}: {none}") from None
    if height not in ("shift", "plane"):
        raise ConfigError(f"{file}: height: {quoted(height)} (allowed: shift, plane)")
    values = [_values(row, f"{file}: point {k}") for k, row in enumerate(rows, start=1)]
    names = [str(row.get("name") or k) for k, row in enumerate(rows, start=1)]
    table = np.array(values).reshape(-1, 6)
    return ControlPoints(names, table[:, :3], table[:, 3:], height == "plane")


def _values(row: Any, where: str) -> list[float]:
    if not isinstance(row, Mapping):
        raise ConfigError(f"{where}: is no point (allowed: {', '.join(KEYS)})")
    values = []
    for key in KEYS[1:]:
        given = row.get(key)
        if given in (None, "") and key == "height_m":
            values.append(np.nan)
            continue
        try:
            value = float(given)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            value = np.nan
        limit = {"latitude_deg": 90.0, "longitude_deg": 360.0, "altitude_m": 1e5}.get(key, 1e8)
        if not abs(value) <= limit:
            raise ConfigError(f"{where}: {key} {quoted(given)}: must be a number within +-{limit:g}")
        values.append(value)
    return values


def localise(points: ControlPoints, name: str) -> SiteGrid:
    """Fit a site grid to control points.

    Raises:
        ConfigError: the points are too few, too close together, mirrored or in other units.
    """
    if len(points.names) < 2:
        raise ConfigError(f"{name}: {len(points.names)} control points (allowed: 2 or more, 3 to find a mistake)")
    plane = _plane_about(points.geodetic)
    at, to = _projected(plane, points.geodetic), points.local[:, :2]
    for of, what in ((at, "WGS84"), (to, "site")):
        spread_m = float(np.linalg.norm(of[:, None] - of[None], axis=2).max())
        if spread_m < SMALLEST_SPREAD_M:
            raise ConfigError(f"{name}: the {what} positions are within {spread_m:.2f} m: no direction can be told")
    similarity = _fit(at, to)
    scale = float(np.hypot(similarity[0], similarity[1]))
    _check_fit(name, at, to, similarity, scale)
    height, has_height = _fit_height(points, at, name)
    fitted = (_design(at) @ similarity).reshape(-1, 2)
    up = points.geodetic[:, 2] + np.column_stack([np.ones(len(at)), at]) @ height
    residuals = points.local - np.column_stack([fitted, up])
    notes = [] if len(at) > 2 else [f"{name}: two points leave no residual: a mistake in one of them cannot be seen"]
    note = "" if has_height else f"{name}: no point has a height: those above the WGS84 ellipsoid are written"
    return SiteGrid(
        name=name,
        columns=("east_m", "north_m"),
        heights=Heights("height_m" if has_height else ELLIPSOIDAL, note),
        crs=None,
        notes=notes,
        points=points,
        scale=scale,
        rotation_deg=float(np.degrees(np.arctan2(similarity[1], similarity[0]))),
        residuals=residuals,
        _plane=plane,
        _similarity=similarity,
        _height=height,
    )


def _plane_about(geodetic: Array) -> Any:
    """Return a transverse Mercator projection about the points, true to scale at their mean height."""
    latitude, longitude, height = geodetic[:, 0].mean(), geodetic[0, 1], geodetic[:, 2].mean()
    return Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=tmerc +lat_0={latitude:.12f} "
        f"+lon_0={longitude:.12f} +k_0={1.0 + height / EARTH_RADIUS_M:.12f} +ellps=WGS84"
    )


def _projected(plane: Any, points: Array) -> Array:
    return np.column_stack(plane.transform(points[:, 1], points[:, 0]))


def _design(at: Array) -> Array:
    """Return the rows (2N, 4) of E = a x - b y + c, N = b x + a y + d."""
    design = np.zeros((2 * len(at), 4))
    design[0::2, 0], design[0::2, 1], design[0::2, 2] = at[:, 0], -at[:, 1], 1.0
    design[1::2, 0], design[1::2, 1], design[1::2, 3] = at[:, 1], at[:, 0], 1.0
    return design


def _fit(at: Array, to: Array) -> Array:
    centre_at, centre_to = at.mean(axis=0), to.mean(axis=0)
    a, b = np.linalg.lstsq(_design(at - centre_at)[:, :2], (to - centre_to).ravel(), rcond=None)[0]
    shift = centre_to - np.array([a * centre_at[0] - b * centre_at[1], b * centre_at[0] + a * centre_at[1]])
    return np.array([a, b, *shift])


def _check_fit(name: str, at: Array, to: Array, similarity: Array, scale: float) -> None:
    def misfit(target: Array, parameters: Array) -> float:
        return float(np.sqrt(np.mean((target.ravel() - _design(at) @ parameters) ** 2)))

    swapped = to[:, ::-1]
    if len(at) > 2 and misfit(swapped, _fit(at, swapped)) < MIRRORED * misfit(to, similarity):
        raise ConfigError(f"{name}: the points fit if east and north of the site are swapped")
    if abs(scale - 1.0) > LARGEST_SCALE:
        raise ConfigError(f"{name}: the scale is {scale:.4f} (allowed: 1 +- {LARGEST_SCALE:g}; is all in metres?)")


def _fit_height(points: ControlPoints, at: Array, name: str) -> tuple[Array, bool]:
    """Return shift and slopes (3,) of the heights, and whether any point has one."""
    known = np.isfinite(points.local[:, 2])
    if not known.any():
        return np.zeros(3), False
    difference = points.local[known, 2] - points.geodetic[known, 2]
    if not points.is_plane:
        return np.array([difference.mean(), 0.0, 0.0]), True
    centred = at[known] - at[known].mean(axis=0)
    narrow_m = float(np.linalg.svd(centred, compute_uv=False)[-1]) if known.sum() > 2 else 0.0
    if narrow_m < SMALLEST_SPREAD_M:
        raise ConfigError(f"{name}: height: plane needs three points with heights that are not on a line")
    height: Array = np.linalg.lstsq(np.column_stack([np.ones(known.sum()), at[known]]), difference, rcond=None)[0]
    return height, True
