"""What stands on the ground, in W: blocks (containers, walls, buildings) and trees, at the height of their ground."""

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np

from holdfast.messages import Array
from holdfast.sim.scenario import Box, Tree
from holdfast.sim.terrain import Terrain

CROWN_RATIO = 0.7  # of a tree's height; the rest is bare trunk
SUNK_M = 0.2  # solids reach so far below the lowest ground under them


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """A box on the ground, its height counted from the ground under its centre, perhaps with a gable roof.

    Attributes:
        center: (2,) east and north [m].
        axes: (2, 2) rows are the horizontal directions of length and width.
        half_size: (2,) half of length and width [m].
        bottom_m: below the lowest ground under it.
        eaves_m: height at which the walls end.
        ridge_m: height of the ridge, which runs along the length; without a roof that of the eaves.
    """

    center: Array
    axes: Array
    half_size: Array
    bottom_m: float
    eaves_m: float
    ridge_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """A tree: a vertical trunk up to the centre of an ellipsoid of leaves.

    Attributes:
        crown_center: (3,) [m].
        crown_half_axes: (3,) [m].
        trunk_radius_m: of the trunk.
        bottom_m: lower end of the trunk, below the ground.
    """

    crown_center: Array
    crown_half_axes: Array
    trunk_radius_m: float
    bottom_m: float


def block(box: Box, terrain: Terrain) -> Block:
    """Put a box on the ground."""
    center, half = np.array(box.center_m), np.array(box.size_m[:2]) / 2.0
    c, s = cos(radians(box.yaw_deg)), sin(radians(box.yaw_deg))
    axes = np.array([[c, s], [-s, c]])
    across = np.linspace(-1.0, 1.0, 9)
    under = center + (np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2) * half) @ axes
    ground = terrain.height(under[:, 0], under[:, 1])
    eaves_m = float(ground[len(ground) // 2]) + box.size_m[2]
    return Block(center, axes, half, float(ground.min()) - SUNK_M, eaves_m, eaves_m + box.roof_m)


def plant(tree: Tree, terrain: Terrain) -> Plant:
    """Put a tree on the ground."""
    east, north = tree.center_m
    ground_m = float(terrain.height(np.array([east]), np.array([north]))[0])
    half_height_m = CROWN_RATIO * tree.height_m / 2.0
    return Plant(
        crown_center=np.array([east, north, ground_m + tree.height_m - half_height_m]),
        crown_half_axes=np.array([tree.crown_radius_m, tree.crown_radius_m, half_height_m]),
        trunk_radius_m=tree.trunk_radius_m,
        bottom_m=ground_m - SUNK_M,
    )
