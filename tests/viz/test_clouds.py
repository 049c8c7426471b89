"""Scans in a scene: the map is where they have hit, also while the cabin slews."""

import sys
from pathlib import Path

import numpy as np

sys.path += [str(Path(__file__).parents[1] / name) for name in ("recording", "lidar_odometry")]

from bags import HUMBLE
from yard import START_NS, T_W_L, cloud, message, standing, sweep

from holdfast.viz.clouds import MAP_POINTS, Clouds


class Recording:
    """Keeps what is drawn."""

    def __init__(self):
        self.drawn = {}

    def log(self, entity, archetype):
        self.drawn[entity] = np.array(archetype.positions.as_arrow_array().to_pylist())


def slewing(t):
    return 0.6 * np.asarray(t)


def row(pose):
    return np.concatenate([pose.translation(), pose.rotation().toQuaternion().coeffs()])


def drawn(angle):
    """What is drawn of the second sweep of a lidar on a cabin, whose transforms come at 20 Hz."""
    clouds, recording = Clouds(), Recording()
    for k in range(12):
        clouds.add_transform("map", "cabin", START_NS + k * 50_000_000, row(T_W_L(0.05 * k, angle)))
    clouds.add_transform("cabin", "lidar", 0, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    swept = sweep(1, np.random.default_rng(1), angle, noise_m=0.0)
    entity = clouds.draw(recording, "/map/cabin/lidar/points", message(HUMBLE, swept))
    return entity, recording.drawn


def test_the_ground_stays_flat_and_the_walls_stay_where_they_are_while_the_cabin_slews():
    for angle in (standing, slewing):
        entity, found = drawn(angle)
        points = found[entity]
        assert entity == "/map/local_map/lidar" and 0 < len(points) <= MAP_POINTS
        assert points[:, 2].min() > -1e-3
        west = points[(points[:, 0] < -24.0) & (np.abs(points[:, 1]) < 15.0) & (points[:, 2] > 0.5)]
        # a piece of 12.5 ms at 0.6 rad/s and 30 m is 0.11 m at either side of its middle
        assert len(west) > 5 and np.abs(west[:, 0] + 25.0).max() < 0.15


def test_the_current_scan_is_drawn_in_the_frame_of_its_lidar():
    _, found = drawn(slewing)
    points = found["/map/cabin/lidar/points"]
    assert np.abs(points[:, 2].min() + 3.0) < 0.01  # the ground below the lidar


def test_without_transforms_there_is_no_map_and_what_is_no_cloud_is_passed_over():
    clouds, recording = Clouds(), Recording()
    swept = sweep(1, np.random.default_rng(1), standing)
    assert clouds.draw(recording, "/lidar/points", message(HUMBLE, swept)) is None
    assert set(recording.drawn) == {"/lidar/points"}
    broken = cloud(HUMBLE, START_NS, [("x", "f4", [1.0])])
    assert clouds.draw(recording, "/other", broken) is None
    assert "/other" not in recording.drawn
