"""How far a lidar sees in each direction: an image in azimuth and elevation, two of the usual rays in each pixel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]
BINS, ROWS = 360, 90  # in azimuth, and in elevation from the nadir up
SECTORS = 36  # a lidar that turns sees something in each of them


class Rays:
    """Where a lidar has rays, by what it has seen so far.

    One that turns has all its rays in every direction, and where none came back there is the sky. One that looks
    forward, or follows a rosette, may not have looked there.
    """

    def __init__(self) -> None:
        self._rows = np.zeros(ROWS, dtype=np.bool_)
        self._sectors = np.zeros(SECTORS, dtype=np.bool_)

    def add(self, at: Pixels) -> None:
        """Take in the pixels of points."""
        self._rows[at[0]] = True
        self._sectors[at[1] * SECTORS // BINS] = True

    @property
    def go_around(self) -> bool:
        """Whether something was seen in all directions around the lidar: it turns."""
        return bool(self._sectors.all())

    def unknown(self, at: Pixels) -> NDArray[np.bool_]:
        """Return (ROWS, BINS) where the lidar may not have looked, given the pixels of a sweep's points.

        Nowhere, if it turns.
        """
        unknown = np.full((ROWS, BINS), not self.go_around)
        unknown[at] = False
        return unknown

    def between(self, image: NDArray[Any], extreme: np.ufunc, beyond: float) -> NDArray[Any]:
        """Return an image (ROWS, BINS) in which rows without rays have the extreme of the rings above and below.

        Args:
            image: what the rays found.
            extreme: np.minimum or np.maximum.
            beyond: the value below the lowest ring and above the highest.
        """
        rings, rows = np.flatnonzero(self._rows), np.arange(ROWS)
        below = rings[np.maximum(np.searchsorted(rings, rows, side="right") - 1, 0)]
        above = rings[np.minimum(np.searchsorted(rings, rows), len(rings) - 1)]
        filled = extreme(image[below], image[above])
        filled[: rings[0]] = filled[rings[-1] + 1 :] = beyond
        return np.asarray(filled)


def lengths(points: NDArray[Any]) -> NDArray[Any]:
    """Return the lengths (N,) of vectors (N, 3)."""
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", points, points)))


def pixels(points: NDArray[Any], rows: int = ROWS, columns: int = BINS) -> Pixels:
    """Return row (N,) and column (N,) of the directions of points (N, 3) in L, in an image of so many."""
    azimuth = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) + 0.5
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])) / np.pi + 0.5
    row, column = (elevation * rows).astype(np.intp), (azimuth * columns).astype(np.intp)
    return np.minimum(row, rows - 1), np.minimum(column, columns - 1)


def with_neighbours(image: NDArray[Any], extreme: np.ufunc) -> NDArray[Any]:
    """Return of each pixel of an image (ROWS, BINS) the extreme of it and its eight neighbours."""
    around = extreme(extreme(np.roll(image, 1, 1), np.roll(image, -1, 1)), image)
    found = around.copy()
    found[1:] = extreme(found[1:], around[:-1])
    found[:-1] = extreme(found[:-1], around[1:])
    return np.asarray(found)
