"""Claims about the triangles of a site and the file they are written to."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from holdfast.errors import ConfigError
from holdfast.sim.scenario import Box, Ground, Heap, Objects, Tree, Trench
from holdfast.sim.site import Site
from holdfast.sim.surface import LEAF_SIDE_M, MAX_LEAVES, REGIONS, block_surface, tree_surface

GROUND = Ground(size_m=50.0, slope_deg=(2.0, 1.0))
OBJECTS = Objects(
    heaps=(Heap(center_m=(10.0, 0.0), radius_m=4.0, height_m=2.0),),
    trenches=(Trench(start_m=(-4.0, 5.0), end_m=(4.0, 8.0)),),
    boxes=(Box(center_m=(-10.0, -8.0), size_m=(6.0, 2.5, 2.6), yaw_deg=30.0),),
    trees=(Tree(center_m=(8.0, 12.0)), Tree(center_m=(-8.0, 14.0))),
)


@pytest.fixture(scope="module")
def site() -> Site:
    return Site(GROUND, OBJECTS)


def _faces_of(site: Site, region: str) -> np.ndarray:
    return site.surface.faces[site.regions == REGIONS.index(region)]


def test_every_triangle_has_a_region_and_every_region_has_triangles(site: Site) -> None:
    assert len(site.regions) == len(site.mesh().faces)
    assert set(site.regions.tolist()) == set(range(len(REGIONS)))


def test_ground_heap_and_trench_lie_on_the_terrain(site: Site) -> None:
    faces = np.concatenate([_faces_of(site, region) for region in ("ground", "heap", "trench")])
    x, y, z = site.surface.vertices[np.unique(faces)].T
    assert np.abs(z - site.terrain.height(x, y)).max() < 1e-5
    assert (x.min(), x.max(), y.min(), y.max()) == (-25.0, 25.0, -25.0, 25.0)
    area = 0.5 * np.cross(*(np.diff(site.surface.vertices[faces], axis=1).swapaxes(0, 1)))[:, 2]
    assert area.min() > 0.0  # all point upwards, none is missing
    assert area.sum() == pytest.approx(50.0**2)


def test_heap_and_trench_are_where_they_were_heaped_and_dug(site: Site) -> None:
    for region, sign, least_m in (("heap", 1.0, 1.9), ("trench", -1.0, 1.4)):
        x, y, z = site.surface.vertices[_faces_of(site, region)].mean(axis=1).T
        height = sign * (z - site.terrain.natural_height(x, y))
        assert height.min() > -0.02
        assert height.max() > least_m
    x, y, z = site.surface.vertices[_faces_of(site, "ground")].mean(axis=1).T
    assert np.abs(z - site.terrain.natural_height(x, y)).max() < 0.05


def test_trench_walls_have_fine_triangles(site: Site) -> None:
    corners = site.surface.vertices[_faces_of(site, "trench")]
    side = np.linalg.norm(np.diff(corners[:, [0, 1, 2, 0], :2], axis=1), axis=2)
    assert side.max() < 0.15


def test_boxes_are_closed_bodies_of_their_size_on_the_ground() -> None:
    for roof_m in (0.0, 1.2):
        box = Box(center_m=(3.0, -2.0), size_m=(6.0, 2.5, 2.6), yaw_deg=30.0, roof_m=roof_m)
        site = Site(GROUND, Objects(boxes=(box,)))
        surface = block_surface(site.blocks[0])
        mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        ground_m = float(site.terrain.height(np.array([3.0]), np.array([-2.0]))[0])
        sunk_m = ground_m - mesh.bounds[0, 2]
        assert sunk_m > 0.0
        assert mesh.bounds[1, 2] == pytest.approx(ground_m + 2.6 + roof_m, abs=1e-5)
        assert mesh.volume == pytest.approx(6.0 * 2.5 * (2.6 + sunk_m + roof_m / 2.0), rel=1e-5)
        corners = surface.vertices[:4]
        assert np.all(corners[:, 2] < site.terrain.height(corners[:, 0], corners[:, 1]))


def test_a_tree_is_a_trunk_and_a_shell_of_loose_leaves() -> None:
    site = Site(GROUND, OBJECTS)
    plant = site.plants[0]
    surface = tree_surface(plant, np.random.default_rng(0))
    ground_m = float(site.terrain.height(np.array([8.0]), np.array([12.0]))[0])
    assert surface.vertices[:, 2].max() == pytest.approx(ground_m + 9.0, abs=LEAF_SIDE_M)
    assert surface.vertices[:, 2].min() < ground_m
    leaves = surface.vertices[24:].reshape(-1, 4, 3)
    assert 300 < len(leaves) <= MAX_LEAVES
    sides = np.linalg.norm(np.diff(leaves, axis=1), axis=2)
    assert sides == pytest.approx(np.full_like(sides, LEAF_SIDE_M), rel=0.01)
    depth = np.linalg.norm((leaves.mean(axis=1) - plant.crown_center) / plant.crown_half_axes, axis=1)
    assert 0.59 < depth.min() < 0.65
    assert 0.97 < depth.max() < 1.01
    normals = np.cross(leaves[:, 1] - leaves[:, 0], leaves[:, 2] - leaves[:, 0]) / LEAF_SIDE_M**2
    assert np.abs(np.einsum("ni,nj->ij", normals, normals) / len(leaves) - np.eye(3) / 3.0).max() < 0.04


def test_ply_loads_with_the_same_triangles_and_regions(site: Site, tmp_path: Path) -> None:
    site.write_ply(tmp_path / "site.ply")
    loaded = trimesh.load(tmp_path / "site.ply", process=False)
    assert isinstance(loaded, trimesh.Trimesh)
    assert np.array_equal(loaded.faces, site.mesh().faces)
    assert np.array_equal(loaded.vertices, site.mesh().vertices)
    assert np.array_equal(loaded.metadata["_ply_raw"]["face"]["data"]["region"], site.regions)


def test_equal_seeds_write_equal_bytes_and_other_seeds_do_not(tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        Site(GROUND.model_copy(update={"seed": seed}), OBJECTS).write_ply(tmp_path / name)
    first, second, third = ((tmp_path / name).read_bytes() for name in "abc")
    assert first == second
    assert first != third


def test_a_ground_with_too_many_triangles_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"50000000 triangles .*raise resolution_m 0\.4, lower size_m 2000"):
        Site(Ground(size_m=2000.0), Objects()).mesh()


def test_a_missing_trimesh_is_named(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trimesh", None)
    expected = r"^the mesh of a site needs trimesh: pip install -e '\.\[sim\]' in the checkout"
    with pytest.raises(ConfigError, match=expected):
        site.mesh()


@pytest.mark.parametrize("size", [(9.0, 2.5), (24.0, 7.0)])
def test_somewhat_more_than_half_of_the_rays_into_a_crown_end_there(size: tuple[float, float]) -> None:
    tree = Tree(center_m=(0.0, 0.0), height_m=size[0], crown_radius_m=size[1], trunk_radius_m=0.05)
    plant = Site(GROUND, Objects(trees=(tree,))).plants[0]
    surface = tree_surface(plant, np.random.default_rng(0))
    disc = np.random.default_rng(1).uniform(-1.0, 1.0, (5000, 2))
    disc = disc[np.sum(disc**2, axis=1) < 1.0]
    origins = plant.crown_center + np.insert(disc, 0, -3.0, axis=1) * plant.crown_half_axes
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    hit = mesh.ray.intersects_any(origins, np.tile([1.0, 0.0, 0.0], (len(disc), 1)))
    assert 0.5 < np.mean(hit) < 0.65
