"""Maps from scans and the poses of any trajectory, and their distance to the true surface (paper, Figs. 1 and 5).

Every point is moved to the pose of the lidar at its own time, so the errors of a map are those of the trajectory and of
the ranges. Of the points in each voxel one is kept, drawn at random, and stands for all of them: no mean hides their
variance. Each patch of the surface is weighted by its area, and within it each point equally: the measures depend
neither on how often a surface was seen nor on its distance. The map from the true poses shows the limit of the lidar.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import ConfigError, RecordingError
from holdfast.evaluation import quaternions
from holdfast.evaluation.association import check_trajectory
from holdfast.evaluation.mesh import SurfaceIndex
from holdfast.messages import Array
from holdfast.output_folder import naming_the_output
from holdfast.state import Trajectory

MERGE_POINTS = 2_000_000  # so many are kept before they are merged into voxels
PATCH_M = 1.0  # side of a patch of the surface: several voxels, so that each has points of all its visible parts
CELL_BITS = 21  # per axis of a voxel's index: 400 km at 0.2 m
WHOLE = "all"


@dataclass(frozen=True, slots=True, eq=False)
class MapScan:
    """One sweep of the lidar.

    Attributes:
        stamp_ns: from which the offsets count.
        points: (N, 3) each in L at its own time [m].
        offsets_ns: (N,) time of each point after the stamp.
    """

    stamp_ns: int
    points: NDArray[np.float32]
    offsets_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class MapOptions:
    """How a map is made and judged.

    Attributes:
        voxel_m: side of a voxel.
        max_points_per_scan: a denser scan is thinned evenly.
        max_range_m: farther points are left out: an error of attitude moves them most.
        max_gap_s: a scan over a longer gap of the trajectory is left out.
        within_m: distance to the surface of which `Closeness.fraction_within` is the fraction.
        pixel_m: side of a pixel of the view from above.

    Raises:
        ConfigError: a number is not positive.
    """

    voxel_m: float = 0.2
    max_points_per_scan: int = 3000
    max_range_m: float = 50.0
    max_gap_s: float = 0.5
    within_m: float = 0.05
    pixel_m: float = 0.4

    def __post_init__(self) -> None:
        """Refuse numbers with which no map can be made."""
        numbers = (self.voxel_m, self.max_points_per_scan, self.max_range_m, self.max_gap_s, self.pixel_m)
        if not all(0.0 < number < np.inf for number in numbers) or self.within_m < 0.0:
            raise ConfigError(f"{self}: the numbers must be positive")

    def rows_of(self, points: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return which points (N, 3) of a scan are used: the near ones, thinned evenly; of those again all."""
        near = np.flatnonzero(np.einsum("nd,nd->n", points, points) <= self.max_range_m**2)
        return near[:: max(1, -(-len(near) // self.max_points_per_scan))]


@dataclass(frozen=True, slots=True, eq=False)
class VoxelMap:
    """A map.

    Attributes:
        points: (V, 3) one point of each voxel, in W [m].
        counts: (V,) how many there are in it.
        scans: that were used.
        left_out: scans that the trajectory does not cover, or only with a gap.
    """

    points: Array
    counts: NDArray[np.int64]
    scans: int
    left_out: int


@dataclass(frozen=True, slots=True)
class Closeness:
    """How near the points of a map are to the surface, each patch of it weighted by its area.

    Attributes:
        points: of the map.
        area_m2: of the surface to which they are near.
        fraction_within: fraction of the surface that is mapped within `MapOptions.within_m`.
    """

    points: int
    area_m2: float
    median_m: float
    p95_m: float
    rms_m: float
    fraction_within: float


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The map from above.

    Attributes:
        errors: (H, W) mean distance to the surface in each pixel [m], the northern row first; NaN where nothing is.
        corner: east and north of the south-western corner [m].
        pixel_m: side of a pixel.
    """

    errors: Array
    corner: tuple[float, float]
    pixel_m: float


@dataclass(frozen=True, slots=True, eq=False)
class MapQuality:
    """The verdict on a map.

    Attributes:
        map: what is judged.
        distances: (V,) of the map's points to the surface [m].
        closeness: of all, and by the region of the nearest triangle.
        view: coloured by distance.
    """

    map: VoxelMap
    distances: Array
    closeness: Mapping[str, Closeness]
    view: View


def map_quality(
    scans: Iterable[MapScan],
    trajectory: Trajectory,
    surface: SurfaceIndex,
    T_I_L: Array,
    options: MapOptions | None = None,
) -> MapQuality:
    """Make a map from scans and judge it by the true surface.

    Args:
        scans: in the order of time.
        trajectory: of I in W.
        surface: in W.
        T_I_L: (4, 4) pose of the lidar in I.
        options: how the map is made and judged.

    Raises:
        RecordingError: the trajectory cannot be used, or covers no scan.
    """
    options = options or MapOptions()
    return judge_map(build_map(scans, trajectory, T_I_L, options), surface, options)


def judge_map(voxels: VoxelMap, surface: SurfaceIndex, options: MapOptions) -> MapQuality:
    """Judge a map by the true surface."""
    distances, pieces = surface.nearest(voxels.points)
    weights = _weights(pieces, voxels.counts, surface)
    regions = surface.regions_of(pieces)
    closeness = {WHOLE: _closeness(distances, weights, options)}
    for index, name in enumerate(surface.mesh.names):
        inside = regions == index
        if inside.any():
            closeness[name] = _closeness(distances[inside], weights[inside], options)
    return MapQuality(voxels, distances, closeness, _view(voxels, distances, options))


def build_map(scans: Iterable[MapScan], trajectory: Trajectory, T_I_L: Array, options: MapOptions) -> VoxelMap:
    """Move every point to the pose of the lidar at its own time, and gather them in voxels; as `map_quality`."""
    check_trajectory(trajectory, "trajectory")
    used, left_out, cells, rng = 0, 0, _Cells(options.voxel_m), np.random.default_rng(0)
    for scan in scans:
        near = options.rows_of(scan.points)
        stamps_ns = scan.stamp_ns + scan.offsets_ns[near]
        moved = move_points(scan.points[near], stamps_ns, trajectory, T_I_L, options.max_gap_s)
        if moved is None:
            left_out += 1
            continue
        used += 1
        cells.add(moved.points, rng.random(len(moved.points)))
    cells.merge()
    if not len(cells.points):
        raise RecordingError(f"the trajectory covers none of the {left_out} scans, so there is no map")
    return VoxelMap(cells.points, cells.counts, used, left_out)


class _Cells:
    """The voxels so far; points wait until there are enough for one sort."""

    def __init__(self, voxel_m: float) -> None:
        self.points, self.counts = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
        self._priorities, self._voxel_m = np.zeros(0), voxel_m
        self._waiting: list[tuple[Array, Array]] = []

    def add(self, points: Array, priorities: Array) -> None:
        """Add points (N, 3); of each voxel the point of least priority (N,) is kept."""
        self._waiting.append((points, priorities))
        if sum(len(points) for points, _ in self._waiting) > MERGE_POINTS:
            self.merge()

    def merge(self) -> None:
        """Put the points that wait into their voxels."""
        points = np.concatenate([self.points, *(points for points, _ in self._waiting)])
        priorities = np.concatenate([self._priorities, *(priorities for _, priorities in self._waiting)])
        counts = np.concatenate([self.counts, np.ones(len(points) - len(self.counts), dtype=np.int64)])
        self._waiting.clear()
        key = _keys(points, self._voxel_m)
        order = np.lexsort((priorities, key))
        first = np.flatnonzero(np.diff(key[order], prepend=-1))
        kept = order[first]
        self.counts = np.add.reduceat(counts[order], first) if len(first) else counts
        self.points, self._priorities = points[kept], priorities[kept]


def write_map(quality: MapQuality, path: Path) -> None:
    """Write a map as binary PLY: x, y, z (float32) in W [m], and `distance` (float32) to the surface [m].

    Raises:
        ConfigError: the file cannot be written.
    """
    names = ("x", "y", "z", "distance")
    records = np.empty(len(quality.distances), dtype=[(name, "<f4") for name in names])
    for axis, name in enumerate(names[:3]):
        records[name] = quality.map.points[:, axis]
    records["distance"] = quality.distances
    header = "ply\nformat binary_little_endian 1.0\ncomment W: east, north, up [m]; distance to the surface [m]\n"
    header += f"element vertex {len(records)}\n" + "".join(f"property float {name}\n" for name in names)
    with naming_the_output(path):
        path.write_bytes(f"{header}end_header\n".encode() + records.tobytes())


class Moved(NamedTuple):
    """Points of a scan in W, with the poses from which they were measured.

    Attributes:
        points: (N, 3) in W [m].
        lidar: (N, 3) the position of L in W at the time of each point [m].
        imu: (N, 3) that of I.
    """

    points: Array
    lidar: Array
    imu: Array


def move_points(
    points: NDArray[np.floating], stamps_ns: NDArray[np.int64], trajectory: Trajectory, T_I_L: Array, max_gap_s: float
) -> Moved | None:
    """Move points (N, 3), each in L at its own time (N,), to W; None if the trajectory does not cover them all.

    Args:
        points: [m].
        stamps_ns: of the points.
        trajectory: of I in W; linear in position and slerp in rotation between its poses.
        T_I_L: (4, 4) pose of the lidar in I.
        max_gap_s: a longer gap between two poses is not bridged.
    """
    stamps = trajectory.stamps_ns
    wanted, row = np.unique(stamps_ns, return_inverse=True)  # the points of a column have one time
    if len(stamps) < 2 or not len(wanted) or wanted[0] < stamps[0] or wanted[-1] > stamps[-1]:
        return None
    before = np.clip(np.searchsorted(stamps, wanted, side="right") - 1, 0, len(stamps) - 2)
    gap = stamps[before + 1] - stamps[before]
    if gap.max() > max_gap_s * 1e9:
        return None
    fraction = (wanted - stamps[before]) / gap
    start, end = trajectory.positions[before], trajectory.positions[before + 1]
    q = quaternions.slerp(trajectory.quaternions[before], trajectory.quaternions[before + 1], fraction)
    imu = start + fraction[:, None] * (end - start)
    lidar = imu + quaternions.rotate(q, T_I_L[:3, 3])
    in_imu = points.astype(np.float64) @ T_I_L[:3, :3].T + T_I_L[:3, 3]
    return Moved(imu[row] + quaternions.rotate(q[row], in_imu), lidar[row], imu[row])


def _keys(points: Array, voxel_m: float) -> NDArray[np.int64]:
    """Return the number (N,) of each point's voxel."""
    half = 1 << (CELL_BITS - 1)
    x, y, z = np.clip(np.floor(points / voxel_m).astype(np.int64) + half, 0, 2 * half - 1).T
    keys: NDArray[np.int64] = (x << (2 * CELL_BITS)) | (y << CELL_BITS) | z
    return keys


def _weights(pieces: NDArray[np.int64], counts: NDArray[np.int64], surface: SurfaceIndex) -> Array:
    """Return weights (V,) of points [m^2]: the area of the pieces of a patch that were seen is divided among them."""
    seen, of_point = np.unique(pieces, return_inverse=True)
    cells = np.floor(surface.samples[seen] / PATCH_M).astype(np.int64)
    keys = np.column_stack([cells, surface.regions_of(seen)])
    patch_of_seen = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    areas = np.bincount(patch_of_seen, surface.areas_m2[seen])
    patch = patch_of_seen[of_point]
    weights: Array = areas[patch] * counts / np.bincount(patch, counts)[patch]
    return weights


def _closeness(distances: Array, weights: Array, options: MapOptions) -> Closeness:
    order = np.argsort(distances)
    up_to = np.cumsum(weights[order])
    median, p95 = distances[order[np.searchsorted(up_to, np.array([0.5, 0.95]) * up_to[-1])]]
    return Closeness(
        points=len(distances),
        area_m2=float(up_to[-1]),
        median_m=float(median),
        p95_m=float(p95),
        rms_m=float(np.sqrt(np.average(distances**2, weights=weights))),
        fraction_within=float(np.average(distances <= options.within_m, weights=weights)),
    )


def _view(voxels: VoxelMap, distances: Array, options: MapOptions) -> View:
    low = np.floor(voxels.points[:, :2].min(axis=0) / options.pixel_m)
    column, row = (np.floor(voxels.points[:, :2] / options.pixel_m) - low).astype(np.int64).T
    width, height = int(column.max()) + 1, int(row.max()) + 1
    pixel = (height - 1 - row) * width + column
    counts = np.bincount(pixel, voxels.counts, width * height)
    sums = np.bincount(pixel, voxels.counts * distances, width * height)
    errors = np.divide(sums, counts, out=np.full(width * height, np.nan), where=counts > 0)
    east, north = (low * options.pixel_m).tolist()
    return View(errors.reshape(height, width), (east, north), options.pixel_m)
