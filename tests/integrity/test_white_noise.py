"""Which part of a claim is white, learnt from the differences of successive measurements."""

import numpy as np
import pytest
from motion import ARM, Drive, machine, ns
from rig import Rig, position

from holdfast.integrity.white_noise import WhiteNoise
from holdfast.sensors.noise import Colour

DRIVE = Drive(start_s=-3.0)
COLOUR = Colour(0.5, 0.5, 60.0)


def learnt(white_m, slow_m, period_s=0.05):
    """What is learnt from 12 s of fixes with a white and a constant error, and the motion of the truth."""
    rig, rng, white = Rig(DRIVE, machine(lidar=False), 12.0), np.random.default_rng(1), WhiteNoise()
    slow = slow_m * rng.standard_normal(3)
    sensor, smoother = rig.sensors["gnss"], rig.graph.main
    for t in np.arange(0.1, 12.0, period_s):
        measured = position(DRIVE, t, ARM, slow + white_m * rng.standard_normal(3), sigma_m=0.01)
        smoother.node(ns(t))
        white.learn(sensor, measured, COLOUR, smoother, smoother.state_at(ns(t)))
        smoother.optimise()
    return white.colour(COLOUR, 1.0)


@pytest.mark.parametrize("white_m", [0.003, 0.007])
def test_the_white_part_is_what_successive_fixes_differ_by_and_the_rest_of_the_claim_is_slow(white_m):
    colour = learnt(white_m, 0.02)
    assert colour.white == pytest.approx((white_m / 0.01) ** 2, rel=0.35)
    assert colour.white + colour.slow == pytest.approx(1.0)


def test_a_claim_is_never_all_white_nor_all_slow():
    assert learnt(0.05, 0.0).white == pytest.approx(0.9)
    assert learnt(0.0, 0.0).white == pytest.approx(0.05)


def test_nothing_is_learnt_across_seconds():
    assert learnt(0.003, 0.0, period_s=1.0) == COLOUR
