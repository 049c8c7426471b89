"""`holdfast map`: the scans of a recording as a map, by the trajectory of a replay."""

from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from holdfast.cli.finite import FiniteRange
from holdfast.cli.progress import progress_bar
from holdfast.cli.writing import write_json
from holdfast.errors import ConfigError, HoldfastError, RecordingError
from holdfast.extras import needing
from holdfast.mapping.options import SiteMapOptions
from holdfast.output_folder import add_results, check_distinct, check_output_file, naming_the_output
from holdfast.whole_file import whole

if TYPE_CHECKING:
    from holdfast.mapping.las import Grid
    from holdfast.mapping.site_map import MapBuilder, SiteMap
    from holdfast.mapping.source import Run, Scans
    from holdfast.replay.reference import Surface

_FILE = click.Path(path_type=Path, dir_okay=False)
LAS = (".las", ".laz")
SUFFIXES = (*LAS, ".ply", ".png", ".rrd")
DEFAULT_FILES = ("map.laz", "map.ply", "map.png", "map.rrd")
SUMMARY = "map.json"


@click.command("map")
@click.argument("folder", metavar="OUT", type=click.Path(path_type=Path))
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("-o", "--output", "files", multiple=True, type=_FILE, help=f"{', '.join(SUFFIXES)}; repeatable.")
@click.option("--topic", help="Of the clouds. [default: the only PointCloud2]")
@click.option("--frame", help="Of the lidar in the configuration. [default: the frame_id of the clouds]")
@click.option("--voxel", "voxel_m", type=float, default=0.1, show_default=True, help="A point is kept of each [m].")
@click.option("--min-range", "min_range_m", type=FiniteRange(0), default=1.0, show_default=True, help="[m]")
@click.option(
    "--max-range", "max_range_m", type=float, default=50.0, show_default=True, help="Farther is left out [m]."
)
@click.option(
    "--keep-above", type=float, default=0.2, show_default=True, help="Of the rays, to end there; 0 keeps all."
)
@click.option(
    "--colour",
    type=click.Choice(["height", "intensity", "sigma"]),
    default="height",
    show_default=True,
    help="By what points are coloured.",
)
@click.option("--crs", metavar="CRS", help="Of LAS and LAZ, such as EPSG:2056. [default: the zone of UTM]")
@click.option("--geoid", type=_FILE, help="Grid of geoid heights (GTX, GeoTIFF) for heights above the sea.")
@click.option("--site", type=_FILE, help="True surface to judge by. [default: site.ply beside RECORDING, if there]")
def map(  # noqa: A001, PLR0917 (click passes the options by name)
    folder: Path,
    recording: Path,
    files: tuple[Path, ...],
    topic: str | None,
    frame: str | None,
    voxel_m: float,
    min_range_m: float,
    max_range_m: float,
    keep_above: float,
    colour: str,
    crs: str | None,
    geoid: Path | None,
    site: Path | None,
) -> None:
    """Make a map of the scans of RECORDING by the trajectory in OUT.

    OUT is a folder that `holdfast replay` or `holdfast smooth` wrote. Every point is moved to where the lidar was when
    it was measured. What rays see through later is left out. Without -o, OUT/map.laz, map.ply, map.png and map.rrd are
    written; OUT/map.json has the numbers.
    """
    options = SiteMapOptions(voxel_m, max_range_m, keep_above=keep_above)
    files = files or tuple(folder / name for name in DEFAULT_FILES)
    site = _site(site, recording)
    check_files(files, [recording] if site is None else [recording, site])
    if not any(file.suffix.lower() in LAS for file in files):
        for option, given in (("--crs", crs), ("--geoid", geoid)):
            if given is not None:
                raise ConfigError(f"{option} {given}: is for LAS and LAZ, and none is written (allowed: -o FILE.laz)")
    from holdfast.mapping.las import Grid
    from holdfast.mapping.source import Scans, read_run
    from holdfast.recording.raw import RawBag
    from holdfast.replay.reference import read_surface

    run = read_run(folder)
    surface = None if site is None else read_surface(site, run.datum)  # before long work
    if run.covariances is None and colour == "sigma":
        raise ConfigError(f"--colour sigma: {folder} holds no covariances (allowed: height, intensity)")
    grid = Grid(run.datum, crs, geoid) if any(file.suffix.lower() in LAS for file in files) else None
    with naming_the_output(folder), TemporaryDirectory(prefix="holdfast-map-", dir=folder) as made:
        with RawBag(recording) as bag:
            scans = Scans(bag, topic, min_range_m)
            with progress_bar("mapping", bag.recording.start_ns, bag.recording.end_ns) as progress:
                builder, failure = gather(scans, run, frame, colour, options, Path(made), progress)
            for warning in scans.warnings():
                click.echo(f"warning: {warning}", err=True)
        if builder is None:
            raise failure or RecordingError(f"{recording}: holds no cloud on {scans.topic} that can be used")
        found = builder.finish()
        write_files(found, run, colour, grid, voxel_m, files)
        add_results(*files)
        numbers = _print_account(found, grid)
        if site is not None and surface is not None:
            numbers["site"] = {"file": str(site), "regions": _print_closeness(found, surface, site.name)}
    write_json(folder / SUMMARY, numbers | {"options": asdict(options), "files": [str(file) for file in files]})
    click.echo(f"written to {', '.join(str(file) for file in files)}, {folder / SUMMARY}")
    if failure is not None:
        raise failure


def check_files(files: Iterable[Path], reads: Iterable[Path]) -> None:
    """Refuse what cannot be written, or would overwrite what is read, before long work.

    Raises:
        ConfigError: names the file, or the package that is missing.
    """
    files = tuple(files)
    check_distinct(("-o", file) for file in files)
    for file in files:
        suffix = file.suffix.lower()
        if suffix not in SUFFIXES:
            raise ConfigError(f"-o {file}: unknown kind of file (allowed: {', '.join(SUFFIXES)})")
        check_output_file(file, reads)
        if suffix in LAS:
            with needing(f"{file.name}", "map"):
                import laspy  # noqa: F401
                import pyproj  # noqa: F401

                if suffix == ".laz":
                    import lazrs  # noqa: F401
        elif suffix == ".png":
            with needing(f"{file.name}", "plot"):
                import matplotlib  # noqa: F401
        elif suffix == ".rrd":
            with needing(f"{file.name}", "viz"):
                import rerun  # noqa: F401


def gather(  # noqa: PLR0917
    scans: "Scans",
    run: "Run",
    frame: str | None,
    colour: str,
    options: "SiteMapOptions",
    made: Path,
    progress: Callable[[int], None] | None,
) -> "tuple[MapBuilder | None, BaseException | None]":
    """Put scans into a map; what stops that before the end comes back beside it, so that nothing is lost."""
    from holdfast.mapping.site_map import MapBuilder

    builder: MapBuilder | None = None
    try:
        for sweep in scans.read(progress):
            if builder is None:
                if colour == "intensity" and sweep.intensities is None:
                    raise ConfigError(f"--colour intensity: {scans.topic} has no field for it (allowed: height, sigma)")
                T_I_L, offset_ns = run.mount(frame or sweep.frame_id, scans.topic)
                builder = MapBuilder(made, run.trajectory, T_I_L, options, run.covariances, offset_ns)
            builder.add(sweep)
    except (HoldfastError, KeyboardInterrupt) as error:
        return (builder if builder is not None and builder.scans else None), error
    return builder, None


def write_files(  # noqa: PLR0917
    found: "SiteMap", run: "Run", colour: str, grid: "Grid | None", voxel_m: float, files: Iterable[Path]
) -> None:
    """Write the map into each file, by its suffix; each whole or not at all."""
    from holdfast.mapping.colours import colouring
    from holdfast.mapping.las import write_las
    from holdfast.mapping.picture import draw_above
    from holdfast.mapping.ply import write_ply

    colours = colouring(found, colour)
    for file in files:
        suffix = file.suffix.lower()
        with whole(file) as part:
            if suffix in LAS and grid is not None:
                write_las(found, colours, grid, part)
            elif suffix == ".ply":
                write_ply(found, colours, part)
            elif suffix == ".png":
                draw_above(found, colours, run.trajectory, voxel_m, part)
            elif suffix == ".rrd":
                from holdfast.viz.site_map import write_rrd

                write_rrd(found, colours, run.trajectory, voxel_m, part)


def _site(given: Path | None, recording: Path) -> Path | None:
    """Return the mesh to judge by: the one that is given, or that of a simulation beside its recording."""
    if given is not None:
        if not given.is_file():
            raise ConfigError(f"--site {given}: no such file")
        return given
    beside = (recording if recording.is_dir() else recording.parent) / "site.ply"
    return beside if beside.is_file() else None


def _print_account(found: "SiteMap", grid: "Grid | None") -> dict[str, Any]:
    """Print what is in the map and what is not; return the numbers."""
    if found.left_out:
        click.echo(f"warning: {found.left_out} scans left out, for which there is no pose", err=True)
    if found.undeskewed:
        click.echo(f"warning: {found.undeskewed} scans have no times of points and are not deskewed", err=True)
    for note in [] if grid is None or grid.system is None else [*grid.system.notes, grid.system.heights.note]:
        if note:
            click.echo(f"note: {note}", err=True)
    click.echo(f"{found.points} points of {found.scans} scans; {found.thinned} thinned, through which rays passed")
    return {
        "points": found.points,
        "thinned": found.thinned,
        "scans": found.scans,
        "left_out": found.left_out,
        "undeskewed": found.undeskewed,
        "low_m": found.low.tolist(),
        "high_m": found.high.tolist(),
        "crs": None if grid is None or grid.system is None else grid.system.name,
    }


def _print_closeness(found: "SiteMap", surface: "Surface", name_of_site: str) -> dict[str, Any]:
    """Print how near the map is to the true surface; return the numbers by region."""
    with needing("comparing with a site", "sim"):
        from holdfast.mapping.verdict import closeness
    if surface.note:
        click.echo(f"note: {surface.note}", err=True)
    regions = closeness(found, surface.mesh)
    for name, near in regions.items():
        click.echo(
            f"{name:>10s}: {100.0 * near.fraction_within:6.2f} % within 5 cm of {name_of_site}, median "
            f"{1e3 * near.median_m:.1f} mm, 95 % {1e3 * near.p95_m:.1f} mm"
        )
    return {name: asdict(near) for name, near in regions.items()}
