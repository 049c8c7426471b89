"""A site: ground and what stands on it, as height, as a surface for the lidar and as obstacles in the sky for GNSS."""

from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from holdfast.extras import needing
from holdfast.messages import Array
from holdfast.sim.readings import generator
from holdfast.sim.scenario import Ground, Objects
from holdfast.sim.sky import sky_view
from holdfast.sim.solids import block, plant
from holdfast.sim.surface import REGIONS, Surface, block_surface, ground_surface, joined, tree_surface
from holdfast.sim.terrain import Terrain

if TYPE_CHECKING:
    from trimesh import Trimesh


class Site:
    """Everything around the machine that does not move; triangles are made when first asked for.

    Attributes:
        terrain: height of the ground.
        blocks: boxes, put on the ground.
        plants: trees, put on the ground.
    """

    def __init__(self, ground: Ground, objects: Objects) -> None:
        self._ground, self._objects = ground, objects
        self.terrain = Terrain(ground, objects)
        self.blocks = [block(box, self.terrain) for box in objects.boxes]
        self.plants = [plant(tree, self.terrain) for tree in objects.trees]

    @cached_property
    def surface(self) -> Surface:
        """All triangles with their regions.

        Raises:
            ConfigError: the ground has too many triangles.
        """
        parts = [ground_surface(self._ground, self._objects, self.terrain)]
        parts += [block_surface(solid) for solid in self.blocks]
        for index, tree in enumerate(self.plants):
            parts.append(tree_surface(tree, generator(self._ground.seed, "tree", str(index))))
        return joined(parts)

    @property
    def regions(self) -> NDArray[np.uint8]:
        """(F,) index into `surface.REGIONS` of each triangle, in the order of the mesh and of the PLY file."""
        return self.surface.regions

    def mesh(self) -> "Trimesh":
        """Return the surface in W as trimesh holds it, vertices and faces in their order.

        Raises:
            ConfigError: trimesh is not installed, or the ground has too many triangles.
        """
        with needing("the mesh of a site", "sim"):
            trimesh = import_module("trimesh")
        mesh: Trimesh = trimesh.Trimesh(self.surface.vertices, self.surface.faces, process=False)
        return mesh

    def sky_view(self, points: Array) -> Array:
        """Return the fraction (N,) of the sky that antennas at points (N, 3) in W [m] see; see `sky.sky_view`."""
        return sky_view(points, self.blocks, self.plants)

    def write_ply(self, path: str | Path) -> None:
        """Write the surface as binary PLY: float32 vertices in W [m], triangles, and per triangle its `region`.

        Raises:
            ConfigError: the ground has too many triangles.
            OSError: the file cannot be written.
        """
        surface = self.surface
        faces = np.empty(len(surface.faces), dtype=[("count", "u1"), ("corners", "<i4", 3), ("region", "u1")])
        faces["count"], faces["corners"], faces["region"] = 3, surface.faces, surface.regions
        names = ", ".join(f"{index} {name}" for index, name in enumerate(REGIONS))
        header = (
            "ply\nformat binary_little_endian 1.0\n"
            f"comment W: east, north, up [m]; regions: {names}\n"
            f"element vertex {len(surface.vertices)}\n"
            "property float x\nproperty float y\nproperty float z\n"
            f"element face {len(faces)}\n"
            "property list uchar int vertex_indices\nproperty uchar region\nend_header\n"
        )
        with Path(path).open("wb") as file:
            file.write(header.encode() + surface.vertices.astype("<f4").tobytes() + faces.tobytes())
