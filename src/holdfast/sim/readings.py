"""Columns of one sensor's measurements, and the random numbers that make them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array

Generators = Callable[..., np.random.Generator]
"""Random numbers by the names of their purpose: `partial(generator, seed)`."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What one sensor measured, before its messages travel.

    Attributes:
        times_s: (N,) true time of each measurement since the start of the scenario, increasing.
        values: columns by name, each (N, ...).
        constants: true and unknown constants of the sensor, such as its scale, by name.
    """

    times_s: Array
    values: Mapping[str, NDArray[Any]]
    constants: Mapping[str, float] = field(default_factory=dict)

    def taken(self, index: NDArray[Any]) -> Self:
        """Return the rows that a mask or an array of indices selects."""
        columns = {name: column[index] for name, column in self.values.items()}
        return type(self)(self.times_s[index], columns, self.constants)

    def replaced(self, **columns: NDArray[Any]) -> Self:
        """Return the same rows with some columns replaced or added."""
        return type(self)(self.times_s, {**self.values, **columns}, self.constants)


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return the random numbers of one purpose: another purpose, or another sensor, never changes them."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *(crc32(n.encode()) for n in names)])))


def slow_vectors(rng: np.random.Generator, steps: Array) -> Array:
    """Return three such processes (N, 3) as `slow_noise` returns one."""
    return np.stack([slow_noise(rng, steps) for _ in range(3)], axis=1)


def elapsed(times_s: Array, time_constant_s: float) -> Array:
    """Return the steps (N,) between times in units of a time constant."""
    return np.diff(times_s, prepend=times_s[:1]) / time_constant_s


def slow_noise(rng: np.random.Generator, steps: Array) -> Array:
    """Return a first-order Gauss-Markov process (N,) of unit variance, stationary from the start.

    `steps` (N,) are the steps between rows in units of the correlation length (time or distance); the first is unused:
    x_k = exp(-s_k) x_{k-1} + sqrt(1 - exp(-2 s_k)) n_k.
    """
    keep = np.exp(-steps).tolist()
    fresh = (np.sqrt(-np.expm1(-2.0 * steps)) * rng.standard_normal(len(steps))).tolist()
    values = [float(rng.standard_normal())]
    for k in range(1, len(steps)):
        values.append(keep[k] * values[-1] + fresh[k])
    return np.array(values)


def quantised(values: Array, resolution: float) -> Array:
    """Return values rounded to multiples of the resolution; 0 is an infinitely fine one."""
    return np.round(values / resolution) * resolution if resolution > 0.0 else values
