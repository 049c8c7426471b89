"""Height of the ground at any point: random hills and roughness, and what people heaped and dug."""

from math import hypot, pi, radians, tan

import numpy as np

from holdfast.messages import Array
from holdfast.sim.readings import generator
from holdfast.sim.scenario import Ground, Heap, Objects, Trench

MODES = 48  # waves per length; their sum is close to Gaussian
WALL_M = 0.4  # distance over which a trench's wall falls
END_SLOPE = 2.0  # distance along the trench in which its end reaches the bottom, in depths
CHUNK = 8192


class Terrain:
    """Height of the ground in W as a function that is twice continuously differentiable everywhere.

    Natural ground is a plane plus two sums of random waves (hills, and what the wheels feel), whose standard deviations
    are those of `Ground`; it passes through the origin of W. Heaps, pits and trenches are added to it.
    """

    def __init__(self, ground: Ground, objects: Objects) -> None:
        hills = _waves(ground.seed, "undulation", ground.undulation_m, ground.undulation_length_m)
        bumps = _waves(ground.seed, "roughness", ground.roughness_m, ground.roughness_length_m)
        self._waves = np.concatenate([hills, bumps])
        self._slope = tuple(tan(radians(angle)) for angle in ground.slope_deg)
        self._objects = objects
        self._offset = 0.0
        self._offset = float(self.natural_height(np.zeros(1), np.zeros(1))[0])

    def height(self, x: Array, y: Array) -> Array:
        """Return the height [m] of the ground in W at east `x` and north `y` [m], all of one shape."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        z = self.natural_height(x, y)
        for heap in self._objects.heaps:
            z += _heap(heap, x, y)
        for trench in self._objects.trenches:
            z -= _trench(trench, x, y)
        return z

    def natural_height(self, x: Array, y: Array) -> Array:
        """Return the height [m] without heaps, pits and trenches; arguments as for `height`."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        east, north, phase, amplitude = self._waves.T
        flat_x, flat_y = x.ravel(), y.ravel()
        z = self._slope[0] * flat_x + self._slope[1] * flat_y - self._offset
        for begin in range(0, len(z), CHUNK):
            part = slice(begin, begin + CHUNK)
            angles = np.multiply.outer(flat_x[part], east)
            angles += np.multiply.outer(flat_y[part], north)
            angles += phase
            z[part] += np.cos(angles, out=angles) @ amplitude
        return z.reshape(x.shape)


def _waves(seed: int, name: str, sigma_m: float, length_m: float) -> Array:
    """Return (MODES, 4) waves: wave number east and north [rad/m], phase [rad], amplitude [m].

    Wavelengths lie within a factor of two of `length_m`; the longer a wave, the higher, as on natural ground. The mean
    square of the sum is that of sigma.
    """
    rng = generator(seed, name)
    # stratified, so that no seed lacks a direction or a length
    direction = (np.arange(MODES) + rng.random(MODES)) * pi / MODES
    wavelength = length_m * 2.0 ** (2.0 * (rng.permutation(MODES) + rng.random(MODES)) / MODES - 1.0)
    phase = 2.0 * pi * rng.random(MODES)
    amplitude = sigma_m * wavelength / np.sqrt(np.sum(wavelength**2) / 2.0)
    number = 2.0 * pi / wavelength
    return np.column_stack([number * np.cos(direction), number * np.sin(direction), phase, amplitude])


def _heap(heap: Heap, x: Array, y: Array) -> Array:
    """Return its height above the ground, h (1 - r^2/R^2)^3, whose slope and curvature vanish at the foot."""
    squared = ((x - heap.center_m[0]) ** 2 + (y - heap.center_m[1]) ** 2) / heap.radius_m**2
    bell: Array = heap.height_m * np.maximum(1.0 - squared, 0.0) ** 3
    return bell


def _trench(trench: Trench, x: Array, y: Array) -> Array:
    """Return its depth below the ground: falling within WALL_M around each wall and from both ends inwards."""
    along, across, length = trench_coordinates(trench, x, y)
    half, ramp = trench.width_m / 2.0, END_SLOPE * trench.depth_m
    wall = _step((half + across) / WALL_M + 0.5) * _step((half - across) / WALL_M + 0.5)
    end = _step(along / ramp) * _step((length - along) / ramp)
    depth: Array = trench.depth_m * wall * end
    return depth


def trench_coordinates(trench: Trench, x: Array, y: Array) -> tuple[Array, Array, float]:
    """Return the distances [m] of points along a trench from its start and leftwards across it, and its length."""
    east, north = x - trench.start_m[0], y - trench.start_m[1]
    span = (trench.end_m[0] - trench.start_m[0], trench.end_m[1] - trench.start_m[1])
    length = hypot(*span)
    axis = (span[0] / length, span[1] / length) if length > 0.0 else (1.0, 0.0)
    return axis[0] * east + axis[1] * north, axis[0] * north - axis[1] * east, length


def _step(u: Array) -> Array:
    """Return the quintic that rises from 0 at u = 0 to 1 at u = 1, with slope and curvature 0 at both."""
    u = np.clip(u, 0.0, 1.0)
    rise: Array = u**3 * (10.0 + u * (6.0 * u - 15.0))
    return rise
