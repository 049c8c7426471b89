"""Columns of one sensor's measurements, and the random numbers that make them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What one sensor measured, before its messages travel.

    Attributes:
        times_s: (N,) true time of each measurement since the start of the scenario, increasing.
        values: columns by name, each (N, ...).
    """

    times_s: Array
    values: Mapping[str, NDArray[Any]]

    def taken(self, index: NDArray[Any]) -> Self:
        """Return the rows that a mask or an array of indices selects."""
        return type(self)(self.times_s[index], {name: column[index] for name, column in self.values.items()})

    def replaced(self, **columns: NDArray[Any]) -> Self:
        """Return the same rows with some columns replaced or added."""
        return type(self)(self.times_s, {**self.values, **columns})


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return the random numbers of one purpose: another purpose, or another sensor, never changes them."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *(crc32(n.encode()) for n in names)])))


def slow_noise(rng: np.random.Generator, steps: Array) -> Array:
    """Return a first-order Gauss-Markov process (N,) of unit variance, stationary from the start.

    `steps` (N,) are the ways between rows in units of the correlation length (time or distance); the first is unused:
    x_k = exp(-s_k) x_{k-1} + sqrt(1 - exp(-2 s_k)) n_k.
    """
    keep = np.exp(-steps).tolist()
    fresh = (np.sqrt(-np.expm1(-2.0 * steps)) * rng.standard_normal(len(steps))).tolist()
    values = [float(rng.standard_normal())]
    for k in range(1, len(steps)):
        values.append(keep[k] * values[-1] + fresh[k])
    return np.array(values)
