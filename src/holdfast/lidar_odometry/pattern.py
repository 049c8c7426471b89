"""Whether the rays of a lidar go the same ways in every sweep.

Those of a lidar that turns do, and so does the pattern of its points on smooth ground or along a smooth wall: it moves
with the lidar, and a registration of planes that are a little thick follows it. Those of a lidar with turning prisms
never go the same way again, and what its pattern pulls by is chance.
"""

import numpy as np
from numpy.typing import NDArray

from holdfast.lidar_odometry.range_image import pixels
from holdfast.messages import Array

# pixels in elevation and azimuth: rings keep their elevation to a fraction of a degree, whatever a turning lidar's
# azimuths are, and wherever in its housing its rays begin
ROWS, COLUMNS = 1800, 180
SHIFTS = range(2, 11)  # rows by which rays are moved where it matters whether they go the same way
SWEEPS = 10  # after which it is known
FULL = 0.9  # of the pixels near rays: where so many are hit there is nothing to tell
SAME = 0.5  # of what could be told


class Pattern:
    """What the first sweeps say; until two have been seen the rays are taken to go the same ways."""

    def __init__(self) -> None:
        self._before: NDArray[np.bool_] | None = None
        self._told: list[float] = []

    @property
    def repeats(self) -> bool:
        """Whether the rays go the same ways again."""
        return not self._told or float(np.median(self._told)) > SAME

    def add(self, points: Array) -> None:
        """Take in the points (N, 3) of a sweep, each in the axes of L at its own time; only the first sweeps tell."""
        if len(self._told) >= SWEEPS or not len(points):
            return
        before, self._before = self._before, _hit(points)
        if before is None:
            return
        met = [float(before[np.roll(self._before, rows, axis=0)].mean()) for rows in (0, *SHIFTS)]
        by_chance = float(np.mean(met[1:]))
        self._told.append(1.0 if by_chance > FULL else (met[0] - by_chance) / (1.0 - by_chance))


def _hit(points: Array) -> NDArray[np.bool_]:
    """Return the pixels (ROWS, COLUMNS) in which there are points (N, 3)."""
    hit = np.zeros((ROWS, COLUMNS), dtype=np.bool_)
    hit[pixels(points, ROWS, COLUMNS)] = True
    return hit
