"""The encoder: what a reading weighs, and when repeated readings are those of a frozen one."""

from math import inf, nan, pi, radians

import pytest
from compiled import RepeatMonitor

from holdfast.chassis.encoder import JointModel
from holdfast.config.sensors import JointConfig
from holdfast.events import Outcome
from holdfast.messages import JointAngle

SECOND_NS = 1_000_000_000
SIGMA_RAD = 1e-3
SURE = (1e-10, 1e-10)  # of the gyroscopes: 0.01 mrad in a second


def test_a_reading_is_used_with_the_zero_that_is_configured_and_its_noise():
    model = JointModel(
        JointConfig(
            kind="joint", topic="/j", zero_offset_deg=90.0, noise_deg=0.5, zero_offset_sigma_deg=2.0, max_age_s=0.3
        )
    )
    assert model.angle(JointAngle(0, 0, "joint", 1.0)) == pytest.approx(1.0 + pi / 2.0)
    assert (model.variance, model.zero_variance) == pytest.approx((radians(0.5) ** 2, radians(2.0) ** 2))
    assert model.max_age_ns == 300_000_000


@pytest.mark.parametrize(
    ("angle", "outcome"), [(1e6, Outcome.USED), (nan, Outcome.NOT_FINITE), (-inf, Outcome.NOT_FINITE)]
)
def test_a_reading_must_be_finite(angle, outcome):
    assert JointModel(JointConfig(kind="joint", topic="/j")).check(JointAngle(0, 0, "joint", angle)) is outcome


def hidden(readings, noise=SURE):
    """Hidden rotation and whether it is frozen after rows of seconds, reading, and what the gyroscopes have turned."""
    monitor = RepeatMonitor(SIGMA_RAD**2)
    for t, reading, rotation in readings:
        found = monitor.hidden_rotation(round(t * SECOND_NS), reading, rotation, noise)
    return found, monitor.is_frozen


def test_a_reading_that_changes_hides_nothing():
    assert hidden([(0.0, 0.0, 0.0), (0.1, 0.1, 0.5), (0.2, 0.2, 1.0)]) == (0.0, False)


def test_an_encoder_that_stands_repeats_itself():
    assert hidden([(0.1 * k, 0.3, 0.0) for k in range(100)]) == (0.0, False)


@pytest.mark.parametrize(("turned_rad", "is_frozen"), [(9e-3, False), (11e-3, True)])
def test_a_repeated_reading_while_the_joint_turns_by_ten_sigmas_is_frozen(turned_rad, is_frozen):
    found, frozen = hidden([(0.0, 0.3, 0.0), (0.1, 0.3, turned_rad)])
    assert found == pytest.approx(turned_rad, abs=1e-4)
    assert frozen == is_frozen


@pytest.mark.parametrize(("turned_rad", "is_frozen"), [(0.05, False), (0.07, True)])
def test_a_coarse_encoder_may_hide_three_of_its_steps(turned_rad, is_frozen):
    steps = [(0.0, 0.0, 0.0), (0.1, 0.02, 0.02), (0.2, 0.04, 0.04)]
    assert hidden([*steps, (0.3, 0.04, 0.04 + turned_rad)])[1] == is_frozen


def test_what_the_gyroscopes_are_not_sure_of_is_not_hidden():
    """A bias of 0.05 rad/s explains 0.1 rad in half a second, four times over."""
    assert hidden([(0.0, 0.3, 0.0), (0.5, 0.3, 0.1)], (0.0, 0.05**2)) == (0.0, False)
    assert hidden([(0.0, 0.3, 0.0), (0.5, 0.3, 0.1)], None) == (0.0, False)


def test_the_next_new_reading_thaws_it():
    assert hidden([(0.0, 0.3, 0.0), (0.1, 0.3, 0.1), (0.2, 0.5, 0.2)]) == (0.0, False)
