"""Replays with different datums are compared in one world frame."""

import numpy as np
import pytest

pytest.importorskip("plotly")

from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.replay.reference import in_other_world
from holdfast.state import Trajectory

HERE, THERE = Geodetic(47.0, 8.0, 400.0), Geodetic(47.05, 8.1, 450.0)


def test_a_track_in_another_world_frame_is_at_the_same_points_of_the_earth():
    points = np.array([[0.0, 0.0, 0.0], [100.0, -50.0, 3.0], [2000.0, 1000.0, -20.0]])
    identity = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    track = Trajectory(np.arange(3), points, identity)
    moved = in_other_world(track, HERE, THERE)
    for before, after in zip(points, moved.positions, strict=True):
        expected = LocalFrame(THERE).to_enu(LocalFrame(HERE).to_geodetic(before))
        np.testing.assert_allclose(after, expected, atol=1e-6)
    back = in_other_world(moved, THERE, HERE)
    np.testing.assert_allclose(back.positions, points, atol=1e-6)
    np.testing.assert_allclose(np.abs(back.quaternions), identity, atol=1e-9)


def test_north_of_the_one_is_turned_by_the_convergence_of_the_meridians():
    track = Trajectory(np.arange(1), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    q = in_other_world(track, HERE, THERE).quaternions[0]
    convergence_rad = np.radians(0.1) * np.sin(np.radians(47.025))
    assert 2.0 * abs(q[2]) == pytest.approx(convergence_rad, rel=1e-3)
