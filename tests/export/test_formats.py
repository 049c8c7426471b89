"""CSV, GeoJSON, KML and LAS hold the track, as readers of these formats find it."""

import csv
import json
from pathlib import Path
from xml.etree import ElementTree

import laspy
import numpy as np
import pytest
from tracks import DATUM, FRAME, START_NS, track

from holdfast.errors import ConfigError
from holdfast.export.crs import reference_system
from holdfast.export.formats import gps_seconds, write_csv, write_geojson, write_kml, write_las
from holdfast.export.target import SurveyedTrack, survey

KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture(scope="module")
def swiss() -> SurveyedTrack:
    return survey(track(), FRAME, reference_system("EPSG:2056", DATUM))


def test_csv_has_a_row_per_pose_with_units_in_its_header(swiss, tmp_path: Path):
    write_csv(swiss, tmp_path / "track.csv")
    with (tmp_path / "track.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == [
        "time_s", "east_m", "north_m", "ellipsoidal_height_m", "roll_deg", "pitch_deg", "heading_deg"
    ]  # fmt: skip
    assert len(rows) == len(swiss.stamps_ns)
    assert rows[0]["time_s"] == "1600000000.250000000"
    found = [[float(row[key]) for key in ("east_m", "north_m", "ellipsoidal_height_m")] for row in rows]
    np.testing.assert_allclose(found, swiss.coordinates, atol=1e-4)


def test_geojson_and_kml_are_in_wgs84_whatever_the_system(swiss, tmp_path: Path):
    write_geojson(swiss, tmp_path / "track.geojson")
    (feature,) = json.loads((tmp_path / "track.geojson").read_text())["features"]
    assert feature["geometry"]["type"] == "LineString"
    longitude, latitude, height = feature["geometry"]["coordinates"][0]
    assert (latitude, longitude) == pytest.approx((DATUM.latitude_deg, DATUM.longitude_deg), abs=1e-9)
    assert height == pytest.approx(DATUM.altitude_m, abs=1e-3)
    assert feature["properties"]["start"] == "2020-09-13T12:26:40.250Z"
    write_kml(swiss, tmp_path / "track.kml")
    line = ElementTree.parse(tmp_path / "track.kml").getroot().find(f".//{KML}LineString")
    assert line is not None
    assert (
        line.findtext(f"{KML}altitudeMode") == "clampToGround"
    )  # KML means heights above the sea, which are not known
    points = str(line.findtext(f"{KML}coordinates")).split()
    assert len(points) == len(swiss.stamps_ns)
    assert [float(x) for x in points[0].split(",")][:2] == pytest.approx([longitude, latitude], abs=1e-9)


def test_las_is_read_by_laspy_with_its_system_time_and_attitude(swiss, tmp_path: Path):
    write_las(swiss, tmp_path / "track.las")
    las = laspy.read(tmp_path / "track.las")
    np.testing.assert_allclose(np.column_stack([las.x, las.y, las.z]), swiss.coordinates, atol=5.1e-4)
    assert las.header.parse_crs().to_epsg() == 2056
    np.testing.assert_allclose(las["heading_deg"], swiss.roll_pitch_heading_deg[:, 2])
    # 2020-09-13 12:26:40.25 UTC is GPS week 2123, 44 818.25 s (18 leap seconds)
    np.testing.assert_allclose(las.gps_time[0] + 1e9, 2123 * 604800 + 44818.25, atol=1e-6)


def test_gps_time_knows_the_leap_seconds():
    stamps = np.array([1_483_228_799, 1_483_228_800]) * 10**9  # the last second of 2016, and the first of 2017
    assert gps_seconds(stamps).tolist() == [1_167_264_016.0, 1_167_264_018.0]


def test_las_refuses_degrees_and_times_of_no_date(tmp_path: Path):
    geographic = survey(track(), FRAME, reference_system("EPSG:4979", DATUM))
    with pytest.raises(ConfigError, match="LAS takes metres"):
        write_las(geographic, tmp_path / "track.las")
    young = track()
    young.stamps_ns[:] -= START_NS
    with pytest.raises(ConfigError, match="do not count from 1970"):
        write_las(survey(young, FRAME, reference_system("EPSG:2056", DATUM)), tmp_path / "track.las")
