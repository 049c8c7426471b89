"""Claims about the open sky, judged by hand and by casting the same rays against triangles."""

import numpy as np
import pytest
import trimesh

from holdfast.messages import Array
from holdfast.sim.scenario import Box, Ground, Objects, Tree
from holdfast.sim.site import Site
from holdfast.sim.sky import DIRECTIONS, MASK_DEG, sky_directions
from holdfast.sim.surface import block_surface

FLAT = Ground(undulation_m=0.0, roughness_m=0.0)


def _view(objects: Objects, *points: tuple[float, float, float]) -> Array:
    return Site(FLAT, objects).sky_view(np.array(points))


def test_directions_weight_the_sky_with_the_sine_of_the_elevation() -> None:
    directions = sky_directions()
    assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(DIRECTIONS))
    elevation = np.arcsin(directions[:, 2])
    assert np.degrees(elevation.min()) > MASK_DEG
    # the density sin(e) cos(e) de of sin^2(e) is uniform
    grid = np.radians(np.linspace(MASK_DEG, 90.0, 10_001))
    density = np.sin(grid) * np.cos(grid)
    assert elevation.mean() == pytest.approx(np.sum(grid * density) / np.sum(density), rel=1e-3)
    assert np.abs(directions[:, :2].mean(axis=0)).max() < 0.01


def test_open_ground_sees_the_whole_sky() -> None:
    far = Objects(trees=(Tree(center_m=(70.0, 0.0)),), boxes=(Box(center_m=(-60.0, 0.0), size_m=(9.0, 9.0, 5.0)),))
    assert _view(far, (0.0, 0.0, 3.0), (5.0, 5.0, 1.0)).tolist() == [1.0, 1.0]


def test_little_sky_is_left_under_a_crown_and_more_away_from_it() -> None:
    tree = Objects(trees=(Tree(center_m=(0.0, 0.0), height_m=12.0, crown_radius_m=4.0),))
    view = _view(tree, (0.0, 0.0, 3.4), (4.0, 0.0, 2.5), (8.0, 0.0, 2.5), (16.0, 0.0, 2.5), (60.0, 0.0, 2.5))
    assert view[0] < 0.15
    assert np.all(np.diff(view) > 0.0)
    assert view[-1] == 1.0


def test_inside_a_crown_there_is_no_sky() -> None:
    tree = Objects(trees=(Tree(center_m=(0.0, 0.0), height_m=12.0, crown_radius_m=4.0),))
    assert _view(tree, (0.5, 0.5, 8.0))[0] == 0.0


def test_a_high_wall_takes_half_of_the_sky() -> None:
    wall = Objects(boxes=(Box(center_m=(0.0, 50.0), size_m=(2000.0, 99.8, 300.0), yaw_deg=0.0),))
    assert _view(wall, (0.0, 0.0, 3.0))[0] == pytest.approx(0.5, abs=0.02)


def test_a_building_that_ends_below_the_antenna_takes_no_sky() -> None:
    low = Objects(boxes=(Box(center_m=(2.0, 0.0), size_m=(3.0, 8.0, 2.5)),))
    assert _view(low, (0.0, 0.0, 3.0))[0] == 1.0


def _cast(mesh: trimesh.Trimesh, points: Array) -> Array:
    """Return the open share over points by casting the same directions against triangles."""
    directions = sky_directions()
    origins = np.repeat(points, len(directions), axis=0)
    hit = mesh.ray.intersects_any(origins, np.tile(directions, (len(points), 1)))
    return 1.0 - np.asarray(hit).reshape(len(points), -1).mean(axis=1)


def _around(count: int) -> Array:
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(-25.0, 25.0, (count, 2)), rng.uniform(1.0, 9.0, count)])


@pytest.mark.parametrize("roof_m", [0.0, 3.0])
def test_blocks_shade_as_their_triangles_do(roof_m: float) -> None:
    boxes = Objects(boxes=(Box(center_m=(1.0, 2.0), size_m=(14.0, 8.0, 5.0), yaw_deg=25.0, roof_m=roof_m),))
    site = Site(FLAT, boxes)
    surface = block_surface(site.blocks[0])
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    points = _around(400)
    expected = _cast(mesh, points)
    assert expected.min() < 0.4
    assert np.abs(site.sky_view(points) - expected).max() < 1.5 / DIRECTIONS
    assert site.sky_view(points).mean() == pytest.approx(expected.mean(), abs=1e-4)


def test_crowns_shade_as_ellipsoids_do() -> None:
    site = Site(FLAT, Objects(trees=(Tree(center_m=(1.0, 2.0), height_m=12.0, crown_radius_m=4.0),)))
    mesh = trimesh.creation.icosphere(subdivisions=5)
    mesh.apply_scale(site.plants[0].crown_half_axes)
    mesh.apply_translation(site.plants[0].crown_center)
    points = _around(400)
    assert np.abs(site.sky_view(points) - _cast(mesh, points)).max() < 2.5 / DIRECTIONS


def test_objects_shade_together_as_one_after_the_other() -> None:
    boxes = (Box(center_m=(0.0, 10.0), size_m=(20.0, 6.0, 9.0)),)
    trees = (Tree(center_m=(0.0, -6.0)), Tree(center_m=(8.0, -5.0)))
    point = (0.0, 0.0, 3.0)
    lost = [1.0 - _view(objects, point)[0] for objects in (Objects(boxes=boxes), Objects(trees=trees))]
    assert min(lost) > 0.05
    assert _view(Objects(boxes=boxes, trees=trees), point)[0] == pytest.approx(1.0 - sum(lost))
