"""How far a lidar sees in each direction: an image in azimuth and elevation, two of the usual rays in each pixel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BINS, ROWS = 360, 90  # in azimuth, and in elevation from the nadir up


class Rays:
    """At which elevations a lidar has rays, by what it has seen so far."""

    def __init__(self) -> None:
        self._seen = np.zeros(ROWS, dtype=np.bool_)

    def add(self, rows: NDArray[np.intp]) -> None:
        """Take in the rows (N,) of points."""
        self._seen[rows] = True

    def between(self, image: NDArray[Any], extreme: np.ufunc, beyond: float) -> NDArray[Any]:
        """Return an image (ROWS, BINS) in which rows without rays have the extreme of the rings above and below.

        Args:
            image: what the rays found.
            extreme: np.minimum or np.maximum.
            beyond: the value below the lowest ring and above the highest.
        """
        rings, rows = np.flatnonzero(self._seen), np.arange(ROWS)
        below = rings[np.maximum(np.searchsorted(rings, rows, side="right") - 1, 0)]
        above = rings[np.minimum(np.searchsorted(rings, rows), len(rings) - 1)]
        filled = extreme(image[below], image[above])
        filled[: rings[0]] = filled[rings[-1] + 1 :] = beyond
        return np.asarray(filled)


def lengths(points: NDArray[Any]) -> NDArray[Any]:
    """Return the lengths (N,) of vectors (N, 3)."""
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", points, points)))


def pixels(points: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row (N,) and column (N,) of the directions of points (N, 3) in L."""
    azimuth = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) + 0.5
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])) / np.pi + 0.5
    rows, columns = (elevation * ROWS).astype(np.intp), (azimuth * BINS).astype(np.intp)
    return np.minimum(rows, ROWS - 1), np.minimum(columns, BINS - 1)


def with_neighbours(image: NDArray[Any], extreme: np.ufunc) -> NDArray[Any]:
    """Return of each pixel of an image (ROWS, BINS) the extreme of it and its eight neighbours."""
    around = extreme(extreme(np.roll(image, 1, 1), np.roll(image, -1, 1)), image)
    found = around.copy()
    found[1:] = extreme(found[1:], around[:-1])
    found[:-1] = extreme(found[:-1], around[1:])
    return np.asarray(found)
