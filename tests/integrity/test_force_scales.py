"""How wrong an accelerometer is and how noisy fixes are is told apart by how residuals grow with the time spanned."""

import numpy as np
import pytest

from holdfast.integrity.force_scales import ForceScales, Seen
from holdfast.integrity.learnt_snapshot import LearntScale

FIX = np.full(3, 0.01**2)
SPANS_S = 1.0, 2.0, 4.0


def residual(rng, span_s, scale, white, outlier=1.0):
    """A residual of an accelerometer and of fixes that are so many times as wrong as was taken."""
    error = 0.01**2 * span_s**3
    seen = Seen(np.zeros(3), np.full(3, 1e-6), error, 6.0 * FIX, 0.1 * FIX)
    return seen._replace(squared=outlier * rng.normal(0.0, 1.0, 3) ** 2 * seen.variances(scale**2, white))


def fed(scale, white=1.0, *, count=150, seed=0, scales=None, outliers=0.0):
    scales, rng = scales or ForceScales(), np.random.default_rng(seed)
    for _ in range(count):
        for span_s in SPANS_S:
            outlier = 1e4 if rng.uniform() < outliers else 1.0
            scales.learn(residual(rng, span_s, scale, white, outlier), 0.5)
    return scales


def test_it_begins_at_what_is_configured_and_has_learnt_nothing():
    assert ForceScales().accelerometer == pytest.approx(1.0, rel=0.02)
    assert ForceScales().learnt() is None


@pytest.mark.parametrize("white", [0.1, 1.0, 4.0])
@pytest.mark.parametrize("scale", [0.3, 1.0, 5.0])
def test_the_accelerometer_is_found_whatever_the_fixes_are_worth(scale, white):
    learnt = fed(scale, white).learnt()
    assert abs(learnt.log_mean - np.log(scale)) < 3.0 * learnt.log_sigma and learnt.log_sigma < 0.6


def test_what_is_used_errs_on_the_side_of_more():
    used = [fed(1.0, count=40, seed=seed).accelerometer for seed in range(20)]
    assert np.mean(np.array(used) > 1.0) > 0.6


def test_fixes_that_jump_now_and_then_are_no_worse_accelerometer():
    assert fed(1.0, outliers=0.02).accelerometer < 2.0


def test_what_is_kept_over_a_night_is_used_at_once_and_refuted_where_it_holds_no_more():
    kept = LearntScale.model_validate_json(fed(5.0).learnt().model_dump_json())
    assert ForceScales(kept).accelerometer == pytest.approx(5.0, rel=0.4)
    assert fed(0.5, scales=ForceScales(kept)).accelerometer < 1.0


def test_what_was_seen_long_ago_is_forgotten():
    scales = fed(5.0)
    for _ in range(120):
        scales.forget(0.1)
    assert scales.accelerometer == pytest.approx(1.0, rel=0.1)
