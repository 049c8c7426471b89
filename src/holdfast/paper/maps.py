"""Maps of the paper's two tasks (Figs. 1 and 5): scans gathered with the poses of every system, judged by the site.

The scans of seed 0 are ray-cast in memory and moved by the poses that every system gave in the accuracy study, and by
the true ones. Finished tasks are kept: a map is a PLY file, a view from above and a row of maps.json.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import ConfigError, HoldfastError
from holdfast.evaluation.mapping import WHOLE, Closeness, MapOptions, MapScan, View, map_quality, write_map
from holdfast.evaluation.mesh import SurfaceIndex, read_mesh
from holdfast.messages import Array
from holdfast.paper.job import kept_poses, run_job
from holdfast.paper.results import write_columns
from holdfast.paper.study import TASKS, accuracy_job
from holdfast.paper.systems import SYSTEMS, configured
from holdfast.report.page import Figure
from holdfast.sim.configuration import configuration_data
from holdfast.sim.readings import generator
from holdfast.sim.scenario import load_scenario
from holdfast.sim.sensors.scanner import SimulatedScanner
from holdfast.sim.simulation import START_NS, Simulation, simulate
from holdfast.state import Trajectory
from holdfast.trial.pool import processes, run_all
from holdfast.trial.truth import true_states
from holdfast.whole_file import write_whole

FOLDER, SCORES, TRUE_POSES = "maps", "maps.json", "truth"
QUICK_DECIMATION = 5  # one in so many scans is used where it has to be quick
COLOUR_LIMIT_M = 0.2
SCALE = ((0.0, (24, 90, 70)), (0.25, (60, 160, 110)), (0.5, (240, 220, 110)), (1.0, (200, 60, 40)))
"""From the surface to `COLOUR_LIMIT_M` beside it: fraction of the limit -> red, green, blue."""


@dataclass(frozen=True, slots=True, eq=False)
class MapScore:
    """The verdict on the map of one system.

    Attributes:
        scenario: task of the paper, seed 0.
        system: whose poses; `truth` for the true ones.
        failure: why there is no map; empty if there is one.
        closeness: by region.
    """

    scenario: str
    system: str
    failure: str
    scans: int
    left_out: int
    closeness: Mapping[str, Closeness]
    view: View | None


Maps = tuple[MapScore, ...]


def make_maps(output: Path, quick: bool, jobs: int, progress: Callable[[int, int], None] | None = None) -> None:
    """Make the maps that are not there yet, each task in a process of its own.

    Raises:
        ConfigError: embreex, trimesh or scipy are not installed.
        OSError: a file cannot be written.
        HoldfastError: a process was killed.
    """
    tasks = [scenario for scenario in TASKS[: 1 if quick else 2] if not _folder(output, scenario, SCORES).exists()]
    if not tasks:
        return
    files = [_folder(output, scenario, f"{system}.ply") for scenario in tasks for system in (TRUE_POSES, *SYSTEMS)]

    def report(_: list[None]) -> None:
        if progress is not None:
            progress(sum(file.exists() for file in files), len(files))

    lost = f"{output}: a process that made maps was killed (out of memory?)"
    # the folder is of this process: the others may be ended
    with TemporaryDirectory(prefix="holdfast-maps-") as scratch, processes(min(jobs, len(tasks)), lost) as pool:
        run_all(pool, [partial(map_task, scenario, output, quick, Path(scratch)) for scenario in tasks], report)


def load_maps(output: Path) -> Maps | None:
    """Read what `make_maps` has made; None if there is nothing."""
    return tuple(score for scenario in TASKS for score in _load(_folder(output, scenario))) or None


def map_figures(maps: Maps) -> Iterator[Figure]:
    """Yield each map from above, coloured by its distance to the surface."""
    from holdfast.report.figures import picture_map

    colours = [[fraction, f"rgb{colour}"] for fraction, colour in SCALE]
    bar = {"title": {"text": "error [m]", "side": "right"}, "thickness": 12}
    marker = {"cmin": 0.0, "cmax": COLOUR_LIMIT_M, "colorscale": colours, "colorbar": bar}
    for score in maps:
        if score.view is not None:
            near = score.closeness[WHOLE]
            caption = f"{100.0 * near.fraction_within:.2f} % within 5 cm, median {1e3 * near.median_m:.1f} mm, from "
            caption += f"{score.scans} scans; {score.left_out} left out, for which there was no pose."
            plot = picture_map(coloured(score.view.errors), score.view.corner, score.view.pixel_m, marker, 400)
            key = f"map-{score.scenario}-{score.system}"
            yield Figure(key, f"Map, {score.scenario}, poses of {title(score)}", plot, caption)


def title(score: MapScore) -> str:
    """Return the name of the system in the report."""
    return "the truth" if score.system == TRUE_POSES else SYSTEMS[score.system].title


def coloured(errors: Array) -> NDArray[np.uint8]:
    """Return pixels (H, W, 4) of errors (H, W) [m]; what is NaN stays transparent."""
    known = np.isfinite(errors)
    fraction = np.clip(np.where(known, errors, 0.0) / COLOUR_LIMIT_M, 0.0, 1.0)
    at = [known_fraction for known_fraction, _ in SCALE]
    pixels = np.zeros((*errors.shape, 4), dtype=np.uint8)
    for channel in range(3):
        values = np.interp(fraction, at, [colour[channel] for _, colour in SCALE])
        pixels[..., channel] = np.where(known, np.rint(values), 0.0)
    pixels[..., 3] = np.where(known, 255, 0)
    return pixels


def cast_scans(simulation: Simulation, every: int, options: MapOptions) -> list[MapScan]:
    """Return every n-th scan of the scanner as it would be recorded, thinned.

    Raises:
        ConfigError: the machine has no scanner, or embreex is not installed.
    """
    from holdfast.sim.scans import Scanner

    name, sheet = _scanner(simulation)
    scanner = Scanner(sheet, simulation.site.mesh())
    times_s = simulation.delivered[name].readings.times_s
    scans = []
    for row in range(0, len(times_s), every):
        moving = simulation.motion.frame(sheet.frame, scanner.column_times_s(times_s[row]))
        scan = scanner.scan(row, moving.R_W_F, moving.p_W, generator(simulation.seed, "scan", str(row)))
        near = options.rows_of(scan.points)
        stamp_ns = START_NS + round(float(times_s[row]) * 1e9)
        scans.append(MapScan(stamp_ns, scan.points[near], scan.offset_ns[near].astype(np.int64)))
    return scans


def _scanner(simulation: Simulation) -> tuple[str, SimulatedScanner]:
    scanners = simulation.scenario.sensors_of(SimulatedScanner)
    if not scanners:
        raise ConfigError("sensors: none has `kind: scanner`, so there is nothing to make a map of")
    return next(iter(scanners.items()))


def map_task(scenario_name: str, output: Path, quick: bool, scratch: Path | None = None) -> None:
    """Make all maps of one task; whoever started this process removes the folder `scratch`."""
    job = accuracy_job(scenario_name, 0, quick)
    run_job(job, output, scratch)  # what is not done yet
    tasks = {task.system: task for task in job.tasks}
    scenario = load_scenario(job.scenario, dict(job.overrides))
    simulation, options = simulate(scenario, job.seed), MapOptions()
    scans = cast_scans(simulation, QUICK_DECIMATION if quick else 1, options)
    given = configuration_data(scenario, simulation.seed)
    _, scanner = _scanner(simulation)
    folder = _folder(output, scenario_name)
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    with TemporaryDirectory(prefix="holdfast-maps-", dir=scratch) as made:
        site = Path(made) / "site.ply"
        simulation.site.write_ply(site)
        surface = SurfaceIndex(read_mesh(site))
        for system in (TRUE_POSES, *SYSTEMS):
            config = configured("holdfast" if system == TRUE_POSES else system, given)
            T_I_L = config.T_I(scanner.frame)
            about: dict[str, Any] = {"scenario": scenario_name, "system": system, "failure": ""}
            try:
                poses = _true_poses(simulation) if system == TRUE_POSES else kept_poses(output, job, tasks[system])
                quality = map_quality(scans, poses, surface, T_I_L, options)
            except Exception as error:  # a system that fails, in whatever way, does not stop the others
                kind = "" if isinstance(error, HoldfastError) else f"{type(error).__name__}: "
                about["failure"] = f"{kind}{error}"
                rows.append(about | {"scans": 0, "left_out": len(scans), "closeness": {}})
                continue
            write_map(quality, folder / f"{system}.ply")
            view = quality.view
            columns = {
                "errors": view.errors.astype(np.float32),
                "corner": np.array(view.corner),
                "pixel_m": np.array(view.pixel_m),
            }
            write_columns(folder / f"{system}.npz", columns)
            closeness = {region: asdict(near) for region, near in quality.closeness.items()}
            rows.append(about | {"scans": quality.map.scans, "left_out": quality.map.left_out, "closeness": closeness})
    write_whole(folder / SCORES, json.dumps(rows, indent=1))


def _true_poses(simulation: Simulation) -> Trajectory:
    return true_states(simulation, START_NS + np.rint(simulation.imu_times_s() * 1e9).astype(np.int64))[0]


def _load(folder: Path) -> Iterator[MapScore]:
    try:
        rows: Sequence[dict[str, Any]] = json.loads((folder / SCORES).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return
    for row in rows:
        view = None
        if not row["failure"]:
            with np.load(folder / f"{row['system']}.npz") as archive:
                east, north = archive["corner"].tolist()
                view = View(archive["errors"].astype(np.float64), (east, north), float(archive["pixel_m"]))
        closeness = {region: Closeness(**near) for region, near in row.pop("closeness").items()}
        yield MapScore(**row, closeness=closeness, view=view)


def _folder(output: Path, *parts: str) -> Path:
    return output.joinpath(FOLDER, *parts)
