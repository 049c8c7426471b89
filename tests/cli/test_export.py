"""`holdfast export`: every format from one command, and each mistake in one line."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from holdfast.cli import holdfast
from holdfast.errors import HoldfastError
from holdfast.output_folder import MARK, replaced

sys.path.append(str(Path(__file__).parents[1] / "export"))

from tracks import FRAME, folder, track


def call(*arguments: str | Path) -> str:
    result = CliRunner().invoke(
        holdfast, ["export", *map(str, arguments)], catch_exceptions=False, standalone_mode=False
    )
    assert result.exit_code == 0
    return result.output


def test_one_command_writes_every_format_and_tells_what_the_heights_are(tmp_path: Path):
    out = folder(tmp_path / "out")
    files = [tmp_path / f"track.{suffix}" for suffix in ("csv", "geojson", "kml", "las")]
    told = call(out, "--crs", "EPSG:2056", "--interval", "0.5", *(word for file in files for word in ("-o", file)))
    assert "note: EPSG:2056 has no heights: those above the WGS84 ellipsoid are written" in told
    assert "10 poses" in told
    assert all(file.stat().st_size > 100 for file in files)
    assert (tmp_path / "track.csv").read_text().splitlines()[1].startswith("1600000000.250000000,2600000.00")


def test_a_site_grid_prints_its_residuals(tmp_path: Path):
    out = folder(tmp_path / "out")
    rows = ["name,latitude_deg,longitude_deg,altitude_m,east_m,north_m,height_m"]
    for k, (east, north) in enumerate([(0.0, 0.0), (300.0, 0.0), (300.0, 400.0), (0.0, 400.0)]):
        point = FRAME.to_geodetic(np.array([east, north, 0.0]))
        off = 0.020 if k == 2 else 0.0
        rows.append(
            f"P{k},{point[0]:.12f},{point[1]:.12f},{point[2]:.4f},{east + 100 + off},{north + 200},{point[2] - 50}"
        )
    (tmp_path / "site.csv").write_text("\n".join(rows) + "\n")
    told = call(out, "--site-grid", tmp_path / "site.csv", "-o", out / "trajectory.csv", "-o", out / "track.kml")
    assert "clampToGround" in (out / "track.kml").read_text()  # heights of a site are none above the sea
    worst = max(
        (line.split() for line in told.splitlines() if line.startswith("P")), key=lambda row: abs(float(row[1]))
    )
    assert worst[0] == "P2"
    table = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1)
    expected = track().positions[:, :2] + [100.0, 200.0]
    assert np.abs(table[:, 1:3] - expected).max() < 0.05  # 700 m away by a point that is 2 cm off, and the plane


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--crs", "EPSG:1"], "PROJ knows no such system"),
        (["--track", "cabin"], r"--track cabin: .* \(allowed: imu_in_world\)"),
        (["--interval", "0"], "--interval 0: must be > 0"),
        (["--interval", "1e300"], r"--interval 1e\+300: must be > 0 and <= 1e\+09"),
        (["-o", "track.shp"], r"unknown kind of file \(allowed: \.csv"),
        (["-o", "none/track.csv"], "its folder does not exist"),
        (["-o", "track.csv", "-o", "track.csv"], "-o track.csv: is given twice"),
        (["-o", "track.csv", "-o", "x/../track.csv"], "-o x/../track.csv: is given twice"),
        (["--crs", "EPSG:2056", "--site-grid", "site.csv"], "give one of them"),
        (["--site-grid", "site.csv", "--geoid", "geoid.gtx"], "the control points of a site grid give its heights"),
        (["-o", "track.las"], "LAS takes metres"),
    ],
)
def test_a_mistake_is_told_in_one_line(tmp_path: Path, arguments, words):
    with pytest.raises(HoldfastError, match=words) as caught:
        call(folder(tmp_path / "out"), *arguments)
    assert "\n" not in str(caught.value)


def test_a_track_in_a_folder_of_results_is_replaced_with_it(tmp_path: Path):
    """After `holdfast export OUT` replays refused OUT: it held what Holdfast had not written."""
    out = folder(tmp_path / "out")
    (out / MARK).write_text(json.dumps({"command": "replay", "files": [one.name for one in out.iterdir()]}))
    call(out)
    assert (out / "trajectory.csv").exists()
    with replaced(out, "replay"):
        pass
    assert [one.name for one in out.iterdir()] == [MARK]


def test_control_points_are_not_overwritten_by_the_track(tmp_path: Path):
    (tmp_path / "site.csv").write_text("name\n")
    with pytest.raises(HoldfastError, match=r"site\.csv, which is read: give another output"):
        call(folder(tmp_path / "out"), "--site-grid", tmp_path / "site.csv", "-o", tmp_path / "site.csv")
    assert (tmp_path / "site.csv").read_text() == "name\n"


def test_the_default_system_is_not_said_to_be_without_heights(tmp_path: Path):
    """EPSG:4979 has a third axis, which is what is written."""
    told = call(folder(tmp_path / "out"))
    assert "note: heights above the WGS84 ellipsoid are written (a compound system" in told
    assert "no heights" not in told


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no device is always full")
def test_a_full_disk_names_the_file_that_is_written(tmp_path: Path):
    """It named the folder that is read."""
    (tmp_path / "track.csv").symlink_to("/dev/full")
    with pytest.raises(HoldfastError, match=r"track\.csv: cannot be written \(No space left on device\)"):
        call(folder(tmp_path / "out"), "-o", tmp_path / "track.csv")


def test_a_world_that_is_nowhere_on_the_earth_is_refused(tmp_path: Path):
    with pytest.raises(HoldfastError, match="nowhere on the earth"):
        call(folder(tmp_path / "out", None))
