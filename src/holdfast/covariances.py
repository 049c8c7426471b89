"""Covariances of states along a track, known at some times and linear between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array

SIZE = 9
UPPER = np.triu_indices(SIZE)


@dataclass(frozen=True, slots=True, eq=False)
class Covariances:
    """Covariances (K, 9, 9) at the times (K,), in the order of `holdfast.state`."""

    times_ns: NDArray[np.int64]
    values: Array

    def at(self, times_ns: NDArray[np.int64]) -> Array:
        """Return the covariances (N, 9, 9) at times (N,): those of both neighbours, weighed by distance.

        A weighed mean of covariances is one, too. Beyond the ends those of the ends hold.
        """
        known = self.times_ns
        if len(known) == 1:
            return np.repeat(self.values, len(times_ns), axis=0)
        after = np.clip(np.searchsorted(known, times_ns, side="right"), 1, len(known) - 1)
        length = known[after] - known[after - 1]
        fraction = np.clip((times_ns - known[after - 1]) / length, 0.0, 1.0)[:, None, None]
        values: Array = (1.0 - fraction) * self.values[after - 1] + fraction * self.values[after]
        return values

    def triangles(self) -> Array:
        """Return the upper triangles (K, 45), row by row."""
        triangles: Array = self.values[:, UPPER[0], UPPER[1]]
        return triangles

    @classmethod
    def of_triangles(cls, times_ns: NDArray[np.int64], triangles: Array) -> "Covariances":
        """Return the covariances whose upper triangles (K, 45) are given."""
        values = np.zeros((len(times_ns), SIZE, SIZE))
        values[:, UPPER[0], UPPER[1]] = values[:, UPPER[1], UPPER[0]] = triangles
        return cls(times_ns, values)


def correlation_eigenvalues(covariances: Array) -> Array:
    """Return the smallest eigenvalue (N,) of each correlation matrix; at most 0 is a covariance that is none.

    A covariance (N, d, d) has as many units as rows: its own eigenvalues have no unit, and of sigmas of 1e6 m beside
    1e-3 rad the smallest is lost in the rounding of the largest. NaN where a variance is not positive.
    """
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    sigmas = np.sqrt(np.where(variances > 0.0, variances, np.nan))
    known = np.isfinite(sigmas).all(axis=1)
    smallest = np.full(len(covariances), np.nan)
    smallest[known] = np.linalg.eigvalsh(covariances[known] / sigmas[known, :, None] / sigmas[known, None, :])[:, 0]
    return smallest
