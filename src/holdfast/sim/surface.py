"""The surface of a site as triangles: ground, blocks and trees, each triangle with the region it belongs to."""

from dataclasses import dataclass
from math import ceil, pi
from typing import Self

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import ConfigError
from holdfast.messages import Array
from holdfast.sim.scenario import Ground, Objects, Trench
from holdfast.sim.solids import Block, Plant
from holdfast.sim.terrain import WALL_M, Terrain, trench_coordinates

REGIONS = ("ground", "heap", "trench", "box", "tree")
"""Names of the regions; a triangle's region is an index into them. Pits are heaps."""

TRENCH_CELL_M = 0.1  # side of the ground's cells in the rows and columns that a trench crosses
MAX_GROUND_TRIANGLES = 1_200_000
TRUNK_SIDES = 12
LEAF_SIDE_M = 0.2
LEAVES_PER_M2 = 12.0  # of the crown's surface: somewhat more than half of the rays into a crown end there
MAX_LEAVES = 3000  # a larger crown has larger leaves instead
INNER_LEAF = 0.6  # leaves fill the crown from here, relative to its surface

Indices = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Triangles in W.

    Attributes:
        vertices: (V, 3) [m], all of them float32 numbers, so that files and ray casting hold the same surface.
        faces: (F, 3) indices of vertices, counter-clockwise from outside.
        regions: (F,) index into REGIONS of each face.
    """

    vertices: Array
    faces: Indices
    regions: NDArray[np.uint8]

    @classmethod
    def of(cls, vertices: Array, faces: NDArray[np.integer], region: str) -> Self:
        """Return a surface that lies in one region."""
        rounded = vertices.astype(np.float32).astype(np.float64)
        return cls(rounded, faces.astype(np.int32), np.full(len(faces), REGIONS.index(region), dtype=np.uint8))


def joined(parts: list[Surface]) -> Surface:
    """Return all triangles of several surfaces as one."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + np.int32(start) for part, start in zip(parts, starts[:-1], strict=True)]),
        np.concatenate([part.regions for part in parts]),
    )


def ground_surface(ground: Ground, objects: Objects, terrain: Terrain) -> Surface:
    """Return the terrain over its square as a grid, finer where trenches are.

    Raises:
        ConfigError: the grid has more triangles than MAX_GROUND_TRIANGLES.
    """
    east, north = (_grid_lines(ground, objects.trenches, axis) for axis in (0, 1))
    count = 2 * (len(east) - 1) * (len(north) - 1)
    if count > MAX_GROUND_TRIANGLES:
        raise ConfigError(
            f"ground: its mesh has {count} triangles (allowed: {MAX_GROUND_TRIANGLES}); "
            f"raise resolution_m {ground.resolution_m:g}, lower size_m {ground.size_m:g} or shorten trenches"
        )
    x, y = np.meshgrid(east, north)
    vertices = np.stack([x, y, terrain.height(x, y)], axis=-1).reshape(-1, 3)
    corner = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    faces = np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1).reshape(-1, 3)
    surface = Surface.of(vertices, faces, "ground")
    _label(surface, objects)
    return surface


def block_surface(block: Block) -> Surface:
    """Return walls, bottom and top or gable roof of a block."""
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = block.center + (signs * block.half_size) @ block.axes
    ridge = block.center + (np.array([[-1.0, 0.0], [1.0, 0.0]]) * block.half_size) @ block.axes
    vertices = np.concatenate(
        [
            np.column_stack([corners, np.full(4, block.bottom_m)]),
            np.column_stack([corners, np.full(4, block.eaves_m)]),
            np.column_stack([ridge, np.full(2, block.ridge_m)]),
        ]
    )
    walls = [face for i in range(4) for j in [(i + 1) % 4] for face in ((i, j, 4 + j), (i, 4 + j, 4 + i))]
    bottom = [(0, 2, 1), (0, 3, 2)]
    if block.ridge_m == block.eaves_m:
        return Surface.of(vertices[:8], np.array([*walls, *bottom, (4, 5, 6), (4, 6, 7)]), "box")
    roof = [(4, 5, 9), (4, 9, 8), (6, 7, 8), (6, 8, 9), (7, 4, 8), (5, 6, 9)]
    return Surface.of(vertices, np.array([*walls, *bottom, *roof]), "box")


def tree_surface(plant: Plant, rng: np.random.Generator) -> Surface:
    """Return a trunk and the leaves of a crown: squares that lie and point at random, as a lidar meets them."""
    return joined([_trunk(plant), _leaves(plant, rng)])


def _grid_lines(ground: Ground, trenches: tuple[Trench, ...], axis: int) -> Array:
    """Return where the lines of the grid cross an axis [m]: cells that a trench crosses are divided."""
    half, cells = ground.size_m / 2.0, ceil(ground.size_m / ground.resolution_m)
    lines = np.linspace(-half, half, cells + 1)
    fine = np.zeros(cells, dtype=np.bool_)
    for trench in trenches:
        low, high = sorted((trench.start_m[axis], trench.end_m[axis]))
        margin = (trench.width_m + WALL_M) / 2.0
        fine |= (lines[1:] > low - margin) & (lines[:-1] < high + margin)
    parts = np.where(fine, ceil(ground.size_m / cells / TRENCH_CELL_M), 1)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(np.repeat(lines[:-1], parts) + within * np.repeat(np.diff(lines) / parts, parts), half)


def _label(surface: Surface, objects: Objects) -> None:
    """Give the triangles of the ground that lie in heaps and trenches their region, in place."""
    middle = surface.vertices[surface.faces, :2].mean(axis=1)
    for heap in objects.heaps:
        inside = np.sum((middle - heap.center_m) ** 2, axis=1) < heap.radius_m**2
        surface.regions[inside] = REGIONS.index("heap")
    for trench in objects.trenches:
        along, across, length = trench_coordinates(trench, middle[:, 0], middle[:, 1])
        inside = (along > 0.0) & (along < length) & (np.abs(across) < (trench.width_m + WALL_M) / 2.0)
        surface.regions[inside] = REGIONS.index("trench")


def _trunk(plant: Plant) -> Surface:
    angle = np.arange(TRUNK_SIDES) * 2.0 * pi / TRUNK_SIDES
    ring = plant.crown_center[:2] + plant.trunk_radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    heights = (plant.bottom_m, plant.crown_center[2])
    vertices = np.concatenate([np.column_stack([ring, np.full(TRUNK_SIDES, height)]) for height in heights])
    low = np.arange(TRUNK_SIDES)
    following = (low + 1) % TRUNK_SIDES
    up = TRUNK_SIDES
    faces = np.concatenate(
        [np.stack([low, following, following + up], 1), np.stack([low, following + up, low + up], 1)]
    )
    return Surface.of(vertices, faces, "tree")


def _leaves(plant: Plant, rng: np.random.Generator) -> Surface:
    radius, _, half_height = plant.crown_half_axes
    # area of an ellipsoid of revolution, Thomsen's formula (within 1.1 %)
    area = 4.0 * pi * ((radius ** (2 * 1.6) + 2.0 * (radius * half_height) ** 1.6) / 3.0) ** (1 / 1.6)
    count = int(min(LEAVES_PER_M2 * area, MAX_LEAVES))
    side = LEAF_SIDE_M * np.sqrt(LEAVES_PER_M2 * area / count)
    outward, first, second = (_unit(rng.standard_normal((count, 3))) for _ in range(3))
    depth = np.cbrt(rng.uniform(INNER_LEAF**3, 1.0, (count, 1)))
    middle = plant.crown_center + depth * outward * plant.crown_half_axes
    second = _unit(second - np.sum(first * second, axis=1, keepdims=True) * first)
    corners = [middle + side / 2.0 * (u * first + v * second) for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    start = 4 * np.arange(count)[:, None, None]
    faces = (start + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return Surface.of(np.stack(corners, axis=1).reshape(-1, 3), faces, "tree")


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit
