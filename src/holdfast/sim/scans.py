"""Scans of a lidar, cast against the triangles of a site, and their bytes as sensor_msgs/PointCloud2.

Column c of a sweep is measured c/columns of the period after its start. A spinning sensor turns clockwise, seen from
above: column 0 looks backwards (along -x of L), and the azimuth, counted from x to y, falls: pi - 2 pi c / columns.
Ring 0 is the highest ray. One with a rosette looks forward (along x of L) through two prisms that turn against each
other, so that no sweep is like the one before. The points of a column are expressed in L at the column's own time, as a
driver publishes them.

embreex, which casts the rays, has wheels for x86_64 only; simulating without scans works everywhere.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from math import pi, radians
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from holdfast.extras import needing
from holdfast.messages import Array
from holdfast.ros.cdr import ENCAPSULATION, NS_PER_S
from holdfast.sim.boxes import BoxMotion, distances
from holdfast.sim.sensors.scanner import SimulatedScanner

if TYPE_CHECKING:
    from trimesh import Trimesh

POINT_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
PRISMS_HZ = 121.57, -77.73  # at which the two turn
EMITTERS_DEG = 0.3  # between the rays of one instant
FLOAT32, UINT32 = 7, 6  # of sensor_msgs/PointField
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
TIMED_POINT = np.dtype([*POINT.descr, ("t", "<u4")])


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """The returns of one sweep, in the order in which they were measured: column by column, from the highest ray down.

    Attributes:
        index: number of the sweep.
        points: (N, 3) each in L at its own time [m].
        offset_ns: (N,) time of each point since the start of the sweep.
        ring: (N,) ray of each point; 0 is the highest.
        moving: (N,) whether the point lies on a box that moves: the machine itself, or traffic.
    """

    index: int
    points: NDArray[np.float32]
    offset_ns: NDArray[np.uint32]
    ring: NDArray[np.uint16]
    moving: NDArray[np.bool_] | None = None


class Scanner:
    """A lidar over a surface.

    Raises:
        ConfigError: embreex is not installed.
    """

    def __init__(self, lidar: SimulatedScanner, mesh: "Trimesh") -> None:
        self._lidar = lidar
        self._scene = _scene(mesh.vertices.view(np.ndarray), mesh.faces.view(np.ndarray))
        self._rings = _rings(lidar) if lidar.pattern == "rings" else None
        offset_ns = np.rint(self.column_times_s(0.0) * NS_PER_S).astype(np.uint32)
        self._offset_ns = np.repeat(offset_ns, lidar.channels)
        self._ring = np.tile(np.arange(lidar.channels, dtype=np.uint16), lidar.columns)

    def column_times_s(self, start_s: float) -> Array:
        """Return the true time (columns,) of each column of a sweep that starts at `start_s`."""
        return start_s + np.arange(self._lidar.columns) / (self._lidar.columns * self._lidar.rate_hz)

    def scan(self, k: int, R_W_L: Array, p_W: Array, rng: np.random.Generator, boxes: Sequence[BoxMotion] = ()) -> Scan:
        """Return sweep `k`.

        Args:
            k: its number, kept in the scan.
            R_W_L: (columns, 3, 3) attitude of the lidar at each column's time.
            p_W: (columns, 3) its position [m].
            rng: of range noise and drop-outs; every sweep takes equally many numbers, whatever it sees.
            boxes: that move, at each column's time.
        """
        lidar = self._lidar
        rays = _rosette(lidar, self.column_times_s(k / lidar.rate_hz)) if self._rings is None else self._rings
        directions = (rays @ R_W_L.transpose(0, 2, 1)).astype(np.float32).reshape(-1, 3)
        origins = np.repeat(p_W.astype(np.float32), lidar.channels, axis=0)
        distance: NDArray[np.float32] = self._scene.run(origins, directions, query="DISTANCE")
        to_boxes = distances(list(boxes), rays, R_W_L, p_W).ravel().astype(np.float32)
        moving = to_boxes < distance
        distance = np.minimum(distance, to_boxes)
        distance = distance + np.float32(lidar.range_noise_m) * rng.standard_normal(len(distance), dtype=np.float32)
        kept = (distance >= lidar.min_range_m) & (distance <= lidar.max_range_m)
        kept &= rng.random(len(distance), dtype=np.float32) >= lidar.dropout_ratio
        returned = np.flatnonzero(kept)
        points = rays.reshape(-1, 3)[returned].astype(np.float32) * distance[returned, None]
        return Scan(k, points, self._offset_ns[returned], self._ring[returned], moving[returned])


def _rings(lidar: SimulatedScanner) -> Array:
    """Return the rays (columns, channels, 3) in L of a sensor that turns about z."""
    low, high = (radians(angle) for angle in lidar.field_of_view_deg)
    elevation = np.linspace(high, low, lidar.channels)
    azimuth = pi - 2.0 * pi * np.arange(lidar.columns) / lidar.columns
    rays = np.empty((lidar.columns, lidar.channels, 3))
    rays[..., 0] = np.cos(azimuth)[:, None] * np.cos(elevation)
    rays[..., 1] = np.sin(azimuth)[:, None] * np.cos(elevation)
    rays[..., 2] = np.sin(elevation)
    return rays


def _rosette(lidar: SimulatedScanner, times_s: Array) -> Array:
    """Return the rays (columns, channels, 3) in L, at times (columns,), of a sensor that looks along x.

    Each of two prisms bends the rays by half of what the field of view allows (Liu, Yuan and Zhang 2021, "Low-cost
    retina-like robotic lidars based on incommensurable scanning").
    """
    low, high = (radians(angle) for angle in lidar.field_of_view_deg)
    phases = 2.0 * pi * np.multiply.outer(PRISMS_HZ, times_s)
    across, up = ((high - low) / 4.0 * of(phases).sum(axis=0) for of in (np.cos, np.sin))
    apart = radians(EMITTERS_DEG) * (np.arange(lidar.channels) - 0.5 * (lidar.channels - 1))
    across, up = across[:, None], up[:, None] - apart
    bent = np.hypot(across, up)
    sines = np.sinc(bent / pi)  # sin(x)/x
    middle = (low + high) / 2.0
    forward, upward = np.cos(bent), sines * up
    rays = np.empty((*bent.shape, 3))
    rays[..., 0] = forward * np.cos(middle) - upward * np.sin(middle)
    rays[..., 1] = sines * across
    rays[..., 2] = forward * np.sin(middle) + upward * np.cos(middle)
    return rays


def encode_points(scan: Scan, stamp_ns: int, frame_id: str, *, point_times: bool = True) -> bytes:
    """Return a scan as sensor_msgs/PointCloud2 in CDR: unorganised, lost returns left out.

    Fields are x, y, z (float32) [m] and, with `point_times`, t (uint32) [ns] since `stamp_ns`, the start of the sweep.
    The bytes are those of rosbags' `serialize_cdr`.

    Raises:
        struct.error: the stamp lies beyond the 32 bit seconds of ROS.
    """
    cloud = np.empty(len(scan.points), dtype=TIMED_POINT if point_times else POINT)
    for axis, name in enumerate("xyz"):
        cloud[name] = scan.points[:, axis]
    if point_times:
        cloud["t"] = scan.offset_ns
    names = cloud.dtype.names or ()
    body = bytearray(struct.pack("<iI", *divmod(stamp_ns, NS_PER_S)))
    _append_text(body, frame_id)
    _append_integers(body, 1, len(cloud), len(names))
    for index, name in enumerate(names):
        _append_text(body, name)
        _append_integers(body, 4 * index)
        body.append(UINT32 if name == "t" else FLOAT32)
        _append_integers(body, 1)
    body.append(False)  # is_bigendian
    _append_integers(body, cloud.itemsize, cloud.nbytes, cloud.nbytes)
    return b"".join([ENCAPSULATION, body, cloud.tobytes(), b"\x01"])


def _append_integers(body: bytearray, *values: int) -> None:
    body += bytes(-len(body) % 4) + struct.pack(f"<{len(values)}I", *values)


def _append_text(body: bytearray, text: str) -> None:
    data = text.encode() + b"\x00"
    _append_integers(body, len(data))
    body += data


def _scene(vertices: Array, faces: NDArray[np.integer]) -> Any:  # embreex has no types
    with needing("casting the scans of a lidar", "sim"):
        scene = import_module("embreex.rtcore_scene").EmbreeScene()
        construction = import_module("embreex.mesh_construction")
    construction.TriangleMesh(scene, vertices.astype(np.float32), faces.astype(np.int32))
    return scene
