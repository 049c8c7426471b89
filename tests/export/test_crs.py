"""Coordinate reference systems: known coordinates, round trips, and heights that are what they are called."""

from pathlib import Path

import numpy as np
import pyproj
import pytest
from tracks import DATUM, FRAME, track

from holdfast.errors import ConfigError
from holdfast.export.crs import ELLIPSOIDAL, reference_system
from holdfast.export.target import survey
from holdfast.geometry.earth import Geodetic

BERN = np.array([DATUM])


def constant_geoid(path: Path, height_m: float, west: float = 7.0, south: float = 46.0) -> Path:
    """Write a GTX grid of two by two degrees with one geoid height."""
    header = np.array([south, west, 1.0, 1.0], dtype=">f8").tobytes() + np.array([3, 3], dtype=">i4").tobytes()
    path.write_bytes(header + np.full(9, height_m, dtype=">f4").tobytes())
    return path


def test_the_origin_of_the_swiss_grid_has_the_coordinates_that_swisstopo_gives_it():
    east, north, _ = reference_system("EPSG:2056", DATUM).transform(BERN)[0]
    assert abs(east - 2_600_000.0) < 0.005
    assert abs(north - 1_200_000.0) < 0.005


@pytest.mark.parametrize("crs", ["EPSG:2056", "EPSG:32632", "EPSG:25832", "EPSG:3857", "EPSG:4326"])
def test_coordinates_lead_back_to_the_world_within_a_millimetre(crs):
    surveyed = survey(track(), FRAME, reference_system(crs, DATUM))
    # pyproj's own way back is the judge, in three dimensions: heights above Bessel's ellipsoid are others
    back = pyproj.Transformer.from_crs(pyproj.CRS(crs).to_3d(), "EPSG:4979", always_xy=True)
    east, north, height = surveyed.coordinates.T
    latitude, longitude, _ = surveyed.geodetic.T
    above = back.transform(longitude, latitude, height, direction="INVERSE")[2]
    longitude, latitude, _ = back.transform(east, north, above)
    points = [FRAME.to_enu(Geodetic(*p)) for p in zip(latitude, longitude, height, strict=True)]
    np.testing.assert_allclose(points, track().positions, atol=1e-3)


def test_headings_count_clockwise_from_the_north_of_the_grid():
    at_the_meridian = survey(track(), FRAME, reference_system("EPSG:2056", DATUM))
    assert at_the_meridian.roll_pitch_heading_deg[0] == pytest.approx([0.0, 0.0, 45.0], abs=1e-3)
    # Bern is 1.56 deg west of the central meridian of UTM 32: its grid north is 1.14 deg west of true north there
    utm = survey(track(), FRAME, reference_system("EPSG:32632", DATUM))
    convergence = pyproj.Proj("EPSG:32632").get_factors(DATUM.longitude_deg, DATUM.latitude_deg).meridian_convergence
    assert utm.roll_pitch_heading_deg[0, 2] == pytest.approx(45.0 - convergence, abs=2e-3)
    geographic = survey(track(), FRAME, reference_system("EPSG:4979", DATUM))
    assert geographic.roll_pitch_heading_deg[0, 2] == pytest.approx(45.0, abs=1e-3)


def test_a_system_without_heights_gets_ellipsoidal_ones_and_says_so():
    target = reference_system("EPSG:2056", DATUM)
    assert target.heights.column == ELLIPSOIDAL
    assert "above the WGS84 ellipsoid" in target.heights.note
    assert target.transform(BERN)[0, 2] == DATUM.altitude_m


def test_without_the_grid_of_a_geoid_no_height_is_called_one_above_the_sea():
    target = reference_system("EPSG:2056+5728", DATUM)
    if target.heights.is_above_sea:
        pytest.skip("the grid of LN02 is installed here")
    assert target.heights.column == ELLIPSOIDAL
    assert "ch_swisstopo_chgeo2004_ETRS89_LN02.tif is not installed" in target.heights.note
    assert target.transform(BERN)[0, 2] == DATUM.altitude_m
    assert target.crs == pyproj.CRS("EPSG:2056")


def test_a_geoid_grid_gives_heights_above_the_sea(tmp_path: Path):
    target = reference_system("EPSG:2056", DATUM, constant_geoid(tmp_path / "geoid.gtx", 49.5))
    assert target.heights.column == "height_m"
    assert not target.heights.note
    assert target.transform(BERN)[0, 2] == pytest.approx(DATUM.altitude_m - 49.5, abs=1e-6)


def test_a_geoid_that_ends_before_the_track_is_refused(tmp_path: Path):
    target = reference_system("EPSG:2056", DATUM, constant_geoid(tmp_path / "geoid.gtx", 49.5, west=20.0))
    with pytest.raises(ConfigError, match=r"not defined at 46\.951083 deg N"):
        target.transform(BERN)


def test_a_coarser_operation_for_want_of_a_grid_is_told():
    london = Geodetic(51.5, -0.1, 40.0)
    target = reference_system("EPSG:27700", london)
    if not target.notes:
        pytest.skip("the grid of OSTN15 is installed here")
    assert "uk_os_OSTN15_NTv2_OSGBtoETRS.tif is not installed" in target.notes[0]


@pytest.mark.parametrize(
    ("crs", "words"),
    [("EPSG:99999", "PROJ knows no such system"), ("nonsense", "PROJ knows no such system"),
     ("EPSG:27700", "is for .*United Kingdom.*the track is at 46"), ("EPSG:5728", "neither projected nor geographic"),
     ("EPSG:4978", "neither projected nor geographic")],
)  # fmt: skip
def test_a_system_that_cannot_be_is_refused(crs, words):
    with pytest.raises(ConfigError, match=words):
        reference_system(crs, DATUM)


def test_what_is_no_geoid_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match="no such file"):
        reference_system("EPSG:2056", DATUM, tmp_path / "none.gtx")
    (tmp_path / "bad.gtx").write_text("nothing")
    with pytest.raises(ConfigError, match="no grid that PROJ can read"):
        reference_system("EPSG:2056", DATUM, tmp_path / "bad.gtx")
