"""`holdfast export`: the track of a replay in the coordinates of surveyors."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.errors import ConfigError
from holdfast.extras import needing
from holdfast.output_folder import add_results, check_distinct, check_output_file

if TYPE_CHECKING:
    from holdfast.export.site_grid import SiteGrid
    from holdfast.export.target import Target
    from holdfast.geometry.earth import Geodetic
    from holdfast.state import Trajectory

_FILE = click.Path(path_type=Path, dir_okay=False)
WGS84 = "EPSG:4979"


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--crs", metavar="CRS", help="Such as EPSG:2056, or EPSG:2056+5728 with heights. [default: WGS84]")
@click.option("--site-grid", type=_FILE, help="Control points of a site grid (CSV or YAML), instead of --crs.")
@click.option("--geoid", type=_FILE, help="Grid of geoid heights (GTX, GeoTIFF) for heights above the sea.")
@click.option("--track", default="imu_in_world", show_default=True, help="Which of the folder's tracks in the world.")
@click.option("--interval", "interval_s", type=float, metavar="SECONDS", help="One pose in so many seconds.")
@click.option("-o", "--output", "files", multiple=True, type=_FILE, help=".csv, .geojson, .kml or .las; repeatable.")
def export(  # noqa: PLR0917 (click passes the options by name)
    folder: Path,
    crs: str | None,
    site_grid: Path | None,
    geoid: Path | None,
    track: str,
    interval_s: float | None,
    files: tuple[Path, ...],
) -> None:
    """Write the track of the replay in FOLDER for surveyors and maps.

    CSV and LAS hold the coordinates of --crs or --site-grid, GeoJSON and KML those of WGS84, as their standards ask
    for. Without -o, FOLDER/trajectory.csv is written.
    """
    with needing("an export", "export"):
        import pyproj  # noqa: F401
    from holdfast.export.formats import FORMATS
    from holdfast.export.target import survey
    from holdfast.geometry.earth import LocalFrame
    from holdfast.recording.source import LONGEST_S

    if interval_s is not None and not 0.0 < interval_s <= LONGEST_S:
        raise ConfigError(f"--interval {interval_s:g}: must be > 0 and <= {LONGEST_S:g}")
    files = files or (folder / "trajectory.csv",)
    reads = [folder / f"{track}.tum", *(file for file in (site_grid, geoid) if file is not None)]
    check_distinct(("-o", file) for file in files)
    for file in files:
        if file.suffix.lower() not in FORMATS:
            raise ConfigError(f"-o {file}: unknown kind of file (allowed: {', '.join(FORMATS)})")
        check_output_file(file, reads)
    if crs is not None and site_grid is not None:
        raise ConfigError("--crs and --site-grid: give one of them")
    if geoid is not None and site_grid is not None:
        raise ConfigError("--geoid and --site-grid: the control points of a site grid give its heights")
    datum = _datum(folder)
    target = _target(crs, site_grid, geoid, datum)
    surveyed = survey(_poses(folder, track, interval_s), LocalFrame(datum), target)
    for file in files:
        FORMATS[file.suffix.lower()](surveyed, file)
        add_results(file)
    for note in filter(None, [*target.notes, target.heights.note]):
        click.echo(f"note: {note}", err=True)
    for file in files:
        click.echo(f"written to {file}: {len(surveyed.stamps_ns)} poses")


def _datum(folder: Path) -> "Geodetic":
    from holdfast.replay.summary_file import datum_in, read_summary

    datum = datum_in(read_summary(folder))
    if datum is None:
        raise ConfigError(f"{folder}: its world is nowhere on the earth (needed: GNSS, or frames.datum)")
    return datum


def _poses(folder: Path, track: str, interval_s: float | None) -> "Trajectory":
    import numpy as np

    from holdfast.recording.tum import read_tum
    from holdfast.state import Trajectory

    tracks = sorted(file.stem for file in folder.glob("*_in_world.tum") if file.stat().st_size)
    if track not in tracks:
        raise ConfigError(f"--track {track}: {folder} has no such track (allowed: {', '.join(tracks)})")
    poses = read_tum(folder / f"{track}.tum")
    if interval_s is None:
        return poses
    steps = (poses.stamps_ns - poses.stamps_ns[0]) // max(1, round(interval_s * 1e9))
    kept = np.flatnonzero(np.diff(steps, prepend=-1))
    return Trajectory(poses.stamps_ns[kept], poses.positions[kept], poses.quaternions[kept])


def _target(crs: str | None, site_grid: Path | None, geoid: Path | None, datum: "Geodetic") -> "Target":
    if site_grid is None:
        from holdfast.export.crs import reference_system

        return reference_system(crs or WGS84, datum, geoid)
    from holdfast.export.site_grid import localise, read_control_points

    grid = localise(read_control_points(site_grid), str(site_grid))
    _print_fit(grid)
    return grid


def _print_fit(grid: "SiteGrid") -> None:
    """Print the residuals of the control points: whoever signs for the grid wants to see them."""
    click.echo(f"site grid   scale {grid.scale:.7f}, rotated by {grid.rotation_deg:.5f} deg against true north")
    click.echo(f"{'point':12s} {'east [mm]':>10s} {'north [mm]':>10s} {'height [mm]':>11s}   (given minus fitted)")
    for name, row in zip(grid.points.names, grid.residuals.tolist(), strict=True):
        cells = [f"{1e3 * value:10.1f}" if value == value else f"{'-':>10s}" for value in row]  # noqa: PLR0124 (NaN)
        click.echo(f"{name[:12]:12s} {' '.join(cells)}")
