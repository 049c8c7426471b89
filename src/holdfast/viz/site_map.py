"""A map and the track of the machine as a file for Rerun."""

from pathlib import Path

import numpy as np

from holdfast.mapping.colours import Colouring
from holdfast.mapping.site_map import SiteMap
from holdfast.state import Trajectory
from holdfast.viz.show import close_sink, open_sink

POINTS = 2_000_000  # more than a viewer draws smoothly
TRACK_POINTS = 20_000


def write_rrd(site_map: SiteMap, colouring: Colouring, trajectory: Trajectory, voxel_m: float, file: Path) -> None:
    """Write the map, thinned to so many points as a viewer can draw, in W.

    Raises:
        ConfigError: the file cannot be written.
    """
    import rerun as rr

    sink = open_sink(str(file), "map")
    records = site_map.sample(POINTS)
    middle = np.floor((site_map.low + site_map.high) / 2.0)
    middle[2] = 0.0
    sink.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    # a viewer works in float32, so that points far from the datum are given about the middle of the map
    sink.log("map", rr.Transform3D(translation=middle), static=True)
    cloud = rr.Points3D(records["point"] - middle, colors=colouring.colours(records), radii=voxel_m / 2.0)
    sink.log("map/points", cloud, static=True)
    step = max(1, len(trajectory.stamps_ns) // TRACK_POINTS)
    track = rr.LineStrips3D([trajectory.positions[::step] - middle], colors=[(209, 73, 91)])
    sink.log("map/track", track, static=True)
    close_sink(sink, str(file))
