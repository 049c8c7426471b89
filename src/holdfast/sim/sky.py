"""How much of the sky an antenna sees past crowns and buildings, computed analytically."""

from collections.abc import Iterator, Sequence
from math import pi, radians, sin, sqrt, tan

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array
from holdfast.sim.solids import Block, Plant

MASK_DEG = 10.0  # receivers do not use satellites below this elevation
DIRECTIONS = 192
CHUNK = 2048
GOLDEN_ANGLE_RAD = pi * (3.0 - sqrt(5.0))

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]


def sky_view(points: Array, blocks: Sequence[Block], plants: Sequence[Plant]) -> Array:
    """Return the fraction (N,) in [0, 1] of the sky above MASK_DEG that is open over points (N, 3) in W [m].

    The sky is weighted with sin(elevation), as receivers weight satellites: of DIRECTIONS rays distributed with that
    density, those count that meet neither a block nor a crown. A crown is taken as opaque; trunks and the ground,
    heaps and trenches included, are left out.
    """
    directions = sky_directions()
    blocked = np.zeros((len(points), DIRECTIONS), dtype=np.bool_)
    for tree in plants:
        center, half = tree.crown_center, tree.crown_half_axes
        for rows in _shaded(points, center[:2], float(half[0]), float(center[2] + half[2])):
            blocked[rows] |= _meets_crown(tree, points[rows], directions)
    for solid in blocks:
        for rows in _shaded(points, solid.center, float(np.hypot(*solid.half_size)), solid.ridge_m):
            blocked[rows] |= _meets_block(solid, points[rows], directions)
    return 1.0 - np.asarray(blocked.mean(axis=1))


def sky_directions() -> Array:
    """Return unit vectors (DIRECTIONS, 3) in W above MASK_DEG, their density proportional to sin(elevation).

    A Fibonacci spiral (golden angle in azimuth) whose sin^2(elevation) is uniform.
    """
    k = np.arange(DIRECTIONS)
    lowest = sin(radians(MASK_DEG)) ** 2
    up_squared = lowest + (1.0 - lowest) * (k + 0.5) / DIRECTIONS
    out, azimuth = np.sqrt(1.0 - up_squared), GOLDEN_ANGLE_RAD * k
    return np.column_stack([out * np.cos(azimuth), out * np.sin(azimuth), np.sqrt(up_squared)])


def _shaded(points: Array, center: Array, reach_m: float, top_m: float) -> Iterator[NDArray[np.intp]]:
    """Yield chunks of the indices of those points over which a solid may stand above MASK_DEG.

    The solid is within `reach_m` of `center` (2,) and below `top_m`.
    """
    gap_m = np.linalg.norm(points[:, :2] - center, axis=1) - reach_m
    near = np.flatnonzero(tan(radians(MASK_DEG)) * np.maximum(gap_m, 0.0) < top_m - points[:, 2])
    for begin in range(0, len(near), CHUNK):
        yield near[begin : begin + CHUNK]


def _meets_crown(tree: Plant, points: Array, directions: Array) -> Mask:
    """Return (N, D) whether rays meet the crown.

    In coordinates in which the crown is the unit sphere, a ray from q outside it along the unit vector e meets it if
    q e <= -sqrt(q q - 1).
    """
    start = (points - tree.crown_center) / tree.crown_half_axes
    along = directions / tree.crown_half_axes
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    tangent = np.sqrt(np.maximum(np.sum(start**2, axis=1) - 1.0, 0.0))
    tangent[np.sum(start**2, axis=1) < 1.0] = -np.inf  # inside
    hit: Mask = start.astype(np.float32) @ along.T.astype(np.float32) <= -tangent[:, None].astype(np.float32)
    return hit


def _meets_block(solid: Block, points: Array, directions: Array) -> Mask:
    """Return (N, D) whether rays meet the block: they enter its last half-space before they leave the first.

    Of the half-spaces n x <= h, the one below is left out, since rays go upwards.
    """
    normals, heights = _half_spaces(solid)
    room = (heights - points @ normals.T).astype(np.float32)
    speed = directions @ normals.T
    speed[np.abs(speed) < 1e-9] = 1e-9
    enter: Floats = np.zeros((len(points), len(directions)), dtype=np.float32)
    leave: Floats = np.full_like(enter, np.inf)
    for face in range(len(normals)):
        inverse = (1.0 / speed[:, face]).astype(np.float32)
        inward, outward = np.flatnonzero(inverse < 0.0), np.flatnonzero(inverse > 0.0)
        enter[:, inward] = np.maximum(enter[:, inward], np.multiply.outer(room[:, face], inverse[inward]))
        leave[:, outward] = np.minimum(leave[:, outward], np.multiply.outer(room[:, face], inverse[outward]))
    hit: Mask = enter <= leave
    return hit


def _half_spaces(solid: Block) -> tuple[Array, Array]:
    """Return normals n (F, 3) and heights h (F,) of walls and roof: inside is n x <= h."""
    length, width = np.column_stack([solid.axes, np.zeros(2)])
    # both roof planes contain the ridge; without a roof they are the flat top
    rise = (solid.ridge_m - solid.eaves_m) / solid.half_size[1]
    up = np.array([0.0, 0.0, 1.0])
    normals = np.array([length, -length, width, -width, up + rise * width, up - rise * width])
    center = np.append(solid.center, solid.ridge_m)
    margins = np.array([*np.repeat(solid.half_size, 2), 0.0, 0.0])
    return normals, normals @ center + margins
