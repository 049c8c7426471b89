"""Site grids: a known similarity is found, residuals tell the mistake, and degenerate points are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tracks import DATUM, FRAME

from holdfast.errors import ConfigError
from holdfast.export.crs import reference_system
from holdfast.export.site_grid import ControlPoints, localise, read_control_points

CORNERS = np.array(
    [[0.0, 0.0, 0.0], [400.0, 20.0, 5.0], [380.0, 300.0, 12.0], [-30.0, 280.0, 3.0], [150.0, 150.0, 8.0]]
)
ROTATION_DEG, SCALE, SHIFT, DROP_M = 30.0, 1.0002, np.array([1000.0, 5000.0]), -48.25


def site(corners: np.ndarray = CORNERS) -> ControlPoints:
    """Points whose local coordinates are a similarity of those of the Swiss grid."""
    geodetic = np.array([FRAME.to_geodetic(corner) for corner in corners])
    grid = reference_system("EPSG:2056", DATUM).transform(geodetic)
    angle = np.radians(ROTATION_DEG)
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    local = SCALE * (grid[:, :2] - [2_600_000.0, 1_200_000.0]) @ R.T + SHIFT
    return ControlPoints(
        [f"P{k}" for k in range(len(corners))], geodetic, np.column_stack([local, grid[:, 2] + DROP_M])
    )


def test_a_similarity_of_the_national_grid_is_found_within_a_millimetre():
    grid = localise(site(), "site")
    assert np.abs(grid.residuals).max() < 1e-3
    # the plane is at the height of the site, the Swiss grid on Bessel's ellipsoid, here 49.6 m above that of WGS84
    above_m = site().geodetic[:, 2].mean() - 49.6
    assert grid.scale == pytest.approx(SCALE / (1.0 + above_m / 6_371_000.0), abs=1e-6)
    assert grid.rotation_deg == pytest.approx(ROTATION_DEG, abs=1e-3)
    between = site(np.array([[200.0, 100.0, 6.0], [50.0, 200.0, 1.0]]))
    np.testing.assert_allclose(grid.transform(between.geodetic), between.local, atol=1e-3)


def test_residuals_show_the_point_that_is_wrong():
    points = site()
    points.local[2] += [0.30, 0.0, 0.10]
    residuals = localise(points, "site").residuals
    assert np.abs(residuals).max(axis=1).argmax() == 2
    assert residuals[2, 0] > 0.15
    assert np.abs(residuals.sum(axis=0)).max() < 1e-6  # least squares: they add up to nothing


def test_a_sloping_geoid_is_followed_by_a_plane_and_not_by_a_shift():
    points = site()
    points.local[:, 2] += CORNERS[:, 0] * 1e-4  # 4 cm over the site
    shifted = localise(points, "site").residuals[:, 2]
    assert np.abs(shifted).max() > 0.015
    tilted = localise(replace(points, is_plane=True), "site").residuals[:, 2]
    assert np.abs(tilted).max() < 1e-3


def test_without_heights_ellipsoidal_ones_are_written_and_that_is_told():
    points = site()
    points.local[:, 2] = np.nan
    grid = localise(points, "site")
    assert grid.heights.column == "ellipsoidal_height_m"
    assert "no point has a height" in grid.heights.note
    assert grid.transform(points.geodetic)[0, 2] == pytest.approx(points.geodetic[0, 2], abs=1e-9)


def test_two_points_are_taken_and_their_lack_of_a_residual_is_told():
    points = site(CORNERS[:2])
    assert "cannot be seen" in localise(points, "site").notes[0]
    np.testing.assert_allclose(localise(points, "site").transform(points.geodetic), points.local, atol=1e-6)


def swapped(points: ControlPoints) -> ControlPoints:
    return replace(points, local=points.local[:, [1, 0, 2]])


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (site(CORNERS[:1]), "1 control points"),
        (site(CORNERS[[0, 0]] + [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]), r"within 0\.50 m"),
        (replace(site(), local=np.tile([1.0, 2.0, 3.0], (5, 1))), "site positions are within 0"),
        (swapped(site()), "east and north of the site are swapped"),
        (replace(site(), local=site().local * 3.28084), r"the scale is 3\.28"),
        (replace(site(CORNERS[:2]), is_plane=True), "plane needs three points"),
        (replace(site(np.array([[0.0, 0, 0], [100.0, 0, 0], [200.0, 0, 0]])), is_plane=True), "not on a line"),
    ],
)
def test_points_that_determine_nothing_are_refused(points, words):
    with pytest.raises(ConfigError, match=words):
        localise(points, "site")


HEADER = "name,latitude_deg,longitude_deg,altitude_m,east_m,north_m,height_m\n"
YAML_POINT = "- {name: A, latitude_deg: 46.9, longitude_deg: 7.4, altitude_m: 550, east_m: 1, north_m: 2}"


def test_control_points_are_read_from_csv_and_yaml(tmp_path: Path):
    (tmp_path / "site.csv").write_text(HEADER + "A,46.9,7.4,550,1000,2000,501.5\nB,46.91,7.41,551,1100,2100,\n")
    points = read_control_points(tmp_path / "site.csv")
    assert points.names == ["A", "B"]
    assert points.local[0].tolist() == [1000.0, 2000.0, 501.5]
    assert np.isnan(points.local[1, 2])
    assert not points.is_plane
    (tmp_path / "site.yaml").write_text(f"height: plane\npoints:\n{YAML_POINT}\n")
    points = read_control_points(tmp_path / "site.yaml")
    assert points.is_plane
    assert points.geodetic[0].tolist() == [46.9, 7.4, 550.0]


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("site.csv", HEADER + "A,46.9,7.4,550,one,2000,\n", "point 1: east_m one: must be a number"),
        ("site.csv", HEADER + "A,146.9,7.4,550,1,2000,\n", r"latitude_deg 146\.9"),
        ("site.csv", HEADER + "A,46.9\n", "longitude_deg None"),
        ("site.yaml", "- 1\n", "holds no control points"),
        ("site.yaml", "points: [1]\n", "point 1: is no point"),
        ("site.yaml", "points: [\n", "holds no control points"),
        ("site.yaml", f"height: tilt\npoints:\n{YAML_POINT}\n", "allowed: shift, plane"),
        ("none.yaml", None, "no such file"),
    ],
)
def test_a_file_that_holds_no_control_points_is_refused(tmp_path: Path, file: str, text: str | None, words: str):
    if text is not None:
        (tmp_path / file).write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        read_control_points(tmp_path / file)
    assert file in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_control_points_that_are_nested_deeply_or_hold_control_characters_are_one_printable_line(tmp_path):
    (tmp_path / "deep.yaml").write_text("points: " + "[" * 4000)
    with pytest.raises(ConfigError, match=r"deep\.yaml:1 is nested too deeply"):
        read_control_points(tmp_path / "deep.yaml")
    head = "name,latitude_deg,longitude_deg,altitude_m,east_m,north_m,height_m\n"
    (tmp_path / "odd.csv").write_text(head + "a,47.0,8\x1b[31m,400,1,2,3\n")
    with pytest.raises(ConfigError) as caught:
        read_control_points(tmp_path / "odd.csv")
    assert str(caught.value).isprintable()
