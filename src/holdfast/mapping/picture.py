"""The map from above, as a picture: the highest point of each pixel, and the track of the machine."""

from pathlib import Path

import numpy as np

from holdfast.mapping.colours import LABELS, VIRIDIS, Colouring
from holdfast.mapping.site_map import SiteMap
from holdfast.messages import Array
from holdfast.state import Trajectory

MAX_PIXELS = 1200  # per side
TRACK_POINTS = 5000


def draw_above(site_map: SiteMap, colouring: Colouring, trajectory: Trajectory, voxel_m: float, file: Path) -> None:
    """Draw the map into a PNG.

    Raises:
        ImportError: matplotlib is not installed.
        OSError: the file cannot be written.
    """
    from matplotlib.colors import LightSource, LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure

    pixel_m = max(float((site_map.high - site_map.low)[:2].max()) / MAX_PIXELS, 1.5 * voxel_m)
    heights, values = raster(site_map, colouring, pixel_m)
    seen = np.isfinite(heights)
    map_of = LinearSegmentedColormap.from_list("viridis", VIRIDIS / 255.0)
    scale = Normalize(colouring.low, colouring.high)
    pixels = map_of(scale(np.where(seen, values, colouring.low)))
    filled = np.where(seen, heights, np.median(heights[seen]))
    shade = LightSource(azdeg=315, altdeg=45).hillshade(filled[::-1], dx=pixel_m, dy=pixel_m)[::-1]
    pixels[..., :3] *= (0.55 + 0.45 * shade)[..., None]
    pixels[..., 3] = seen
    figure = Figure(figsize=(9.0, 7.6), layout="constrained")
    axes = figure.subplots()
    east, north = site_map.low[:2]
    extent = (east, east + pixels.shape[1] * pixel_m, north, north + pixels.shape[0] * pixel_m)
    axes.imshow(pixels, extent=extent, origin="lower", interpolation="nearest")
    step = max(1, len(trajectory.stamps_ns) // TRACK_POINTS)
    axes.plot(*trajectory.positions[::step, :2].T, color="#d1495b", lw=1.0, label="track of the IMU")
    axes.set_xlim(extent[:2])
    axes.set_ylim(extent[2:])
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.legend(loc="upper left", fontsize=8, framealpha=0.9)
    axes.set_title(f"{site_map.points} points of {site_map.scans} scans, from above", fontsize=10)
    from matplotlib.cm import ScalarMappable

    figure.colorbar(ScalarMappable(scale, map_of), ax=axes, label=LABELS[colouring.by], shrink=0.8)
    figure.savefig(file, dpi=130, format="png", metadata={"Software": None})


def raster(site_map: SiteMap, colouring: Colouring, pixel_m: float) -> tuple[Array, Array]:
    """Return the heights (H, W) [m] and values (H, W) of the highest points, the southern row first; NaN without."""
    width, height = (np.floor((site_map.high - site_map.low)[:2] / pixel_m).astype(np.int64) + 1).tolist()
    heights, values = np.full(width * height, -np.inf), np.full(width * height, np.nan)
    for block in site_map.blocks():
        column, row = np.floor((block["point"][:, :2] - site_map.low[:2]) / pixel_m).astype(np.int64).T
        up = block["point"][:, 2]
        order = np.argsort(up, kind="stable")  # of equal pixels the last assignment stays
        pixel, up, value = (row * width + column)[order], up[order], colouring.values(block)[order]
        higher = up > heights[pixel]
        heights[pixel[higher]], values[pixel[higher]] = up[higher], value[higher]
    heights[np.isinf(heights)] = np.nan
    return heights.reshape(height, width), values.reshape(height, width)
