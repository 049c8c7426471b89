"""What a track is exported to: the contract between coordinate systems and formats."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from holdfast.geometry.earth import ECCENTRICITY_SQUARED, Geodetic, LocalFrame
from holdfast.messages import Array
from holdfast.state import Trajectory

AHEAD_M = 10.0  # by which the direction of a heading is carried over


@dataclass(frozen=True, slots=True)
class Heights:
    """What the third coordinate is.

    Attributes:
        column: its name, with its unit.
        note: what a user must know about it; empty if nothing.
        is_above_sea: whether it is a height above sea level, not above the ellipsoid.
    """

    column: str
    note: str = ""
    is_above_sea: bool = False


class Target(Protocol):
    """A coordinate system of east, north and height."""

    @property
    def name(self) -> str:
        """Return what it is called."""

    @property
    def columns(self) -> tuple[str, str]:
        """Return the names of the horizontal coordinates, with their units."""

    @property
    def heights(self) -> Heights:
        """Return what the heights are."""

    @property
    def crs(self) -> Any:
        """Return its pyproj.CRS, None if it is none that others know."""

    @property
    def notes(self) -> Sequence[str]:
        """Return what a user must know about the horizontal coordinates."""

    def transform(self, points: Array) -> Array:
        """Return (N, 3) east, north, height of points (N, 3): latitude, longitude [deg], ellipsoidal height [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedTrack:
    """A track in the coordinates of a target.

    Attributes:
        stamps_ns: (N,).
        geodetic: (N, 3) latitude, longitude [deg], height above the WGS84 ellipsoid [m].
        coordinates: (N, 3) of the target.
        roll_pitch_heading_deg: (N, 3); heading clockwise from the north of the target.
    """

    target: Target
    stamps_ns: np.ndarray[Any, np.dtype[np.int64]]
    geodetic: Array
    coordinates: Array
    roll_pitch_heading_deg: Array


def survey(track: Trajectory, frame: LocalFrame, target: Target) -> SurveyedTrack:
    """Carry a track in W over to a target.

    Args:
        track: poses in W.
        frame: W about its datum.
        target: where to.
    """
    x, y, z, w = track.quaternions.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    ahead = track.positions + AHEAD_M * np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
    geodetic = _geodetic(track.positions, frame)
    coordinates = target.transform(geodetic)
    east, north = (target.transform(_geodetic(ahead, frame)) - coordinates)[:, :2].T
    if target.columns[0].endswith("_deg"):  # a degree of longitude is shorter than one of latitude
        latitude = np.radians(geodetic[:, 0])
        radii = (1.0 - ECCENTRICITY_SQUARED) / (1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
        east, north = east * np.cos(latitude), north * radii
    heading = np.degrees(np.arctan2(east, north)) % 360.0
    angles = np.column_stack([np.degrees(roll), np.degrees(pitch), heading])
    return SurveyedTrack(target, track.stamps_ns, geodetic, coordinates, angles)


def _geodetic(positions: Array, frame: LocalFrame) -> Array:
    points: list[Geodetic] = [frame.to_geodetic(position) for position in positions]
    return np.array(points).reshape(-1, 3)
