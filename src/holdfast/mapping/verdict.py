"""How near a map is to the true surface, where that is known: `holdfast.evaluation.mapping` on what was written."""

import numpy as np

from holdfast.evaluation.mapping import Closeness, MapOptions, VoxelMap, judge_map
from holdfast.evaluation.mesh import Mesh, SurfaceIndex
from holdfast.mapping.site_map import SiteMap

POINTS = 1_000_000  # that are judged: bounds the memory


def closeness(site_map: SiteMap, mesh: Mesh) -> dict[str, Closeness]:
    """Return how near the points are to a surface in W, each patch of it weighted by its area, of all and by region.

    Raises:
        ConfigError: scipy is not installed.
    """
    records = site_map.sample(POINTS)
    counts = records["points"].astype(np.int64)
    voxels = VoxelMap(np.array(records["point"]), counts, site_map.scans, site_map.left_out)
    return dict(judge_map(voxels, SurfaceIndex(mesh), MapOptions()).closeness)
