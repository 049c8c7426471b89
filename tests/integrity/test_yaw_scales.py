"""Three witnesses of a turn, each wrong by an unknown amount, tell each other apart; two tell only their sum."""

import numpy as np
import pytest

from holdfast.integrity.learnt_snapshot import LearntYaw
from holdfast.integrity.yaw_scales import Turned, YawScales

A_DEGREE = Turned(np.radians(1.0) ** 2, 0.0)


def fed(true, *, count=400, seed=0, configured=(A_DEGREE, A_DEGREE, A_DEGREE), scales=None):
    """The scales after turns by witnesses that are so many times as wrong as configured."""
    scales, rng = scales or YawScales(), np.random.default_rng(seed)
    sigmas = [np.sqrt(one.at(k**2)) for one, k in zip(configured, true, strict=True)]
    for gyroscope, odometry, heading in rng.normal(0.0, sigmas, (count, 3)):
        scales.learn_from_three((heading - gyroscope, heading - odometry), *configured, 1.0)
    return scales


def test_they_begin_at_what_is_configured():
    assert YawScales().values == pytest.approx((1.0, 1.0, 1.0), rel=0.02)


@pytest.mark.parametrize("true", [(1.0, 1.0, 1.0), (0.6, 2.0, 1.0), (5.0, 0.5, 1.0), (0.5, 0.5, 4.0), (4.0, 1.0, 1.0)])
def test_each_is_found_whoever_is_wrong(true):
    assert fed(true).values == pytest.approx(true, rel=0.35)


@pytest.mark.parametrize("true", [(0.6, 2.0, 1.0), (4.0, 1.0, 1.0)])
def test_what_is_carried_over_a_restart_is_what_was_believed(true):
    before = fed(true)
    kept = LearntYaw.model_validate_json(before.learnt().model_dump_json())
    assert YawScales(kept).values == pytest.approx(before.values, rel=0.25)
    tripled = YawScales(before.learnt(3.0)).values
    assert tripled[1] == pytest.approx(3.0 * before.values[1], rel=0.25)
    assert YawScales().learnt() is None


def test_who_has_changed_overnight_is_found():
    kept = fed((0.5, 4.0, 1.0), count=2000).learnt()
    assert fed((4.0, 0.5, 1.0), scales=YawScales(kept)).values == pytest.approx((4.0, 0.5, 1.0), rel=0.4)


def test_who_is_far_better_than_the_others_is_known_to_be_better():
    """How much better no difference shows."""
    gyroscope, odometry, _ = fed((0.1, 3.0, 1.0)).values
    assert gyroscope < 0.5 and odometry == pytest.approx(3.0, rel=0.2)


def test_the_error_of_headings_that_both_residuals_have_in_common_is_nobody_elses():
    good = Turned(np.radians(0.1) ** 2, 0.0)
    gyroscope, odometry, _ = fed((1.0, 1.0, 3.0), configured=(good, good, A_DEGREE)).values
    assert 0.7 < gyroscope < 1.7 and 0.7 < odometry < 1.7


def learnt_from_two(sigma_rad, count=400):
    scales = YawScales()
    for apart in np.random.default_rng(0).normal(0.0, sigma_rad, count):
        scales.learn_from_two(apart, A_DEGREE, A_DEGREE, 1.0)
    return scales.values


def test_two_that_agree_are_both_better_and_neither_is_preferred():
    gyroscope, odometry, headings = learnt_from_two(np.radians(0.3))
    assert gyroscope == pytest.approx(odometry, rel=0.01)
    assert 0.15 < gyroscope < 0.5 and headings == pytest.approx(1.0, rel=0.02)


def test_two_that_disagree_are_both_in_doubt():
    gyroscope, odometry, _ = learnt_from_two(np.radians(5.0))
    assert gyroscope == pytest.approx(odometry, rel=0.01) and gyroscope > 2.0


def test_what_no_scale_is_of_teaches_nothing():
    sure = Turned(0.0, np.radians(1.0) ** 2)
    assert fed((1.0, 1.0, 1.0), configured=(sure, sure, sure)).values == pytest.approx((1.0, 1.0, 1.0), rel=0.02)


def test_an_outlier_tells_no_more_than_a_bad_turn():
    scales = fed((1.0, 1.0, 1.0), count=100)
    before = scales.values
    scales.learn_from_three((3.0, 0.01), A_DEGREE, A_DEGREE, A_DEGREE, 1.0)
    scales.learn_from_two(3.0, A_DEGREE, A_DEGREE, 1.0)
    assert max(np.array(scales.values) / before) < 1.5  # a turn by 3 rad would be 170 sigma


def test_what_is_forgotten_leads_back_to_what_is_configured():
    scales = fed((0.3, 3.0, 1.0))
    scales.forget(1.0)
    assert scales.values == YawScales().values
