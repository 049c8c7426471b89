"""Maps are as wrong as the poses they are made with, and distances to the surface are exact."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.errors import ConfigError, RecordingError
from holdfast.evaluation.mapping import MapOptions, MapScan, build_map, map_quality, write_map
from holdfast.evaluation.mesh import Mesh, SurfaceIndex, read_mesh
from holdfast.state import Trajectory

trimesh = pytest.importorskip("trimesh")

ROOM_M = np.array([12.0, 8.0, 3.0])
T_I_L = np.array([[0.0, -1.0, 0.0, 0.4], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 1.1], [0.0, 0.0, 0.0, 1.0]])
SWEEP_NS = 200_000_000
BOUND_M = 1e-5  # float32 of the points, 12 m away


def room() -> Mesh:
    """A box seen from inside: floor, walls and ceiling are regions."""
    box = trimesh.creation.box(extents=2.0 * ROOM_M)
    normals = np.abs(box.face_normals)
    regions = np.where(normals[:, 2] > 0.5, np.where(box.triangles_center[:, 2] < 0.0, 0, 2), 1)
    return Mesh(np.array(box.vertices), np.array(box.faces), regions, ("floor", "wall", "ceiling"))


@pytest.fixture(scope="module")
def surface() -> SurfaceIndex:
    return SurfaceIndex(room())


def yaw_rotation(yaw: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(yaw)
    return np.stack([zero, zero, np.sin(yaw / 2.0), np.cos(yaw / 2.0)], axis=-1)


def motion(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drive at 2 m/s while slewing at 1 rad/s: positions (N, 3) and yaw (N,)."""
    return np.column_stack([2.0 * times_s - 2.0, 0.5 * times_s, 0.0 * times_s]), times_s


def drive(shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Trajectory:
    stamps = np.arange(0, 2_000_000_001, 10_000_000)
    positions, yaw = motion(stamps * 1e-9)
    return Trajectory(stamps, positions + np.array(shift), yaw_rotation(yaw))


def sweeps(count: int = 9, points: int = 2000) -> list[MapScan]:
    """What a lidar on the drive sees of the room: each point in L at its own time."""
    rng = np.random.default_rng(3)
    scans = []
    for k in range(count):
        offsets = np.sort(rng.integers(0, SWEEP_NS, points))
        positions, yaw = motion((k * SWEEP_NS + offsets) * 1e-9)
        R = np.zeros((points, 3, 3))
        R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1] = np.cos(yaw), -np.sin(yaw), np.sin(yaw), np.cos(yaw)
        R[:, 2, 2] = 1.0
        R_W_L = R @ T_I_L[:3, :3]
        origins = positions + R @ T_I_L[:3, 3]
        rays = rng.standard_normal((points, 3))
        with np.errstate(divide="ignore"):
            reach = np.min((ROOM_M * np.sign(rays) - origins) / rays, axis=1)
        in_lidar = np.einsum("nji,nj->ni", R_W_L, rays * reach[:, None])
        scans.append(MapScan(k * SWEEP_NS, in_lidar.astype(np.float32), offsets))
    return scans


def test_a_map_from_true_poses_lies_on_the_surface(surface: SurfaceIndex):
    quality = map_quality(sweeps(), drive(), surface, T_I_L)
    # the trajectory is given every 10 ms; between, 1 rad/s at 2 m/s bends a chord by less than 2 * 1 * 0.01^2 / 8 m
    assert quality.distances.max() < 2.0 * 1.0 * 0.01**2 / 8.0 + BOUND_M
    assert quality.closeness["all"].fraction_within == 1.0
    assert quality.map.scans == 9
    assert quality.map.left_out == 0


def test_every_point_is_moved_to_its_own_time(surface: SurfaceIndex):
    frozen = [replace(scan, offsets_ns=np.zeros_like(scan.offsets_ns)) for scan in sweeps()]
    skewed = map_quality(frozen, drive(), surface, T_I_L).closeness["wall"]
    # half of a sweep later the machine has driven 0.2 m and turned by 0.1 rad, 0.8 m at the nearer walls
    assert skewed.median_m > 0.1


def test_poses_that_are_too_high_show_in_floor_and_ceiling_by_as_much(surface: SurfaceIndex):
    lifted = map_quality(sweeps(), drive(shift=(0.0, 0.0, 0.1)), surface, T_I_L).closeness
    assert lifted["floor"].median_m == pytest.approx(0.1, abs=2e-4)
    assert lifted["ceiling"].median_m == pytest.approx(0.1, abs=2e-4)
    assert lifted["floor"].fraction_within < 0.05  # only where the floor meets a wall
    assert lifted["wall"].median_m < 1e-3


def test_scans_that_are_wrong_later_are_not_hidden_by_earlier_ones(surface: SurfaceIndex):
    good, shifted = drive(), drive(shift=(0.0, 0.0, 0.1))
    late = good.stamps_ns > 900_000_000
    mixed = replace(good, positions=np.where(late[:, None], shifted.positions, good.positions))
    floor = map_quality(sweeps(), mixed, surface, T_I_L).closeness["floor"]
    # 4.5 of 9 scans lie 0.1 m too high and fall into the same voxels, or into those above
    assert floor.fraction_within == pytest.approx(0.5, abs=0.1)


def test_how_often_a_place_was_seen_does_not_change_the_verdict(surface: SurfaceIndex):
    fractions = []
    for repeats in (1, 5):
        times = np.arange(0, 8 * repeats * SWEEP_NS + 1, 10_000_000)
        lifted = (times // SWEEP_NS) % 8 == 3  # one scan in eight is 0.5 m too high, in voxels of its own
        positions = np.where(lifted[:, None], [0.0, 0.0, 0.5], 0.0)
        still = Trajectory(times, positions, yaw_rotation(np.zeros(len(times))))
        rng = np.random.default_rng(1)
        scans = []
        for k in range(8 * repeats):
            floor = np.column_stack([rng.uniform(-7.0, 7.0, (2000, 2)), np.full(2000, -3.0)])
            middle = np.full(2000, SWEEP_NS // 2)
            scans.append(MapScan(k * SWEEP_NS, floor.astype(np.float32), middle))
        fractions.append(map_quality(scans, still, surface, np.eye(4)).closeness["all"].fraction_within)
    # 16 000 points or more, of which one in eight is wrong: the fraction is known to 0.3 %
    assert fractions == pytest.approx([7.0 / 8.0] * 2, abs=0.02)


def test_scans_without_poses_are_left_out_and_counted(surface: SurfaceIndex):
    whole = drive()
    kept = (whole.stamps_ns < 500_000_000) | (whole.stamps_ns >= 1_000_000_000)
    gap = Trajectory(whole.stamps_ns[kept], whole.positions[kept], whole.quaternions[kept])
    quality = map_quality(sweeps(), gap, surface, T_I_L)
    # those that touch 0.5 to 1.0 s: the third to the fifth
    assert (quality.map.scans, quality.map.left_out) == (6, 3)


def test_a_trajectory_of_another_time_gives_no_map_but_says_so(surface: SurfaceIndex):
    later = replace(drive(), stamps_ns=drive().stamps_ns + 10**12)
    with pytest.raises(RecordingError, match="covers none of the 9 scans"):
        map_quality(sweeps(), later, surface, T_I_L)


def test_one_point_of_every_voxel_is_kept():
    options = MapOptions(voxel_m=0.5)
    voxels = build_map(sweeps(), drive(), T_I_L, options)
    cells = np.floor(voxels.points / 0.5)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert voxels.counts.sum() == 9 * 2000


def test_the_view_from_above_has_north_on_top_and_holes_where_nothing_is(surface: SurfaceIndex):
    still = Trajectory(np.array([0, 100_000_000]), np.zeros((2, 3)), yaw_rotation(np.zeros(2)))
    on_the_floor, half_a_metre_above = (3.1, 5.1, -3.0), (-4.9, -6.9, -2.5)
    scan = MapScan(0, np.array([on_the_floor, half_a_metre_above], dtype=np.float32), np.zeros(2, dtype=np.int64))
    view = map_quality([scan], still, surface, np.eye(4), MapOptions(pixel_m=1.0)).view
    assert view.corner == (-5.0, -7.0)
    assert view.errors.shape == (13, 9)
    assert view.errors[0, -1] == pytest.approx(0.0, abs=BOUND_M)
    assert view.errors[-1, 0] == pytest.approx(0.5, abs=BOUND_M)
    assert np.isfinite(view.errors).sum() == 2


def test_distances_equal_those_of_another_implementation():
    rng = np.random.default_rng(5)
    body = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    vertices = np.array(body.vertices) * np.array([1.0, 0.3, 2.0]) + rng.normal(0.0, 0.05, body.vertices.shape)
    mesh = trimesh.Trimesh(vertices, body.faces, process=False)
    index = SurfaceIndex(Mesh(vertices, np.array(body.faces), np.zeros(len(body.faces), dtype=np.int64), ("all",)))
    points = rng.uniform(-4.0, 4.0, (2000, 3))
    theirs = np.full(len(points), np.inf)
    for corners in mesh.triangles:
        closest = trimesh.triangles.closest_point(np.repeat(corners[None], len(points), axis=0), points)
        theirs = np.minimum(theirs, np.linalg.norm(closest - points, axis=1))
    ours, _ = index.nearest(points)
    near = theirs < 1.0
    assert near.sum() > 500
    assert np.abs(ours - theirs)[near].max() < 1e-9
    assert (ours - theirs).min() > -1e-9
    assert (ours - theirs).max() <= index.radius_m


@pytest.mark.parametrize(
    ("point", "distance"),
    [((0.2, 0.2, 0.5), 0.5), ((0.5, -2.0, 0.0), 2.0), ((-3.0, -4.0, 0.0), 5.0), ((1.0, 1.0, 1.0), np.sqrt(1.5))],
)
def test_the_nearest_point_of_a_triangle_may_be_inside_on_an_edge_or_a_corner(point, distance):
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    index = SurfaceIndex(Mesh(corners, np.array([[0, 1, 2]]), np.zeros(1, dtype=np.int64), ("all",)))
    assert index.nearest(np.array([point]))[0][0] == pytest.approx(distance, abs=1e-12)


def test_the_mesh_of_a_simulated_site_is_read_with_its_regions(tmp_path: Path):
    from holdfast.sim.scenario import load_scenario
    from holdfast.sim.site import Site

    scenario = load_scenario("quick")
    site = Site(scenario.ground, scenario.objects)
    site.write_ply(tmp_path / "site.ply")
    mesh = read_mesh(tmp_path / "site.ply")
    assert mesh.names == ("ground", "heap", "trench", "box", "tree")
    np.testing.assert_array_equal(mesh.vertices, site.surface.vertices)
    np.testing.assert_array_equal(mesh.faces, site.surface.faces)
    np.testing.assert_array_equal(mesh.regions, site.regions)


@pytest.mark.parametrize("damage", ["cut", "text", "none"])
def test_a_file_that_is_no_mesh_is_refused_by_name(tmp_path: Path, damage: str):
    from holdfast.sim.scenario import load_scenario
    from holdfast.sim.site import Site

    file = tmp_path / "site.ply"
    if damage == "cut":
        scenario = load_scenario("quick")
        Site(scenario.ground, scenario.objects).write_ply(file)
        file.write_bytes(file.read_bytes()[:-100])
    elif damage == "text":
        file.write_text("ply\nformat ascii 1.0\nend_header\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"site\.ply"):
        read_mesh(file)


def test_a_map_is_written_so_that_others_can_read_it(surface: SurfaceIndex, tmp_path: Path):
    quality = map_quality(sweeps(), drive(), surface, T_I_L)
    write_map(quality, tmp_path / "map.ply")
    cloud = trimesh.load(tmp_path / "map.ply")
    np.testing.assert_allclose(cloud.vertices, quality.map.points, atol=BOUND_M)


@pytest.mark.parametrize("wrong", [{"voxel_m": 0.0}, {"max_points_per_scan": 0}, {"pixel_m": float("nan")}])
def test_options_with_which_no_map_can_be_made_are_refused(wrong: dict[str, float]):
    with pytest.raises(ConfigError, match="must be positive"):
        MapOptions(**wrong)
