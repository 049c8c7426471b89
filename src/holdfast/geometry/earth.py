"""The WGS84 earth: exact conversion between geodetic coordinates and a local east-north-up frame, gravity and rotation.

Constants and formulas are those of NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd edition.
"""

from dataclasses import dataclass, field
from math import atan2, copysign, cos, degrees, hypot, isfinite, radians, remainder, sin, sqrt
from typing import NamedTuple

import numpy as np

from holdfast.errors import ConfigError
from holdfast.measured_fields import got, has_double, is_number
from holdfast.messages import Array

SEMI_MAJOR_AXIS_M = 6378137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
EARTH_RATE_RAD_S = 7.292115e-5
EQUATOR_GRAVITY_M_S2 = 9.7803253359
STANDARD_GRAVITY_M_S2 = 9.80665  # by definition: the g of datasheets, and gravity where no position is known
SOMIGLIANA_CONSTANT = 0.00193185265241
CENTRIFUGAL_RATIO = 0.00344978650684  # m = omega^2 a^2 b / GM


class Geodetic(NamedTuple):
    """A point on or near the WGS84 ellipsoid; the altitude is the height above the ellipsoid, not above the sea."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


def check_datum(datum: object) -> None:
    """Refuse what is no position on the earth.

    Raises:
        ConfigError: says what it must be, and what came.
    """
    if not isinstance(datum, Geodetic) or not all(map(is_number, datum)) or not all(map(has_double, datum)):
        raise ConfigError(f"datum: must be a Geodetic (latitude_deg, longitude_deg, altitude_m), {got(datum)}")
    if not is_on_earth(datum):
        raise ConfigError(
            f"datum: must be finite, of a latitude within 90 deg and a longitude within 360 deg, {got(datum)}"
        )


def is_on_earth(point: Geodetic) -> bool:
    """Whether latitude, longitude and altitude are those of a point near the ellipsoid."""
    return all(map(isfinite, point)) and abs(point.latitude_deg) <= 90.0 and abs(point.longitude_deg) <= 360.0


def is_nowhere(point: Geodetic) -> bool:
    """Whether a point is what receivers tell before they know where they are: zeros, in the sea off Africa."""
    return point.latitude_deg == point.longitude_deg == 0.0


class _Meridian(NamedTuple):
    """A latitude and height, with the quantities of the meridian ellipse there."""

    latitude_deg: float
    altitude_m: float
    sin: float
    cos: float
    w: float  # sqrt(1 - e^2 sin^2)
    normal_radius_m: float  # radius of curvature in the prime vertical, a / w
    axis_distance_m: float  # distance from the axis of rotation


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """East-north-up frame whose origin is the datum: the world frame W.

    No flat-earth approximation, and no subtraction of two earth-centred coordinates either: those have a round-off of
    1e-9 m each. East, north and up are computed from the differences of latitude, longitude and height, which floating
    point subtracts without error for neighbours, so the round-off of `to_enu` is below 2e-15 of the distance
    to the datum plus 1e-12 m. What remains is the resolution of the degrees themselves:
    `to_geodetic` rounds to the nearest double, which is within 1e-9 m at longitudes within 128 degrees and within
    2e-9 m beyond.

    Valid at every latitude and longitude, poles and date line included, for altitudes within +-100 km.

    Raises:
        ConfigError: the datum is not a finite point with a latitude within +-90 degrees.
    """

    datum: Geodetic
    _meridian: _Meridian = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the datum and precompute its position on the meridian."""
        if not all(map(isfinite, self.datum)) or abs(self.datum.latitude_deg) > 90.0:
            raise ConfigError(f"datum {tuple(self.datum)}: must be finite, with a latitude within [-90, 90] deg")
        object.__setattr__(self, "_meridian", _meridian(self.datum.latitude_deg, self.datum.altitude_m))

    def to_enu(self, point: Geodetic) -> Array:
        """Return the (3,) position of a point, east, north and up of the datum [m]; NaN goes in, NaN comes out."""
        datum, there = self._meridian, _meridian(point.latitude_deg, point.altitude_m)
        longitude_rad = radians(_longitude_difference_deg(point.longitude_deg, self.datum.longitude_deg))
        outward, along_axis = _meridian_difference_m(there, datum)
        outward -= 2.0 * there.axis_distance_m * sin(longitude_rad / 2.0) ** 2
        return np.array(
            [
                there.axis_distance_m * sin(longitude_rad),
                datum.cos * along_axis - datum.sin * outward,
                datum.sin * along_axis + datum.cos * outward,
            ]
        )

    def axes_at(self, point: Geodetic) -> Array:
        """Return R_W_E (3, 3), east, north and up at a point in those at the datum; what is measured there is in E."""
        datum, there = self._meridian, _meridian(point.latitude_deg, point.altitude_m)
        longitude_rad = radians(_longitude_difference_deg(point.longitude_deg, self.datum.longitude_deg))
        of_datum, of_point = _axes(datum, 0.0), _axes(there, longitude_rad)
        rotation: Array = of_datum @ of_point.T
        return rotation

    def to_geodetic(self, enu: Array) -> Geodetic:
        """Return the point at `enu` (3,) [m] from the datum; its longitude is within [-180, 180] deg.

        Longitude follows in closed form; latitude and height by a Newton step on the meridian ellipse from
        Bowring's closed form (Survey Review 23, 1976), with residuals as differences to the datum as in `to_enu`.
        """
        east, north, up = (float(value) for value in enu)
        datum = self._meridian
        outward = datum.cos * up - datum.sin * north
        along_axis = datum.sin * up + datum.cos * north
        axis_distance = hypot(datum.axis_distance_m + outward, east)
        longitude_rad = atan2(east, datum.axis_distance_m + outward)
        # axis_distance - datum.axis_distance without cancellation, where there is one to fear
        if datum.axis_distance_m > 0.0:
            total = axis_distance + datum.axis_distance_m
            outward = (outward * (2.0 * datum.axis_distance_m + outward) + east * east) / total
        else:
            outward = axis_distance
        latitude_deg, altitude_m = _solve_meridian(datum, axis_distance, outward, along_axis)
        longitude_deg = remainder(remainder(self.datum.longitude_deg, 360.0) + degrees(longitude_rad), 360.0)
        return Geodetic(latitude_deg, longitude_deg, altitude_m)


def gravity(latitude_deg: float, altitude_m: float) -> float:
    """Return normal gravity [m/s^2], centrifugal acceleration included, which acts along the ellipsoid's normal.

    Somigliana's formula on the ellipsoid (TR8350.2 eq. 4-1), continued upward to second order in height (eq. 4-3).
    """
    sin2 = sin(radians(latitude_deg)) ** 2
    on_ellipsoid = EQUATOR_GRAVITY_M_S2 * (1.0 + SOMIGLIANA_CONSTANT * sin2) / sqrt(1.0 - ECCENTRICITY_SQUARED * sin2)
    height = altitude_m / SEMI_MAJOR_AXIS_M
    slope = 2.0 * (1.0 + FLATTENING + CENTRIFUGAL_RATIO - 2.0 * FLATTENING * sin2)
    return on_ellipsoid * (1.0 - slope * height + 3.0 * height**2)


def gravity_at(datum: Geodetic | None) -> float:
    """Return normal gravity at a datum [m/s^2], the standard one where there is none."""
    return STANDARD_GRAVITY_M_S2 if datum is None else gravity(datum.latitude_deg, datum.altitude_m)


def earth_rate_enu(latitude_deg: float) -> Array:
    """Return the (3,) angular velocity of the earth against the stars, in east, north, up [rad/s]."""
    sin_latitude, cos_latitude = _sin_cos(latitude_deg)
    return np.array([0.0, EARTH_RATE_RAD_S * cos_latitude, EARTH_RATE_RAD_S * sin_latitude])


def _sin_cos(latitude_deg: float) -> tuple[float, float]:
    """Return sine and cosine; the cosine is small, and right to its last digits, close to the poles."""
    colatitude_deg = 90.0 - abs(latitude_deg)
    cosine = sin(radians(colatitude_deg)) if colatitude_deg < 45.0 else cos(radians(latitude_deg))
    return sin(radians(latitude_deg)), cosine


def _longitude_difference_deg(to_deg: float, from_deg: float) -> float:
    """Return the smaller difference between two longitudes, without round-off where they are close."""
    to_deg, from_deg = remainder(to_deg, 360.0), remainder(from_deg, 360.0)
    if abs(to_deg - from_deg) <= 180.0:
        return to_deg - from_deg
    # on two sides of the date line: measure both from it, each of which is exact close to it
    return (to_deg - copysign(180.0, to_deg)) - (from_deg - copysign(180.0, from_deg))


def _meridian(latitude_deg: float, altitude_m: float) -> _Meridian:
    sine, cosine = _sin_cos(latitude_deg)
    w = sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    normal_radius = SEMI_MAJOR_AXIS_M / w
    return _Meridian(latitude_deg, altitude_m, sine, cosine, w, normal_radius, (normal_radius + altitude_m) * cosine)


def _axes(at: _Meridian, longitude_rad: float) -> Array:
    """Return east, north and up (3, 3) as rows: outward at the longitude zero, east of it, along the axis."""
    sine, cosine = sin(longitude_rad), cos(longitude_rad)
    return np.array(
        [
            [-sine, cosine, 0.0],
            [-at.sin * cosine, -at.sin * sine, at.cos],
            [at.cos * cosine, at.cos * sine, at.sin],
        ]
    )


def _meridian_difference_m(there: _Meridian, here: _Meridian) -> tuple[float, float]:
    """Return there minus here, away from and along the axis of rotation [m], without cancellation.

    With s, c sine and cosine of the latitude, N the normal radius, h the height and D(.) = there - here:
        D((N + h) c)           = (N + h) D(c)           + (D(N) + D(h)) c_here
        D((N (1 - e^2) + h) s) = (N (1 - e^2) + h) D(s) + ((1 - e^2) D(N) + D(h)) s_here
    where the sum formulas give D(s), D(c) and D(s^2) from the difference of the latitudes.
    """
    shrink = 1.0 - ECCENTRICITY_SQUARED
    difference = radians(there.latitude_deg - here.latitude_deg)
    sin_mean, cos_mean = _sin_cos((there.latitude_deg + here.latitude_deg) / 2.0)
    chord = 2.0 * sin(difference / 2.0)
    d_sin_squared = 2.0 * sin_mean * cos_mean * sin(difference)
    d_radius = SEMI_MAJOR_AXIS_M * ECCENTRICITY_SQUARED * d_sin_squared / (there.w * here.w * (there.w + here.w))
    d_height = there.altitude_m - here.altitude_m
    outward = -(there.normal_radius_m + there.altitude_m) * sin_mean * chord + (d_radius + d_height) * here.cos
    along_axis = (there.normal_radius_m * shrink + there.altitude_m) * cos_mean * chord + (
        shrink * d_radius + d_height
    ) * here.sin
    return outward, along_axis


def _solve_meridian(here: _Meridian, axis_distance: float, outward: float, along_axis: float) -> tuple[float, float]:
    """Return latitude [deg] and height [m] of the point that is `outward` and `along_axis` [m] from `here`."""
    shrink = 1.0 - ECCENTRICITY_SQUARED
    height_on_axis = (here.normal_radius_m * shrink + here.altitude_m) * here.sin + along_axis
    parametric = atan2(height_on_axis, axis_distance * sqrt(shrink))
    latitude = atan2(
        height_on_axis + ECCENTRICITY_SQUARED / sqrt(shrink) * SEMI_MAJOR_AXIS_M * sin(parametric) ** 3,
        axis_distance - ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS_M * cos(parametric) ** 3,
    )
    there = _meridian(degrees(latitude), here.altitude_m)
    # one Newton step: Bowring's latitude is right to 1e-8 rad, whose square is below the resolution of a double
    reached_outward, reached_along = _meridian_difference_m(there, here)
    residual_outward, residual_along = outward - reached_outward, along_axis - reached_along
    altitude = there.altitude_m + there.sin * residual_along + there.cos * residual_outward
    north = there.cos * residual_along - there.sin * residual_outward
    latitude_deg = there.latitude_deg + degrees(north / (there.normal_radius_m * shrink / there.w**2 + altitude))
    return max(-90.0, min(90.0, latitude_deg)), altitude
