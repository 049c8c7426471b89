"""W: placed by whoever asks for it, else by the first point."""

import numpy as np

from holdfast.geometry.earth import Geodetic
from holdfast.geometry.world import World

HERE = Geodetic(47.4, 8.5, 450.0)
ABOVE = Geodetic(47.4, 8.5, 460.0)


def test_there_is_no_datum_until_the_first_point_sets_it():
    world = World()
    assert world.datum is None and world.frame is None
    np.testing.assert_allclose(world.to_enu(HERE), 0.0, atol=1e-9)
    assert world.datum == HERE
    np.testing.assert_allclose(world.to_enu(ABOVE), [0.0, 0.0, 10.0], atol=1e-6)
    assert world.datum == HERE


def test_a_datum_that_is_given_stays_whatever_comes_and_may_be_moved():
    world = World()
    world.place(HERE)
    world.to_enu(ABOVE)
    assert world.datum == HERE
    world.place(ABOVE)
    np.testing.assert_allclose(world.to_enu(HERE), [0.0, 0.0, -10.0], atol=1e-6)
