"""How many times larger a standard deviation is than configured, learnt from residuals."""

import numpy as np
import pytest

from holdfast.integrity.learnt_snapshot import LearntScale
from holdfast.integrity.scale_posterior import HIGHEST, LOWEST, ScalePosterior


def fed(posterior, scale, count, *, scaled=1e-4, other=0.0, seed=1, size=3):
    rng = np.random.default_rng(seed)
    for residual in rng.normal(0.0, np.sqrt(scale**2 * scaled + other), (count, size)):
        posterior.learn(float(residual @ residual), size, scaled, other, 1.0)
    return posterior.value


def test_it_begins_at_what_is_configured():
    assert ScalePosterior().value == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize("scale", [0.1, 0.3, 1.0, 3.0, 8.0])
def test_a_scale_is_found_in_both_directions(scale):
    assert fed(ScalePosterior(), scale, 300) == pytest.approx(scale, rel=0.15)


def test_it_errs_to_the_safe_side_with_little_evidence():
    values = [fed(ScalePosterior(), 0.3, 10, seed=seed) for seed in range(40)]
    assert np.mean(np.array(values) >= 0.3) > 0.8
    assert max(values) < 1.0


def test_what_is_not_of_the_scale_does_not_raise_it():
    assert fed(ScalePosterior(), 0.3, 1000, other=1e-4) == pytest.approx(0.3, rel=0.35)


def test_residuals_in_which_the_scale_has_no_part_teach_nothing():
    posterior = ScalePosterior()
    before = posterior.value
    assert fed(posterior, 1.0, 100, scaled=0.0, other=1e-4) == before


def test_an_outlier_tells_no_more_than_a_bad_residual():
    posterior = ScalePosterior()
    before = fed(posterior, 0.5, 100)
    posterior.learn(1e6, 3, 1e-4, 0.0, 1.0)
    assert before < posterior.value < 1.2 * before


def test_it_stays_within_its_bounds_whatever_it_sees():
    assert LOWEST <= fed(ScalePosterior(), 1e-6, 1000) <= 1.1 * LOWEST
    assert 0.9 * HIGHEST <= fed(ScalePosterior(), 1e3, 1000) <= HIGHEST


def test_what_is_forgotten_leads_back_to_what_is_configured():
    posterior = ScalePosterior()
    fed(posterior, 0.1, 300)
    posterior.forget(1.0)
    assert posterior.value == ScalePosterior().value


def carried(posterior):
    return LearntScale.model_validate_json(posterior.learnt().model_dump_json())


@pytest.mark.parametrize("scale", [0.1, 1.0, 8.0])
def test_what_is_carried_over_a_restart_is_believed_a_little_less(scale):
    before = ScalePosterior()
    fed(before, scale, 300)
    after = ScalePosterior(carried(before))
    assert after.value == pytest.approx(before.value, rel=0.25)
    assert after.learnt().log_sigma > before.learnt().log_sigma


@pytest.mark.parametrize(("before", "now"), [(8.0, 0.3), (0.3, 8.0)])
def test_a_scale_that_has_changed_since_is_found(before, now):
    posterior = ScalePosterior()
    fed(posterior, before, 3000)
    assert fed(ScalePosterior(carried(posterior)), now, 60) == pytest.approx(now, rel=0.25)


def test_where_nothing_was_taken_in_nothing_is_carried():
    assert ScalePosterior().learnt() is None


def test_the_unit_of_what_is_carried_may_be_another_one():
    before = ScalePosterior()
    fed(before, 3.0, 300)
    after = ScalePosterior(before.learnt(2.0), 3.0)
    assert after.learnt(3.0).log_mean == pytest.approx(np.log(2.0 * 3.0), abs=0.1)
    assert after.value == pytest.approx(2.0 * before.value / 3.0, rel=0.25)
