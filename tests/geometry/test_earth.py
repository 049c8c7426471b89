from decimal import Decimal, getcontext

import numpy as np
import pymap3d
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from holdfast.errors import ConfigError
from holdfast.geometry.earth import (
    EARTH_RATE_RAD_S,
    Geodetic,
    LocalFrame,
    earth_rate_enu,
    gravity,
)

ZURICH = Geodetic(47.4, 8.5, 450.0)

latitudes = st.floats(-90.0, 90.0)
longitudes = st.floats(-180.0, 180.0)
altitudes = st.floats(-100_000.0, 100_000.0)
points = st.builds(Geodetic, latitudes, longitudes, altitudes)
offsets = st.tuples(*[st.floats(-10_000.0, 10_000.0)] * 3).map(np.array)


def resolution_m(point):
    """How far two neighbouring doubles of latitude, longitude and height are apart."""
    degree_m = 113_500.0  # 100 km above the ground
    north = np.spacing(abs(point.latitude_deg)) * degree_m
    east = np.spacing(abs(point.longitude_deg)) * degree_m * np.cos(np.radians(point.latitude_deg))
    return float(np.linalg.norm([north, east, np.spacing(abs(point.altitude_m))]))


def round_off_m(distance_m):
    """What `LocalFrame` promises of each direction."""
    return 2e-15 * distance_m + 1e-12


# --- an outside judge with 50 digits: textbook ECEF, nothing clever ---------------------------------------------------


def decimal_sin_cos(degrees):
    """Sine and cosine by their series, for an angle whose double is taken as exact."""
    getcontext().prec = 50
    pi = Decimal("3.14159265358979323846264338327950288419716939937510582")
    x = Decimal(degrees) * pi / 180
    sine, cosine, term, n = Decimal(0), Decimal(0), Decimal(1), 0
    while abs(term) > Decimal("1e-49"):
        sign = -1 if n % 4 >= 2 else 1
        sine, cosine = (sine + sign * term, cosine) if n % 2 else (sine, cosine + sign * term)
        n += 1
        term = term * x / n if x else Decimal(0)
    return sine, cosine


def decimal_ecef(point):
    (sin_lat, cos_lat), (sin_lon, cos_lon) = decimal_sin_cos(point.latitude_deg), decimal_sin_cos(point.longitude_deg)
    a, f, h = Decimal(6378137), 1 / Decimal("298.257223563"), Decimal(point.altitude_m)
    e2 = f * (2 - f)
    normal = a / (1 - e2 * sin_lat**2).sqrt()
    return (
        (normal + h) * cos_lat * cos_lon,
        (normal + h) * cos_lat * sin_lon,
        (normal * (1 - e2) + h) * sin_lat,
    )


def decimal_enu(point, datum):
    x, y, z = (there - here for there, here in zip(decimal_ecef(point), decimal_ecef(datum), strict=True))
    (sin_lat, cos_lat), (sin_lon, cos_lon) = decimal_sin_cos(datum.latitude_deg), decimal_sin_cos(datum.longitude_deg)
    outward = cos_lon * x + sin_lon * y
    return np.array(
        [
            float(-sin_lon * x + cos_lon * y),
            float(-sin_lat * outward + cos_lat * z),
            float(cos_lat * outward + sin_lat * z),
        ]
    )


# --- east, north, up --------------------------------------------------------------------------------------------------


@given(points, points)
@example(Geodetic(90.0, 0.0, 0.0), Geodetic(89.9999, 120.0, 10.0))
@example(Geodetic(-89.9999, -30.0, 0.0), Geodetic(-90.0, 0.0, 0.0))
@example(Geodetic(0.0, -179.9999, 0.0), Geodetic(0.0, 179.9999, 0.0))
@example(Geodetic(0.0, 180.0, 0.0), Geodetic(0.0, 0.0, 0.0))
def test_enu_is_exact_between_any_two_points_of_the_earth(point, datum):
    expected = decimal_enu(point, datum)
    assert np.linalg.norm(LocalFrame(datum).to_enu(point) - expected) < round_off_m(np.linalg.norm(expected))


@given(points, st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(-100.0, 100.0))
@example(Geodetic(0.0, 179.999, 0.0), 0.0, 0.01, 0.0)
def test_enu_of_neighbours_has_no_round_off_of_earth_centred_coordinates(datum, north_deg, east_deg, up_m):
    point = Geodetic(
        min(90.0, max(-90.0, datum.latitude_deg + north_deg)),
        datum.longitude_deg + east_deg,
        datum.altitude_m + up_m,
    )
    assert np.abs(LocalFrame(datum).to_enu(point) - decimal_enu(point, datum)).max() < 1e-11


@given(points, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_enu_agrees_with_pymap3d_within_the_round_off_of_its_earth_centred_coordinates(datum, north_deg, east_deg):
    point = Geodetic(
        min(90.0, max(-90.0, datum.latitude_deg + north_deg)), datum.longitude_deg + east_deg, datum.altitude_m
    )
    theirs = np.array(pymap3d.geodetic2enu(*point, *datum))
    assert np.abs(LocalFrame(datum).to_enu(point) - theirs).max() < 5e-9  # four roundings of 6.4e6 m: 4 * 0.93e-9


def test_axes_point_east_north_and_up():
    frame = LocalFrame(ZURICH)
    east = frame.to_enu(ZURICH._replace(longitude_deg=8.5001))
    north = frame.to_enu(ZURICH._replace(latitude_deg=47.4001))
    up = frame.to_enu(ZURICH._replace(altitude_m=451.0))
    assert east[0] > 7.0 and abs(east[1]) < 1e-4 and abs(east[2]) < 1e-4
    assert north[1] > 11.0 and abs(north[0]) < 1e-12 and abs(north[2]) < 1e-4
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=1e-12)


@given(points, points)
@example(Geodetic(90.0, 0.0, 0.0), Geodetic(47.4, 8.5, 450.0))
@example(Geodetic(0.0, 179.999, 0.0), Geodetic(0.0, -179.999, 0.0))
def test_axes_elsewhere_are_those_of_pymap3d(point, datum):
    axes = LocalFrame(datum).axes_at(point)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)
    for axis, vector in zip(np.eye(3), axes.T, strict=True):
        in_earth = pymap3d.enu2uvw(*axis, *point[:2])
        np.testing.assert_allclose(vector, pymap3d.uvw2enu(*in_earth, *datum[:2]), atol=1e-9)


def test_axes_at_the_datum_are_its_own():
    np.testing.assert_allclose(LocalFrame(ZURICH).axes_at(ZURICH), np.eye(3), atol=1e-15)


def test_the_earth_is_not_flat():
    height_of_the_horizon = LocalFrame(Geodetic(0.0, 0.0, 0.0)).to_enu(Geodetic(0.0, 0.1, 0.0))[2]
    assert height_of_the_horizon == pytest.approx(-6378137.0 * (1.0 - np.cos(np.radians(0.1))), abs=1e-8)


@given(points, st.integers(-2, 2))
def test_longitude_may_be_given_on_any_revolution(point, turns):
    turned = point._replace(longitude_deg=point.longitude_deg + 360.0 * turns)
    rounding_m = np.spacing(900.0) * 111_700.0
    assert np.linalg.norm(LocalFrame(ZURICH).to_enu(turned) - LocalFrame(ZURICH).to_enu(point)) <= 2.0 * rounding_m


# --- and back ---------------------------------------------------------------------------------------------------------


@given(points, offsets)
@example(Geodetic(90.0, 0.0, 0.0), np.array([0.0, 0.0, 0.0]))
@example(Geodetic(-90.0, 77.0, 0.0), np.array([1.0, -2.0, 3.0]))
@example(Geodetic(89.99999, 10.0, 0.0), np.array([0.0, 5.0, 0.0]))
@example(Geodetic(0.0, 180.0, 0.0), np.array([1e-3, 0.0, 0.0]))
@example(Geodetic(0.0, -180.0, 0.0), np.array([-1e-3, 0.0, 0.0]))
def test_enu_comes_back_from_geodetic_to_the_resolution_of_a_double(datum, enu):
    frame = LocalFrame(datum)
    point = frame.to_geodetic(enu)
    assert abs(point.latitude_deg) <= 90.0 and abs(point.longitude_deg) <= 180.0
    allowed_m = resolution_m(point) + 2.0 * round_off_m(np.linalg.norm(enu))
    assert np.linalg.norm(frame.to_enu(point) - enu) <= allowed_m


@given(st.builds(Geodetic, latitudes, st.floats(-127.0, 127.0), altitudes), offsets)
def test_enu_comes_back_within_a_nanometre_up_to_longitude_128(datum, enu):
    frame = LocalFrame(datum)
    if abs(datum.latitude_deg) < 89.0:
        assert np.linalg.norm(frame.to_enu(frame.to_geodetic(enu)) - enu) < 1e-9


@given(points, points)
def test_any_point_comes_back_from_any_datum(point, datum):
    back = LocalFrame(datum).to_geodetic(LocalFrame(datum).to_enu(point))
    residual = LocalFrame(point).to_enu(back)
    assert np.linalg.norm(residual) < 1e-8  # the distance is up to 1.3e7 m, whose doubles are 1.9e-9 m apart


@given(points)
def test_the_datum_is_the_origin_both_ways(datum):
    frame = LocalFrame(datum)
    np.testing.assert_array_equal(np.abs(frame.to_enu(datum)), np.zeros(3))
    np.testing.assert_allclose(
        frame.to_enu(frame.to_geodetic(np.zeros(3))), np.zeros(3), atol=resolution_m(datum) + 1e-12
    )


@pytest.mark.parametrize(
    "datum", [Geodetic(91.0, 0.0, 0.0), Geodetic(float("nan"), 0.0, 0.0), Geodetic(0.0, float("inf"), 0.0)]
)
def test_a_datum_off_the_earth_is_refused(datum):
    with pytest.raises(ConfigError, match="datum"):
        LocalFrame(datum)


def test_a_fix_without_altitude_stays_without_position():
    assert np.isnan(LocalFrame(ZURICH).to_enu(ZURICH._replace(altitude_m=float("nan")))).any()


# --- gravity and rotation ---------------------------------------------------------------------------------------------


def test_gravity_on_the_ellipsoid_is_that_of_the_wgs84_report():
    assert gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert gravity(90.0, 0.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert gravity(45.0, 0.0) == pytest.approx(9.8061977695, abs=1e-9)


@given(latitudes, st.floats(0.0, 9_000.0))
def test_gravity_falls_with_height_as_free_air(latitude_deg, altitude_m):
    drop = gravity(latitude_deg, altitude_m) - gravity(latitude_deg, 0.0)
    assert drop == pytest.approx(-3.086e-6 * altitude_m, rel=5e-3, abs=1e-12)


@given(latitudes)
def test_the_gradient_of_gravity_falls_as_by_the_inverse_square(latitude_deg):
    low, middle, high = (gravity(latitude_deg, altitude_m) for altitude_m in (0.0, 5_000.0, 10_000.0))
    assert high - 2.0 * middle + low == pytest.approx(6.0 * low * (5_000.0 / 6_371_000.0) ** 2, rel=0.02)


@given(latitudes)
def test_gravity_is_the_same_north_and_south(latitude_deg):
    assert gravity(latitude_deg, 100.0) == gravity(-latitude_deg, 100.0)


def test_the_earth_turns_about_north_at_the_equator_and_about_up_at_the_pole():
    np.testing.assert_allclose(earth_rate_enu(0.0), [0.0, 7.292115e-5, 0.0], atol=1e-20)
    np.testing.assert_allclose(earth_rate_enu(90.0), [0.0, 0.0, 7.292115e-5], atol=1e-20)
    np.testing.assert_allclose(earth_rate_enu(-30.0), EARTH_RATE_RAD_S * np.array([0.0, np.sqrt(3.0), -1.0]) / 2.0)


@given(latitudes)
def test_the_earth_turns_once_in_a_sidereal_day_everywhere(latitude_deg):
    sidereal_day_s = 86164.0905
    assert np.linalg.norm(earth_rate_enu(latitude_deg)) * sidereal_day_s == pytest.approx(2.0 * np.pi, rel=1e-6)
