"""The site from above, with the path of the machine and where GNSS failed it."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from holdfast.extras import needing
from holdfast.messages import Array
from holdfast.sim.scenario import BASE
from holdfast.sim.sensors.gnss import Quality, SimulatedGnss
from holdfast.sim.simulation import Simulation

GROUND, STONE, LEAF, TRACK = "gist_earth", "#5b6470", "#3a7d44", "#1f4e8c"
WORSE = {
    Quality.RTK_FLOAT: ("#e9a23b", "float"),
    Quality.SINGLE: ("#d1495b", "single"),
    Quality.NONE: ("#7b2d8b", "none"),
}
CELLS = 240
STEP_S = 0.2


def draw_plan(simulation: Simulation, path: Path) -> None:
    """Draw the figure into a PNG, SVG or PDF file.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    with needing("the plan", "plot"):
        from matplotlib.colors import LightSource
        from matplotlib.figure import Figure
        from matplotlib.patches import Circle, Polygon
    times_s = np.arange(0.0, simulation.scenario.duration_s, STEP_S)
    path_W = simulation.motion.frame(BASE, times_s).p_W
    half = min(simulation.scenario.ground.size_m / 2.0, float(np.abs(path_W[:, :2]).max()) + 25.0)
    side = np.linspace(-half, half, CELLS)
    height = simulation.site.terrain.height(*np.meshgrid(side, side))
    figure = Figure(figsize=(7.2, 7.2), layout="constrained")
    axes = figure.subplots()
    shaded = LightSource(azdeg=315, altdeg=50).hillshade(
        height, vert_exag=3.0, dx=side[1] - side[0], dy=side[1] - side[0]
    )
    axes.imshow(shaded, extent=(-half, half, -half, half), origin="lower", cmap="Greys_r", vmin=-0.6, vmax=1.3)
    for box in simulation.scenario.objects.boxes:
        axes.add_patch(Polygon(_corners(box.center_m, box.size_m[:2], box.yaw_deg), color=STONE, lw=0))
    for tree in simulation.scenario.objects.trees:
        axes.add_patch(Circle(tree.center_m, tree.crown_radius_m, color=LEAF, alpha=0.75, lw=0))
    axes.plot(path_W[:, 0], path_W[:, 1], color=TRACK, lw=1.4, label="path of the chassis")
    axes.plot(*path_W[0, :2], "o", color=TRACK, ms=6, label="start")
    for quality, (colour, name) in WORSE.items():
        spoilt = path_W[_at(simulation, quality, times_s)]
        if len(spoilt):
            axes.plot(spoilt[:, 0], spoilt[:, 1], ".", color=colour, ms=4, label=f"GNSS {name}")
    axes.set_xlim(-half, half)
    axes.set_ylim(-half, half)
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.legend(loc="upper left", fontsize=8, framealpha=0.9)
    figure.savefig(path, dpi=110, metadata={"Software": None} if path.suffix == ".png" else None)


def _at(simulation: Simulation, quality: Quality, times_s: Array) -> NDArray[np.bool_]:
    """Return at which times (N,) the first antenna's newest fix has a quality; after a second without one, none."""
    antennas = simulation.scenario.sensors_of(SimulatedGnss)
    if not antennas:
        return np.zeros(len(times_s), dtype=bool)
    fixes = simulation.delivered[next(iter(antennas))]
    if len(fixes.readings.times_s) == 0:
        return np.full(len(times_s), quality == Quality.NONE)
    at = fixes.readings.times_s
    newest = np.maximum(np.searchsorted(at, times_s, side="right") - 1, 0)
    silent = abs(times_s - at[newest]) > 1.0
    return np.asarray(np.where(silent, Quality.NONE, fixes.readings.values["quality"][newest]) == quality)


def _corners(center: tuple[float, float], size: tuple[float, float], yaw_deg: float) -> Array:
    yaw = np.radians(yaw_deg)
    along, across = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    return np.array(
        [
            np.array(center) + u * along * size[0] / 2 + v * across * size[1] / 2
            for u, v in ((1, 1), (1, -1), (-1, -1), (-1, 1))
        ]
    )
