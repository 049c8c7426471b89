"""Two antennas are as far apart as they are mounted, or the worse of two simultaneous positions is wrong."""

from types import SimpleNamespace

import gtsam
import numpy as np
import pytest

from holdfast.integrity.baseline import BaselineTest
from holdfast.integrity.lever_arms import PAIRED_NS, LeverArms
from holdfast.sensors.sensor import Position, Role

ARMS = {"left": np.zeros(3), "right": np.array([0.0, -2.0, 0.0]), "mast": np.array([0.0, 0.0, 3.0])}
RIGHT = np.array([0.0, -2.0, 0.0])


def new_test():
    receivers = {name: SimpleNamespace(name=name, role=Role.POSITION, p_I_P=arm) for name, arm in ARMS.items()}
    return BaselineTest(LeverArms(receivers))


def position(sensor, p_W_P, stamp_ns=0, sigma_m=0.01):
    return Position(stamp_ns, sensor, np.asarray(p_W_P, dtype=float), np.eye(3) * sigma_m**2, 0.0)


def contradicted(one, other, nis=(1.0, 2.0)):
    """Which of two is the worse one, or None."""
    test = new_test()
    assert test.contradicted(one, nis[0], gtsam.Rot3()) is None
    return test.contradicted(other, nis[1], gtsam.Rot3())


@pytest.mark.parametrize("direction", [[0.0, -2.0, 0.0], [2.0, 0.0, 0.0], [1.2, 0.0, 1.6]])
def test_antennas_as_far_apart_as_mounted_agree_whatever_the_attitude(direction):
    assert contradicted(position("left", np.zeros(3)), position("right", direction)) is None


@pytest.mark.parametrize(("off_m", "is_wrong"), [(0.07, False), (0.08, True), (-0.08, True)])
def test_a_distance_beyond_four_sigma_and_the_slack_of_the_mounting_is_wrong(off_m, is_wrong):
    """4 sqrt(2) cm and 2 cm are 7.7 cm."""
    wrong = position("right", RIGHT * (1.0 + off_m / 2.0))
    assert (contradicted(position("left", np.zeros(3)), wrong) is not None) == is_wrong


def test_the_worse_one_is_that_with_the_larger_nis_whichever_came_first():
    left, right = position("left", np.zeros(3)), position("right", RIGHT * 2.0)
    assert contradicted(left, right, (1.0, 2.0)) is right
    assert contradicted(left, right, (2.0, 1.0)) is left


def test_positions_of_different_times_and_of_one_antenna_are_not_compared():
    left = position("left", np.zeros(3))
    assert contradicted(left, position("right", RIGHT * 2.0, PAIRED_NS + 1)) is None
    assert contradicted(left, position("right", RIGHT * 2.0, PAIRED_NS)) is not None
    assert contradicted(left, position("left", RIGHT)) is None


def test_each_pair_has_its_own_distance():
    assert contradicted(position("left", np.zeros(3)), position("mast", [0.0, 0.0, 3.0])) is None
    assert contradicted(position("right", RIGHT), position("mast", [0.0, 0.0, 3.0])) is None
    assert contradicted(position("right", RIGHT), position("mast", [0.0, 0.0, 2.0])) is not None
