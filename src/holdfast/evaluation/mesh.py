"""A surface of triangles with regions, and the exact distance of many points to it.

The nearest triangle is looked for among those whose samples are nearest (`SurfaceIndex`): the surface is covered by
samples, each of which stands for a piece of a triangle within a radius r about it. Let d be the distance found among
the triangles of the k nearest samples, and d_k the distance of the k-th. No other triangle can be nearer than d_k - r,
so d <= d_k - r proves d; where it does not, k grows. Distances of points to triangles: Ericson, "Real-Time Collision
Detection", 2005, section 5.1.5. This needs scipy's KD-tree: the extra `sim`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import RecordingError
from holdfast.extras import needing
from holdfast.messages import Array

SPACING_M = 0.3  # longest edge of the piece of a triangle that one sample stands for
NEIGHBOURS = (4, 16, 64)
CHUNK_POINTS = 10_000  # at a time: bounds the memory
PLY_HEADER_BYTES = 10_000
VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3), ("region", "u1")])
LAYOUT = (
    *("property float x", "property float y", "property float z"),
    *("property list uchar int vertex_indices", "property uchar region"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in W.

    Attributes:
        vertices: (V, 3) [m].
        faces: (F, 3) indices of vertices.
        regions: (F,) index into `names` of each triangle.
        names: of the regions.
    """

    vertices: Array
    faces: NDArray[np.int64]
    regions: NDArray[np.int64]
    names: tuple[str, ...]


def read_mesh(path: Path) -> Mesh:
    """Read the `site.ply` of a simulation: binary, triangles with regions whose names stand in a comment.

    Raises:
        RecordingError: the file cannot be read, or has another layout.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    header, found, _ = data[:PLY_HEADER_BYTES].partition(b"end_header\n")
    lines = header.decode("ascii", errors="replace").splitlines()
    layout = tuple(line for line in lines if line.startswith("property"))
    if not found or lines[:2] != ["ply", "format binary_little_endian 1.0"] or layout != LAYOUT:
        raise RecordingError(f"{path}: is no mesh with regions (allowed: the site.ply of `holdfast simulate`)")
    body = data[len(header) + len(found) :]
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    vertices, faces = counts["vertex"], counts["face"]
    if len(body) != vertices * VERTEX.itemsize + faces * FACE.itemsize:
        raise RecordingError(f"{path}: is cut off, or holds more than {vertices} vertices and {faces} triangles")
    points = np.frombuffer(body, dtype="<f4", count=3 * vertices).reshape(-1, 3).astype(np.float64)
    records = np.frombuffer(body, dtype=FACE, offset=vertices * VERTEX.itemsize)
    comment = next((line for line in lines if "regions:" in line), "")
    names = tuple(part.split()[1] for part in comment.partition("regions:")[2].split(","))
    return Mesh(points, records["corners"].astype(np.int64), records["region"].astype(np.int64), names)


class SurfaceIndex:
    """Finds distances to a mesh.

    Attributes:
        pieces: of the triangles: (S,) the triangle of each.
        samples: (S, 3) their middles [m].
        areas_m2: (S,) their areas.
        radius_m: that covers every piece from its sample.

    Raises:
        ConfigError: scipy is not installed.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        with needing("the distance to a mesh", "sim"):
            from scipy.spatial import cKDTree
        corners = mesh.vertices[mesh.faces]
        self._triangles = _Triangles(corners)
        self.samples, self.pieces, self.areas_m2, self.radius_m = _samples(corners)
        self._tree = cKDTree(self.samples, balanced_tree=False, compact_nodes=False)

    def nearest(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return the distances (N,) [m] of points (N, 3), and for each the piece (N,) of a triangle that is nearest.

        Exact below about 2 m; beyond, where the search ends, at most `radius_m` too large.
        """
        distances, pieces = np.full(len(points), np.inf), np.zeros(len(points), dtype=np.int64)
        for start in range(0, len(points), CHUNK_POINTS):
            rows = slice(start, start + CHUNK_POINTS)
            distances[rows], pieces[rows] = self._nearest(points[rows])
        return distances, pieces

    def regions_of(self, pieces: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the regions (N,) of pieces (N,)."""
        return self.mesh.regions[self.pieces[pieces]]

    def _nearest(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        distances, pieces = np.full(len(points), np.inf), np.zeros(len(points), dtype=np.int64)
        open_rows = np.arange(len(points))
        for count in NEIGHBOURS:
            count = min(count, len(self.pieces))  # noqa: PLW2901
            reach, near = self._tree.query(points[open_rows], k=count)
            near = near.reshape(len(open_rows), count)
            found = np.sqrt(self._triangles.squared_distances(points[open_rows], self.pieces[near]))
            best = found.argmin(axis=1)  # of the pieces of one triangle the first, whose sample is nearest
            rows = np.arange(len(open_rows))
            distances[open_rows], pieces[open_rows] = found[rows, best], near[rows, best]
            proven = distances[open_rows] <= reach.reshape(len(open_rows), count)[:, -1] - self.radius_m
            open_rows = open_rows[~proven]
            if not len(open_rows):
                break
        return distances, pieces


def _samples(corners: Array) -> tuple[Array, NDArray[np.int64], Array, float]:
    """Return samples (S, 3) of triangles (F, 3, 3), their triangles, the areas of their pieces, and the radius.

    A triangle whose longest edge has n times the spacing is divided into n^2 equal pieces; the samples are their
    centroids.
    """
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(edges / SPACING_M).astype(np.int64), 1)
    samples, face_of = [], []
    for count in np.unique(parts).tolist():
        chosen = np.flatnonzero(parts == count)
        weights = np.array(list(_middles(count)))
        samples.append(np.einsum("wc,fcd->fwd", weights, corners[chosen]).reshape(-1, 3))
        face_of.append(np.repeat(chosen, len(weights)))
    radii = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1) / parts
    whole_m2 = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    triangles = np.concatenate(face_of)
    return np.concatenate(samples), triangles, (whole_m2 / parts**2)[triangles], float(radii.max())


def _middles(count: int) -> Iterator[tuple[float, float, float]]:
    """Yield the barycentric coordinates of the middles of count^2 equal parts of a triangle."""
    third = 1.0 / 3.0
    for i in range(count):
        for j in range(count - i):
            yield (i + third) / count, (j + third) / count, (count - i - j - 2 * third) / count
            if i + j < count - 1:
                yield (i + 2 * third) / count, (j + 2 * third) / count, (count - i - j - 4 * third) / count


class _Triangles:
    """Triangles (F, 3, 3) by what their distance to a point needs, computed once, one array (F,) per axis."""

    def __init__(self, corners: Array) -> None:
        a, b, c = corners.transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        areas = np.linalg.norm(normals, axis=1)
        self._is_flat = areas <= 0.0
        with np.errstate(invalid="ignore", divide="ignore"):
            self._normal = np.where(areas > 0.0, normals.T / areas, 0.0)
        self._edges = []
        for start, end in ((a, b), (b, c), (c, a)):
            edge = end - start
            scaled = edge / np.maximum(np.einsum("fd,fd->f", edge, edge), 1e-30)[:, None]
            self._edges.append(tuple(part.T.copy() for part in (start, edge, scaled, np.cross(normals, edge))))

    def squared_distances(self, points: Array, which: NDArray[np.int64]) -> Array:
        """Return the squared distances (N, K) of points (N, 3) to some triangles (N, K)."""
        p = points.T[:, :, None]
        inside = ~self._is_flat[which]
        nearest = np.full(which.shape, np.inf)
        for start, edge, scaled, inwards in self._edges:
            to_point = [p[axis] - start[axis][which] for axis in range(3)]
            inside &= _dot(to_point, inwards, which) >= 0.0
            along = np.clip(_dot(to_point, scaled, which), 0.0, 1.0)
            offsets = [to_point[axis] - along * edge[axis][which] for axis in range(3)]
            np.minimum(nearest, sum(offset * offset for offset in offsets), out=nearest)
        height = _dot(to_point, self._normal, which)  # from any corner
        return np.where(inside, height * height, nearest)


def _dot(vectors: Sequence[Array], of_triangles: Array, which: NDArray[np.int64]) -> Array:
    """Return the products (N, K) of vectors, three arrays (N, K), with those of triangles (3, F)."""
    x, y, z = (vectors[axis] * of_triangles[axis][which] for axis in range(3))
    total: Array = x + y + z
    return total
