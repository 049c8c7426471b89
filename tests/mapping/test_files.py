"""The files of a map, read again by others: coordinates, colours and bounds."""

from pathlib import Path

import numpy as np
import pytest
from lorry_yard import T_I_L, drive, sweeps

from holdfast.errors import ConfigError
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.mapping.colours import VIRIDIS, coloured, colouring
from holdfast.mapping.las import Grid, utm, write_las
from holdfast.mapping.options import SiteMapOptions
from holdfast.mapping.picture import draw_above, raster
from holdfast.mapping.ply import write_ply
from holdfast.mapping.site_map import MapBuilder, SiteMap
from holdfast.mapping.sorted_runs import Records

pyproj = pytest.importorskip("pyproj")
laspy = pytest.importorskip("laspy")

DATUM = Geodetic(47.408486, 8.5043582, 565.0)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> SiteMap:
    builder = MapBuilder(tmp_path_factory.mktemp("map"), drive(4.0), T_I_L, SiteMapOptions(voxel_m=0.2))
    for sweep in sweeps(20, 0):
        builder.add(sweep)
    return builder.finish()


@pytest.fixture(scope="module")
def records(found: SiteMap) -> Records:
    return np.concatenate(list(found.blocks()))


def expected(points: np.ndarray, crs: str) -> np.ndarray:
    """Coordinates by our own earth, one by one, and PROJ."""
    at = np.array([LocalFrame(DATUM).to_geodetic(point) for point in points])
    to = pyproj.Transformer.from_crs("EPSG:4979", crs, always_xy=True)
    east, north = to.transform(at[:, 1], at[:, 0], at[:, 2])[:2]
    return np.column_stack([east, north, at[:, 2]])


@pytest.mark.parametrize(("crs", "suffix"), [(None, ".las"), ("EPSG:2056", ".laz")])
def test_las_has_the_coordinates_of_its_reference_system(tmp_path: Path, found, records, crs, suffix):
    if suffix == ".laz":
        pytest.importorskip("lazrs")
    file = tmp_path / f"map{suffix}"
    write_las(found, colouring(found, "height"), Grid(DATUM, crs), file)
    las = laspy.read(str(file))
    assert len(las.points) == found.points
    assert las.header.parse_crs().to_epsg() == int((crs or "EPSG:32632")[5:])
    chosen = slice(0, None, 500)
    there = np.column_stack([las.x, las.y, las.z])[chosen]
    assert np.abs(there - expected(records["point"][chosen], crs or "EPSG:32632")).max() < 0.001
    assert np.array_equal(las.intensity, np.rint(records["intensity"]))
    assert np.array_equal(las["scans"], records["scans"])
    assert las.gps_time[0] == pytest.approx(records["stamp_ns"][0] * 1e-9 + 18 - 315_964_800 - 1e9, abs=1e-5)
    colours = colouring(found, "height").colours(records)
    assert np.array_equal(np.column_stack([las.red, las.green, las.blue]), colours.astype(np.uint16) * 257)


def test_a_world_without_a_datum_stays_in_W_and_takes_no_reference_system(tmp_path: Path, found, records):
    write_las(found, colouring(found, "height"), Grid(None, None), tmp_path / "map.las")
    las = laspy.read(str(tmp_path / "map.las"))
    assert las.header.parse_crs() is None
    assert np.abs(np.column_stack([las.x, las.y, las.z]) - records["point"]).max() < 0.001
    with pytest.raises(ConfigError, match="nowhere on the earth"):
        Grid(None, "EPSG:2056")
    with pytest.raises(ConfigError, match="a map takes metres"):
        Grid(DATUM, "EPSG:4979")


def test_the_zone_of_utm_is_that_of_the_datum():
    assert utm(DATUM) == "EPSG:32632"
    assert utm(Geodetic(-33.9, 151.2, 0.0)) == "EPSG:32756"
    assert utm(Geodetic(10.0, 188.0, 0.0)) == "EPSG:32602"


def test_ply_can_be_read_by_others(tmp_path: Path, found, records):
    trimesh = pytest.importorskip("trimesh")
    write_ply(found, colouring(found, "intensity"), tmp_path / "map.ply")
    cloud = trimesh.load(tmp_path / "map.ply")
    assert np.array_equal(cloud.vertices, records["point"])
    assert np.array_equal(cloud.colors[:, :3], colouring(found, "intensity").colours(records))


def test_colours_run_from_the_lowest_to_the_highest_value(found):
    ends = coloured(np.array([-1.0, 0.0, 1.0, 9.0]), 0.0, 1.0)
    assert np.array_equal(ends, VIRIDIS[[0, 0, -1, -1]])
    with pytest.raises(ConfigError, match="--colour sigma: no covariances"):
        colouring(found, "sigma")


def test_the_picture_shows_the_highest_point_of_each_pixel(tmp_path: Path, found, records):
    heights, values = raster(found, colouring(found, "intensity"), 1.0)
    column, row = np.floor(records["point"][:, :2] - found.low[:2]).astype(int).T
    for at in ((0, 0), (3, 5), (12, 7)):
        inside = records[(row == at[0]) & (column == at[1])]
        highest = inside[inside["point"][:, 2].argmax()]
        assert heights[at] == highest["point"][2]
        assert values[at] in inside["intensity"][inside["point"][:, 2] == heights[at]]
    image = pytest.importorskip("matplotlib.image")
    draw_above(found, colouring(found, "height"), drive(4.0), 0.2, tmp_path / "map.png")
    pixels = image.imread(tmp_path / "map.png")
    assert pixels.shape[0] > 500
    red, green, blue = np.moveaxis(pixels[..., :3], -1, 0)
    drawn = (red > 0.6) & (red > green + 0.2) & (blue < 0.6) & (green < 0.6)  # the track; viridis has no red
    assert 5 < drawn[:, 200:].sum() < 500  # and right of the legend


def test_a_file_for_rerun_is_written(tmp_path: Path, found):
    pytest.importorskip("rerun")
    from holdfast.viz.site_map import write_rrd

    write_rrd(found, colouring(found, "height"), drive(4.0), 0.2, tmp_path / "map.rrd")
    assert (tmp_path / "map.rrd").stat().st_size > 12 * found.points  # three float32 each
