"""The angle of the joint at the times of measurements, as the encoder read it."""

from math import inf, nan, pi

import pytest

from holdfast.chassis.encoder import JointModel
from holdfast.chassis.joint_track import JointTrack
from holdfast.config.sensors import JointConfig
from holdfast.messages import JointAngle

SECOND_NS = 1_000_000_000


def track(readings, **settings):
    """Readings as (seconds, angle)."""
    found = JointTrack(JointModel(JointConfig(kind="joint", topic="/joint", **settings)))
    for t, angle in readings:
        found.add(JointAngle(round(t * SECOND_NS), 0, "joint", angle))
    return found


def at(found, t):
    return found.at(round(t * SECOND_NS))


def test_between_two_readings_the_joint_turns_evenly():
    joint = at(track([(0.0, 1.0), (0.1, 1.2)]), 0.025)
    assert joint == pytest.approx((1.05, 2.0))


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1], [1, 2, 0]])
def test_the_order_in_which_readings_come_does_not_matter(order):
    readings = [(0.0, 0.0), (0.1, 0.1), (0.2, 0.4)]
    assert at(track([readings[k] for k in order]), 0.15) == pytest.approx((0.25, 3.0))


@pytest.mark.parametrize(("t", "is_known"), [(-0.19, True), (-0.21, False), (0.29, True), (0.31, False)])
def test_the_newest_motion_goes_on_for_as_long_as_a_reading_may_be_old(t, is_known):
    assert (at(track([(0.0, 0.0), (0.1, 0.1)]), t) is not None) == is_known


def test_over_a_silence_nothing_is_known():
    assert at(track([(0.0, 0.0), (1.0, 0.1)]), 0.5) is None


@pytest.mark.parametrize("readings", [[], [(0.0, 1.0)], [(0.0, nan), (0.1, inf)]])
def test_two_usable_readings_are_needed(readings):
    assert at(track(readings), 0.0) is None


def test_an_encoder_that_wraps_turns_on():
    joint = at(track([(0.0, pi - 0.1), (0.1, -pi + 0.1)]), 0.05)
    assert joint == pytest.approx((pi, 2.0))


def test_offsets_of_time_and_zero_are_applied():
    found = track([(0.0, 1.0), (0.1, 1.2)], time_offset_s=0.5, zero_offset_deg=90.0)
    assert at(found, 0.55) == pytest.approx((1.1 + pi / 2.0, 2.0))


def test_what_is_long_past_is_forgotten():
    found = track([(0.1 * k, 0.0) for k in range(700)])
    assert at(found, 1.0) is None and at(found, 65.0) is not None
