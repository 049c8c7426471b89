"""The map: every point at its own time and place, what moved left out, and the same whatever the memory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lorry_yard import T_I_L, drive, high_on_lorry, off_the_walls, on_lorry, sweeps

from holdfast.errors import ConfigError, RecordingError
from holdfast.mapping import site_map, sorted_runs
from holdfast.mapping.claims import PoseCovariances
from holdfast.mapping.options import SiteMapOptions
from holdfast.mapping.site_map import MapBuilder, SiteMap
from holdfast.mapping.voxels import CELL_SHIFT, voxel_keys

COUNT, WITH_LORRY = 100, 10
OPTIONS = SiteMapOptions(voxel_m=0.2)


def build(folder: Path, scans, options=OPTIONS, **given) -> SiteMap:
    folder.mkdir(exist_ok=True)
    builder = MapBuilder(folder, given.pop("trajectory", drive(COUNT * 0.2)), T_I_L, options, **given)
    for sweep in scans:
        builder.add(sweep)
    return builder.finish()


def points_of(found: SiteMap) -> np.ndarray:
    return np.concatenate([block["point"] for block in found.blocks()])


@pytest.fixture(scope="module")
def thinned(tmp_path_factory: pytest.TempPathFactory) -> SiteMap:
    return build(tmp_path_factory.mktemp("map"), sweeps(COUNT, WITH_LORRY))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> SiteMap:
    return build(tmp_path_factory.mktemp("map"), sweeps(COUNT, WITH_LORRY), replace(OPTIONS, keep_above=0.0))


def test_every_point_is_moved_to_its_own_time(whole: SiteMap):
    points = points_of(whole)
    walls = points[~on_lorry(points)]
    # float64 all through; between poses 10 ms apart the chord of 0.7 m about I at 0.5 rad/s is off by microns
    assert np.quantile(off_the_walls(walls), 0.98) < 1e-4  # the rest is the foot of the lorry
    assert len(np.unique(voxel_keys(points, OPTIONS.voxel_m))) == len(points) == whole.points


def test_scans_at_one_instant_would_smear_the_walls(tmp_path: Path):
    frozen = (replace(sweep, offsets_s=None) for sweep in sweeps(20, 0))
    found = build(tmp_path, frozen)
    assert found.undeskewed == 20
    assert np.quantile(off_the_walls(points_of(found)), 0.9) > 0.1


def test_what_rays_see_through_later_is_left_out_and_walls_stay(thinned: SiteMap, whole: SiteMap):
    before, after = points_of(whole), points_of(thinned)
    assert on_lorry(before).sum() > 200
    assert on_lorry(after).sum() < 0.4 * on_lorry(before).sum()
    assert high_on_lorry(after).sum() < 0.1 * high_on_lorry(before).sum()  # a foot on the ground stays
    static = (off_the_walls(before) < 1e-3).sum()
    assert (off_the_walls(after) < 1e-3).sum() > 0.995 * static
    assert thinned.thinned == len(before) - len(after)


def test_what_stands_half_the_time_stays(tmp_path: Path):
    half = points_of(build(tmp_path, sweeps(60, 30)))
    assert on_lorry(half).sum() > 200


def test_the_map_is_the_same_however_little_memory_there_is(
    tmp_path: Path, thinned: SiteMap, monkeypatch: pytest.MonkeyPatch
):
    little = sorted_runs.SortedRuns

    class Little(little):
        def __init__(self, *given):
            super().__init__(*given, waiting_rows=5000, block_rows=300)

    monkeypatch.setattr(site_map, "SortedRuns", Little)
    builder = MapBuilder(tmp_path, drive(COUNT * 0.2), T_I_L, OPTIONS)
    for sweep in sweeps(COUNT, WITH_LORRY):
        builder.add(sweep)
    assert len(list(tmp_path.iterdir())) > 2  # it did spill
    assert builder.finish().file.read_bytes() == thinned.file.read_bytes()


def test_scans_beyond_the_trajectory_are_counted_and_none_at_all_is_an_error(tmp_path: Path):
    found = build(tmp_path / "some", sweeps(10, 0), trajectory=drive(1.0))
    assert (found.scans, found.left_out) == (5, 5)
    early = (replace(sweep, stamp_ns=sweep.stamp_ns - 10**12) for sweep in sweeps(3, 0))
    with pytest.raises(RecordingError, match="covers none of the 3 scans"):
        build(tmp_path / "none", early)


def test_a_time_offset_of_the_lidar_is_added_to_its_stamps(tmp_path: Path):
    late = (replace(sweep, stamp_ns=sweep.stamp_ns + 300_000_000) for sweep in sweeps(20, 0))
    found = build(tmp_path, late, offset_ns=-300_000_000)
    assert off_the_walls(points_of(found)).max() < 1e-4


def test_far_points_have_the_larger_sigma_of_an_uncertain_attitude(tmp_path: Path):
    P = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.01**2])[None]  # yaw alone
    found = build(tmp_path, sweeps(20, 0), covariances=PoseCovariances(drive(1.0).stamps_ns[:1], P))
    for block in found.blocks():
        # the yaw turns about I, which drives along y = 0: the error is 0.01 rad times the horizontal distance to it
        at_most = 0.01 * (np.abs(block["point"][:, :2]) + np.array([3.0, 0.0]))
        assert (block["sigma_m"] <= np.hypot(*at_most.T) + 1e-6).all()
        assert (block["sigma_m"] >= 0.01 * np.abs(block["point"][:, 1]) - 1e-6).all()


@pytest.mark.parametrize("given", [{"voxel_m": 0.0}, {"max_range_m": np.nan}, {"keep_above": 1.1}])
def test_options_that_make_no_map_are_refused(given):
    with pytest.raises(ConfigError, match="must be from"):
        SiteMapOptions(**given)


def test_a_sample_is_spread_evenly_over_the_map(thinned: SiteMap):
    sample = thinned.sample(1000)
    everything = np.concatenate(list(thinned.blocks()))
    step = -(-len(everything) // 1000)
    assert np.array_equal(sample, everything[::step])


def test_a_cell_holds_eight_voxels_and_sorting_by_voxel_sorts_by_cell():
    side = np.arange(-4.9, 5.0, 0.2)
    points = np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3)
    keys = voxel_keys(points, 0.5)
    cells = np.floor(points / 1.0).astype(int)
    found, of_point = np.unique(keys >> CELL_SHIFT, return_inverse=True)
    assert len(found) == 1000 == len(np.unique(cells, axis=0))
    assert all(len(np.unique(cells[of_point == k], axis=0)) == 1 for k in range(0, 1000, 97))
    assert len(np.unique(keys)) == 8000
