"""How far a lidar sees in each direction: an image in azimuth and elevation, two of the usual rays in each pixel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

BINS, ROWS = 360, 90  # in azimuth, and in elevation from the nadir up


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
