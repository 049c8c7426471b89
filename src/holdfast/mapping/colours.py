"""Colours of points by height, intensity or sigma: viridis (Smith and van der Walt, 2015) between two percentiles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import ConfigError
from holdfast.mapping.site_map import SiteMap
from holdfast.mapping.sorted_runs import Records
from holdfast.messages import Array

VIRIDIS = np.array(
    [
        *((68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140)),
        *((40, 174, 128), (94, 201, 98), (173, 220, 48), (253, 231, 37)),
    ]
)
PERCENTILES = (1.0, 95.0)  # trees and cranes are few and high: most colours are for the ground
SAMPLE = 200_000
LABELS = {"height": "height in W [m]", "intensity": "intensity", "sigma": "sigma of the point by the pose [m]"}


@dataclass(frozen=True, slots=True)
class Colouring:
    """By what points are coloured.

    Attributes:
        by: `height`, `intensity` or `sigma`.
        low, high: the values of the first and the last colour.
    """

    by: str
    low: float
    high: float

    def values(self, records: Records) -> Array:
        """Return the values (N,) of records."""
        if self.by == "height":
            heights: Array = records["point"][:, 2]
            return heights
        return np.asarray(records["intensity" if self.by == "intensity" else "sigma_m"], dtype=np.float64)

    def colours(self, records: Records) -> NDArray[np.uint8]:
        """Return red, green, blue (N, 3) of records."""
        return coloured(self.values(records), self.low, self.high)


def coloured(values: Array, low: float, high: float) -> NDArray[np.uint8]:
    """Return red, green, blue (N, 3) of values (N,)."""
    at = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0) * (len(VIRIDIS) - 1)
    channels = [np.interp(at, np.arange(len(VIRIDIS)), channel) for channel in VIRIDIS.T]
    colours: NDArray[np.uint8] = np.rint(np.column_stack(channels)).astype(np.uint8)
    return colours


def colouring(site_map: SiteMap, by: str) -> Colouring:
    """Return the colouring of a map.

    Raises:
        ConfigError: the map does not know the values.
    """
    if by == "intensity" and not site_map.has_intensity:
        raise ConfigError("--colour intensity: the scans have no field for it (allowed: height, sigma)")
    if by == "sigma" and not site_map.has_sigma:
        raise ConfigError("--colour sigma: no covariances lie beside the trajectory (allowed: height, intensity)")
    values = Colouring(by, 0.0, 1.0).values(site_map.sample(SAMPLE))
    low, high = np.percentile(values, PERCENTILES).tolist()
    return Colouring(by, low, high)
