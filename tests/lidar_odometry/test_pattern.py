"""Rays that go the same ways in every sweep are told from those that do not, whatever the lidar is made like."""

import numpy as np
import pytest
from yard import spinning, standing, sweep, through_prisms

from holdfast.lidar_odometry.pattern import SWEEPS, Pattern

DISTANCES_M = 3.0, 40.0


def told(sweeps):
    pattern = Pattern()
    for points in sweeps:
        pattern.add(points)
    return pattern.repeats


def rings(rng, elevations_deg, *, columns=1024, phase=0.0, beam_m=0.0, resolution_m=0.0):
    """Points of a revolution before surfaces at any distance; the rays may begin off the centre."""
    elevation, azimuth = np.meshgrid(np.radians(elevations_deg), 2 * np.pi * (np.arange(columns) + phase) / columns)
    level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1).reshape(-1, 3)
    rays = level * np.cos(elevation).reshape(-1, 1)
    rays[:, 2] = np.sin(elevation).ravel()
    points = beam_m * level + rays * rng.uniform(*DISTANCES_M, len(rays))[:, None]
    return np.round(points / resolution_m) * resolution_m if resolution_m else points


LIDARS = {
    "16 rings": {"elevations_deg": np.linspace(-15, 15, 16)},
    "128 rings that begin 3 cm off the centre": {"elevations_deg": np.linspace(-22.5, 22.5, 128), "beam_m": 0.03},
    "64 rings to 4 mm": {"elevations_deg": np.linspace(-24.8, 2.0, 64), "resolution_m": 0.004},
    "28 rings, unevenly": {"elevations_deg": np.concatenate([np.linspace(-25, -6, 8), np.linspace(-5, 3, 20)])},
}


@pytest.mark.parametrize("lidar", LIDARS.values(), ids=LIDARS)
def test_rings_repeat_whatever_the_azimuth_at_which_a_revolution_begins(lidar):
    rng = np.random.default_rng(1)
    assert told(rings(rng, phase=rng.uniform(), **lidar) for _ in range(4))


def test_rays_through_prisms_do_not_repeat():
    rng = np.random.default_rng(2)
    assert not told(through_prisms(rng).reshape(-1, 3) for _ in range(4))


def test_nor_where_the_lidar_looks_around():
    rng = np.random.default_rng(3)
    assert not told(rings(rng, rng.uniform(-7, 52, 40), columns=512) for _ in range(4))


def test_in_a_yard_both_are_told():
    rng = np.random.default_rng(4)
    assert told(sweep(k, rng, standing, rays=spinning()).points for k in range(3))
    assert not told(sweep(k, rng, standing, rays=through_prisms(rng)).points for k in range(3))


def test_until_two_sweeps_were_seen_and_where_all_is_covered_the_rays_are_taken_to_repeat():
    rng = np.random.default_rng(5)
    assert told([])
    assert told([through_prisms(rng).reshape(-1, 3)])
    assert told([np.zeros((0, 3))])
    assert told(through_prisms(rng, 3000).reshape(-1, 3) for _ in range(2))


def test_only_the_first_sweeps_tell():
    rng = np.random.default_rng(6)
    pattern = Pattern()
    for _ in range(SWEEPS + 1):
        pattern.add(through_prisms(rng).reshape(-1, 3))
    same = spinning().reshape(-1, 3)
    for _ in range(30):
        pattern.add(same)
    assert not pattern.repeats
