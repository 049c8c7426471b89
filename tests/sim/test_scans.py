"""Claims about ray-cast scans: where their points lie, what noise and motion do to them, and their bytes."""

import sys
from math import pi
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from holdfast.errors import ConfigError
from holdfast.messages import Array
from holdfast.sim.readings import generator
from holdfast.sim.scans import POINT_CLOUD_TYPE, Scan, Scanner, encode_points
from holdfast.sim.scenario import Box, Ground, Heap, Objects, Tree
from holdfast.sim.sensors.scanner import SimulatedScanner
from holdfast.sim.site import Site

STORE = get_typestore(Stores.ROS2_HUMBLE)
IDEAL = {"range_noise_m": 0.0, "dropout_ratio": 0.0}
SITE = Site(
    Ground(size_m=30.0),
    Objects(
        heaps=(Heap(center_m=(6.0, 0.0), radius_m=3.0, height_m=1.5),),
        boxes=(Box(center_m=(-6.0, 3.0), size_m=(6.0, 2.5, 2.6), roof_m=1.0),),
        trees=(Tree(center_m=(2.0, 8.0)),),
    ),
)


def _lidar(**changes: Any) -> SimulatedScanner:
    values = {
        "kind": "scanner",
        "topic": "/points",
        "frame": "lidar",
        "rate_hz": 10.0,
        "channels": 32,
        "columns": 256,
        **changes,
    }
    return SimulatedScanner(**values)


def _scanner(**changes: Any) -> Scanner:
    return Scanner(_lidar(**changes), SITE.mesh())


def _poses(columns: int, yaw_rate_rad_s: float = 0.0, speed_m_s: float = 0.0) -> tuple[Array, Array]:
    """Return poses (columns, 3, 3), (columns, 3) of a lidar that is tilted, turns and drives for 0.1 s."""
    t = np.arange(columns) / columns * 0.1
    tilt, yaw = 0.1, 0.3 + yaw_rate_rad_s * t
    c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros(columns), np.ones(columns)
    turn = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    lean = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    return turn @ lean, np.column_stack([speed_m_s * t, 0.2 + zero, 2.5 + zero])


def _column(scan: Scan, columns: int) -> np.ndarray:
    return np.rint(scan.offset_ns / 1e8 * columns).astype(int)


def _in_world(scan: Scan, R_W_L: Array, p_W: Array) -> Array:
    column = _column(scan, len(p_W))
    return np.einsum("nij,nj->ni", R_W_L[column], scan.points) + p_W[column]


def _distances(points: Array) -> Array:
    """Return the distance of each point to the nearest triangle of the site; infinity beyond 0.1 m."""
    triangles = SITE.surface.vertices[SITE.surface.faces]
    low, high = triangles.min(axis=1) - 0.1, triangles.max(axis=1) + 0.1
    distances = np.full(len(points), np.inf)
    for row, point in enumerate(points):
        near = triangles[np.all((low <= point) & (point <= high), axis=1)]
        if len(near):
            closest = trimesh.triangles.closest_point(near, np.tile(point, (len(near), 1)))
            distances[row] = np.linalg.norm(closest - point, axis=1).min()
    return distances


def test_noiseless_points_lie_on_the_surface() -> None:
    R_W_L, p_W = _poses(256)
    scan = _scanner(**IDEAL).scan(0, R_W_L, p_W, generator(0, "scan"))
    points = _in_world(scan, R_W_L, p_W)
    assert len(points) > 3000
    assert _distances(points[::10]).max() < 1e-3
    assert points[:, 2].max() > 2.0  # the box and the tree are seen too


def test_no_ray_slips_through_the_ground() -> None:
    scanner = Scanner(_lidar(field_of_view_deg=(-80.0, -25.0), columns=1024, **IDEAL), Site(Ground(), Objects()).mesh())
    scan = scanner.scan(0, np.tile(np.eye(3), (1024, 1, 1)), np.tile([0.0, 0.0, 3.0], (1024, 1)), generator(0))
    assert len(scan.points) == 1024 * 32


def test_a_moving_lidar_sees_the_surface_from_where_it_was_at_each_column() -> None:
    R_W_L, p_W = _poses(256, yaw_rate_rad_s=2.0, speed_m_s=5.0)
    scan = _scanner(**IDEAL).scan(0, R_W_L, p_W, generator(0, "scan"))
    assert _distances(_in_world(scan, R_W_L, p_W)[::10]).max() < 1e-3
    frozen = _distances(_in_world(scan, np.tile(R_W_L[0], (256, 1, 1)), np.tile(p_W[0], (256, 1)))[::10])
    assert np.mean(frozen > 0.01) > 0.3


def test_range_noise_acts_along_the_ray_with_its_sigma() -> None:
    R_W_L, p_W = _poses(256)
    ideal = _scanner(**IDEAL).scan(0, R_W_L, p_W, generator(0, "scan"))
    for seed in range(3):
        noisy = _scanner(range_noise_m=0.05, dropout_ratio=0.0).scan(0, R_W_L, p_W, generator(seed, "scan"))
        assert len(noisy.points) == len(ideal.points)
        rays = ideal.points / np.linalg.norm(ideal.points, axis=1, keepdims=True)
        error = noisy.points - ideal.points
        along = np.sum(error * rays, axis=1)
        assert np.sqrt(np.mean(along**2)) == pytest.approx(0.05, rel=0.05)
        assert abs(along.mean()) < 0.05 * 4.0 / np.sqrt(len(along))
        assert np.linalg.norm(error - along[:, None] * rays, axis=1).max() < 1e-5


def test_the_share_that_drops_out_is_that_of_the_datasheet() -> None:
    R_W_L, p_W = _poses(256)
    ideal = len(_scanner(**IDEAL).scan(0, R_W_L, p_W, generator(0, "scan")).points)
    scanner = _scanner(range_noise_m=0.0, dropout_ratio=0.2)
    for seed in range(3):
        lost = ideal - len(scanner.scan(0, R_W_L, p_W, generator(seed, "scan")).points)
        assert lost == pytest.approx(0.2 * ideal, abs=4.0 * np.sqrt(0.16 * ideal))


def test_returns_out_of_range_are_lost() -> None:
    R_W_L, p_W = _poses(256)
    every = np.linalg.norm(_scanner(**IDEAL).scan(0, R_W_L, p_W, generator(0)).points, axis=1)
    scan = _scanner(min_range_m=5.0, max_range_m=9.0, **IDEAL).scan(0, R_W_L, p_W, generator(0))
    distance = np.linalg.norm(scan.points, axis=1)
    assert every.min() < 4.0
    assert every.max() > 10.0
    assert distance == pytest.approx(every[(every >= 5.0) & (every <= 9.0)])


def test_a_rosette_looks_ahead_within_its_cone_and_never_the_same_way_again() -> None:
    scanner = _scanner(pattern="rosette", channels=1, columns=2048, field_of_view_deg=(-60.0, 20.0), **IDEAL)
    poses = np.tile(np.eye(3), (2048, 1, 1)), np.tile([0.0, 0.0, 2.5], (2048, 1))
    rays = []
    for k in range(2):
        points = scanner.scan(k, *poses, generator(0, "scan")).points
        rays.append(points / np.linalg.norm(points, axis=1, keepdims=True))
        axis = np.array([np.cos(np.radians(20.0)), 0.0, -np.sin(np.radians(20.0))])
        off_deg = np.degrees(np.arccos(np.minimum(rays[-1] @ axis, 1.0)))
        assert 35.0 < off_deg.max() < 40.1
        assert off_deg.min() < 3.0
    again = (rays[0] @ rays[1].T).max(axis=1) > np.cos(np.radians(0.02))
    assert again.mean() < 0.05


def test_rays_go_clockwise_from_behind_and_downwards() -> None:
    lidar = _lidar(field_of_view_deg=(-40.0, -30.0), columns=64, channels=11, **IDEAL)
    scanner = Scanner(lidar, SITE.mesh())
    scan = scanner.scan(7, np.tile(np.eye(3), (64, 1, 1)), np.tile([0.0, 0.0, 2.5], (64, 1)), generator(0))
    assert scan.index == 7
    assert scan.ring.tolist() == list(range(11)) * 64
    assert scan.offset_ns.tolist() == np.repeat(np.rint(np.arange(64) * 1e8 / 64), 11).tolist()
    elevation = np.degrees(np.arctan2(scan.points[:, 2], np.hypot(scan.points[:, 0], scan.points[:, 1])))
    assert elevation == pytest.approx(-30.0 - scan.ring, abs=1e-4)
    azimuth = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    turn = np.remainder(pi - azimuth + 0.01, 2.0 * pi) - 0.01
    assert turn == pytest.approx(2.0 * pi * scan.offset_ns / 1e8, abs=1e-5)


def test_columns_are_spread_over_the_period() -> None:
    times = _scanner(columns=100, rate_hz=20.0).column_times_s(3.0)
    assert times == pytest.approx(3.0 + np.arange(100) * 0.05 / 100)


def test_equal_seeds_give_equal_bytes_and_other_seeds_do_not() -> None:
    R_W_L, p_W = _poses(256)
    scans = [_scanner().scan(0, R_W_L, p_W, generator(seed, "scan")) for seed in (1, 1, 2)]
    first, second, third = (encode_points(scan, 5, "lidar") for scan in scans)
    assert first == second
    assert first != third


def test_what_a_scan_sees_does_not_change_the_numbers_of_the_next() -> None:
    R_W_L, p_W = _poses(256)
    states = []
    for height_m in (0.0, 500.0):
        rng = generator(3, "scan")
        _scanner().scan(0, R_W_L, p_W + np.array([0.0, 0.0, height_m]), rng)
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]


def test_a_missing_embreex_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(ConfigError, match=r"needs embreex: pip install -e '\.\[sim\]' in the checkout"):
        _scanner()


def _cloud(scan: Scan, stamp_ns: int, frame_id: str, point_times: bool) -> Any:
    """Return the message that `encode_points` serialises, built from rosbags' classes."""
    types = STORE.types
    field = types["sensor_msgs/msg/PointField"]
    fields = [field(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate("xyz")]
    columns = [scan.points.astype("<f4").view(np.uint8).reshape(-1, 12)]
    if point_times:
        fields.append(field(name="t", offset=12, datatype=6, count=1))
        columns.append(scan.offset_ns.astype("<u4").view(np.uint8).reshape(-1, 4))
    data = np.concatenate(columns, axis=1)
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return types[POINT_CLOUD_TYPE](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id),
        height=1,
        width=len(data),
        fields=fields,
        is_bigendian=False,
        point_step=data.shape[1],
        row_step=data.size,
        data=data.reshape(-1),
        is_dense=True,
    )


def _random_scan(count: int) -> Scan:
    rng = np.random.default_rng(count)
    points = rng.standard_normal((count, 3)).astype(np.float32)
    return Scan(0, points, np.arange(count, dtype=np.uint32) * 1000, np.zeros(count, dtype=np.uint16))


@given(st.integers(0, 40), st.integers(0, 2**31 * 10**9 - 1), st.text(max_size=12), st.booleans())
@settings(deadline=None, max_examples=60)
def test_bytes_are_those_of_rosbags(count: int, stamp_ns: int, frame_id: str, point_times: bool) -> None:
    scan = _random_scan(count)
    expected = STORE.serialize_cdr(_cloud(scan, stamp_ns, frame_id, point_times), POINT_CLOUD_TYPE)
    assert encode_points(scan, stamp_ns, frame_id, point_times=point_times) == bytes(expected)


def test_rosbags_decodes_the_points() -> None:
    scan = _random_scan(100)
    cloud: Any = STORE.deserialize_cdr(encode_points(scan, 1_700_000_000_123_456_789, "os_lidar"), POINT_CLOUD_TYPE)
    assert (cloud.header.stamp.sec, cloud.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert (cloud.header.frame_id, cloud.height, cloud.width, cloud.is_dense) == ("os_lidar", 1, 100, True)
    layout = np.dtype({"names": [f.name for f in cloud.fields], "formats": ["<f4"] * 3 + ["<u4"], "itemsize": 16})
    points = cloud.data.view(layout)
    assert np.array_equal(np.stack([points[axis] for axis in "xyz"], axis=1), scan.points)
    assert np.array_equal(points["t"], scan.offset_ns)
