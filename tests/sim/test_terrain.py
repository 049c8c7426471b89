"""Claims about the ground: heights, their spread and how smooth they are."""

from itertools import pairwise

import numpy as np
import pytest

from holdfast.messages import Array
from holdfast.sim.scenario import Ground, Heap, Objects, Trench
from holdfast.sim.terrain import Terrain

FLAT = Ground(undulation_m=0.0, roughness_m=0.0)
HEAP = Heap(center_m=(10.0, -4.0), radius_m=4.0, height_m=2.0)
PIT = Heap(center_m=(-10.0, -4.0), radius_m=5.0, height_m=-1.5)
TRENCH = Trench(start_m=(0.0, 6.0), end_m=(9.0, 18.0), width_m=1.2, depth_m=1.5)
OBJECTS = Objects(heaps=(HEAP, PIT), trenches=(TRENCH,))
LENGTH_M = 15.0


def test_natural_ground_passes_through_the_origin() -> None:
    for seed in range(5):
        ground = Ground(seed=seed, slope_deg=(3.0, -2.0))
        assert Terrain(ground, Objects()).height(np.zeros(()), np.zeros(())) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("undulation_m", "roughness_m"), [(0.5, 0.0), (0.0, 0.02), (1.0, 0.1)])
def test_heights_spread_as_the_numbers_say(undulation_m: float, roughness_m: float) -> None:
    x, y = np.random.default_rng(0).uniform(-5000.0, 5000.0, (2, 20_000))
    for seed in range(5):
        terrain = Terrain(Ground(seed=seed, undulation_m=undulation_m, roughness_m=roughness_m), Objects())
        assert np.std(terrain.height(x, y)) == pytest.approx(np.hypot(undulation_m, roughness_m), rel=0.05)


def test_hills_have_the_length_that_the_numbers_say() -> None:
    """For waves of number k, mean square slope over mean square height is the mean of k^2."""
    x, y = np.random.default_rng(0).uniform(-5000.0, 5000.0, (2, 20_000))
    for length_m in (20.0, 80.0):
        terrain = Terrain(Ground(undulation_length_m=length_m, roughness_m=0.0), Objects())
        slope = np.hypot(*((terrain.height(x + dx, y + dy) - terrain.height(x, y)) / 0.01 for dx, dy in STEPS))
        mean_length = 2.0 * np.pi * np.std(terrain.height(x, y)) / np.sqrt(np.mean(slope**2))
        assert 0.7 * length_m < mean_length < 1.4 * length_m


STEPS = ((0.01, 0.0), (0.0, 0.01))


def test_slope_rises_to_the_east_and_to_the_north() -> None:
    terrain = Terrain(Ground(slope_deg=(5.0, 2.0), undulation_m=0.0, roughness_m=0.0), Objects())
    assert terrain.height(np.array([100.0]), np.array([0.0]))[0] == pytest.approx(100.0 * np.tan(np.radians(5.0)))
    assert terrain.height(np.array([0.0]), np.array([100.0]))[0] == pytest.approx(100.0 * np.tan(np.radians(2.0)))


def test_heaps_and_pits_have_their_height_at_the_centre_and_none_outside() -> None:
    terrain = Terrain(Ground(slope_deg=(2.0, 1.0)), OBJECTS)
    for heap in (HEAP, PIT):
        east = heap.center_m[0] + np.array([0.0, 0.5 * heap.radius_m, heap.radius_m, heap.radius_m + 1.0])
        north = np.full(4, heap.center_m[1])
        above = terrain.height(east, north) - terrain.natural_height(east, north)
        assert above[0] == pytest.approx(heap.height_m)
        assert 0.2 < above[1] / heap.height_m < 0.8
        assert above[2:] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_trench_has_its_depth_between_the_walls_and_half_of_it_at_them() -> None:
    along, left = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    places = {0.0: 1.5, 0.35: 1.5, 0.6: 0.75, -0.6: 0.75, 0.85: 0.0, -2.0: 0.0}
    points = np.array([along * LENGTH_M / 2.0 + left * across for across in places]) + TRENCH.start_m
    assert -Terrain(FLAT, OBJECTS).height(*points.T) == pytest.approx(list(places.values()), abs=1e-12)


def test_trench_descends_from_both_ends() -> None:
    ways = np.array([-0.5, 0.0, 0.7, 1.5, 2.2, 3.0])
    from_start = np.array([0.6, 0.8]) * ways[:, None] + TRENCH.start_m
    from_end = np.array([0.6, 0.8]) * (LENGTH_M - ways)[:, None] + TRENCH.start_m
    terrain = Terrain(FLAT, OBJECTS)
    depth = -terrain.height(*from_start.T)
    assert depth == pytest.approx(-terrain.height(*from_end.T), abs=1e-12)
    assert depth[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert all(a < b for a, b in pairwise(depth[1:]))
    assert depth[-1] == pytest.approx(1.5)


def _roughest_change(terrain: Terrain, start: Array, end: Array, step_m: float) -> tuple[float, float]:
    """Return the largest curvature on a way [1/m] and its largest change from one step to the next."""
    count = round(float(np.linalg.norm(end - start)) / step_m)
    points = start + np.arange(count)[:, None] / count * (end - start)
    curvature = np.diff(terrain.height(*points.T), 2) / step_m**2
    return float(np.abs(curvature).max()), float(np.abs(np.diff(curvature)).max())


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((4.0, -4.5), (16.0, -4.0)),
        ((-16.0, -3.5), (-4.0, -4.5)),
        ((1.0, 16.0), (8.0, 8.0)),
        ((-1.2, 4.4), (10.2, 19.6)),
    ],
    ids=["heap", "pit", "across trench", "along trench"],
)
def test_curvature_is_continuous_where_heaps_and_trenches_begin(
    start: tuple[float, float], end: tuple[float, float]
) -> None:
    terrain = Terrain(FLAT, OBJECTS)
    bound, coarse = _roughest_change(terrain, np.array(start), np.array(end), 2e-3)
    same_bound, fine = _roughest_change(terrain, np.array(start), np.array(end), 1e-3)
    assert same_bound == pytest.approx(bound, rel=0.01)
    # a jump of the curvature would stay as large as it is, however small the step
    assert fine == pytest.approx(coarse / 2.0, rel=0.1)


def test_height_does_not_depend_on_what_else_is_asked() -> None:
    terrain = Terrain(Ground(), OBJECTS)
    x, y = np.meshgrid(np.linspace(-30.0, 30.0, 150), np.linspace(-30.0, 30.0, 140))
    z = terrain.height(x, y)
    assert z.shape == (140, 150)
    for row, column in ((0, 0), (70, 33), (139, 149)):
        assert terrain.height(x[row, column], y[row, column]) == pytest.approx(z[row, column], abs=1e-12)


def test_seed_makes_the_hills() -> None:
    x, y = np.random.default_rng(0).uniform(-80.0, 80.0, (2, 100))
    heights = [Terrain(Ground(seed=seed), Objects()).height(x, y) for seed in (1, 1, 2)]
    assert np.array_equal(heights[0], heights[1])
    assert np.std(heights[0] - heights[2]) > 0.2
