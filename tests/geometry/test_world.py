"""W: placed by whoever asks for it, else by the first point."""

import numpy as np

from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.geometry.world import World

HERE = Geodetic(47.4, 8.5, 450.0)
ABOVE = Geodetic(47.4, 8.5, 460.0)
OFF = Geodetic(47.4, -10.0, 0.0)


def test_there_is_no_datum_until_the_first_point_sets_it():
    world = World()
    assert world.datum is None and world.frame is None
    np.testing.assert_allclose(world.to_enu(HERE), 0.0, atol=1e-9)
    assert world.datum == HERE
    np.testing.assert_allclose(world.to_enu(ABOVE), [0.0, 0.0, 10.0], atol=1e-6)
    assert world.datum == HERE


def test_until_it_is_settled_w_follows_three_points_that_agree():
    world = World()
    world.to_enu(OFF)
    for _ in range(2):
        world.to_enu(HERE)
        assert world.datum == OFF
    np.testing.assert_allclose(world.to_enu(HERE), 0.0, atol=1e-9)
    assert world.datum == HERE
    world.settle()
    for _ in range(5):
        world.to_enu(OFF)
    assert world.datum == HERE


def test_w_cannot_be_settled_before_it_is_anywhere():
    world = World()
    world.settle()
    for point in (OFF, HERE, HERE, HERE):
        world.to_enu(point)
    assert world.datum == HERE


def test_points_that_do_not_agree_move_nothing():
    world = World()
    for longitude in range(5):
        world.to_enu(HERE)
        world.to_enu(HERE._replace(longitude_deg=float(longitude)))
        world.to_enu(HERE._replace(longitude_deg=-1.0 - longitude))
    assert world.datum == HERE


def test_points_on_both_sides_of_the_date_line_are_near():
    world = World()
    world.to_enu(HERE._replace(longitude_deg=179.99))
    for _ in range(4):
        world.to_enu(HERE._replace(longitude_deg=-179.99))
    assert world.datum == HERE._replace(longitude_deg=179.99)


def test_axes_are_those_of_the_last_points_but_not_of_an_outlier():
    world = World()
    np.testing.assert_array_equal(world.axes, np.eye(3))
    world.place(OFF)
    np.testing.assert_array_equal(world.axes, np.eye(3))
    world.to_enu(HERE)
    expected = LocalFrame(OFF).axes_at(HERE)
    assert np.degrees(np.arccos(expected[2, 2])) > 10.0
    world.to_enu(OFF)
    np.testing.assert_array_equal(world.axes, expected)
    for _ in range(2):
        world.to_enu(OFF)
    np.testing.assert_allclose(world.axes, np.eye(3), atol=1e-15)


def test_a_datum_that_is_given_stays_whatever_comes_and_may_be_moved():
    world = World()
    world.place(HERE)
    for _ in range(5):
        world.to_enu(OFF)
    assert world.datum == HERE
    world.place(ABOVE)
    np.testing.assert_allclose(world.to_enu(HERE), [0.0, 0.0, -10.0], atol=1e-6)
