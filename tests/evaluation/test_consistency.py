import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from holdfast.errors import EstimatorError
from holdfast.evaluation.consistency import chi_square_cdf, chi_square_quantile, consistency, nees


@given(st.floats(1e-4, 1.0 - 1e-4), st.integers(1, 5000))
def test_chi_square_quantile_agrees_with_scipy(probability, dof):
    assert chi_square_quantile(probability, dof) == pytest.approx(stats.chi2.ppf(probability, dof), rel=1e-9)


@pytest.mark.parametrize("dof", [100_000, 2_000_000])
def test_chi_square_quantile_holds_for_long_recordings(dof):
    assert chi_square_quantile(0.975, dof) == pytest.approx(stats.chi2.ppf(0.975, dof), rel=1e-9)


@given(st.floats(0.0, 500.0), st.integers(1, 200))
def test_chi_square_distribution_agrees_with_scipy(value, dof):
    assert chi_square_cdf(value, dof) == pytest.approx(stats.chi2.cdf(value, dof), abs=1e-12)


def draw(seed, count, overconfidence=1.0):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, 3, 3)) + 2.0 * np.eye(3)
    errors = np.einsum("nij,nj->ni", roots, rng.normal(size=(count, 3)))
    return errors, roots @ roots.transpose(0, 2, 1) / overconfidence


def test_nees_is_the_squared_length_of_the_whitened_error():
    errors = np.array([[3.0, 4.0], [1.0, 0.0]])
    covariances = np.array([np.diag([9.0, 4.0]), [[2.0, 1.0], [1.0, 2.0]]])
    np.testing.assert_allclose(nees(errors, covariances), [1.0 + 4.0, 2.0 / 3.0])


@given(st.integers(0, 10_000))
def test_nees_does_not_depend_on_units_or_axes(seed):
    errors, covariances = draw(seed, 5)
    change = np.random.default_rng(seed + 1).normal(size=(3, 3)) + 3.0 * np.eye(3)
    np.testing.assert_allclose(
        nees(errors @ change.T, change @ covariances @ change.T), nees(errors, covariances), rtol=1e-6
    )


def test_honest_covariances_pass_as_often_as_the_bounds_promise():
    verdicts = [consistency(*draw(seed, 200)) for seed in range(400)]
    passed = sum(verdict.consistent for verdict in verdicts)
    assert stats.binom.cdf(passed, 400, 0.95) > 1e-4 and stats.binom.sf(passed, 400, 0.95) > 1e-4
    assert np.mean([verdict.fraction_inside for verdict in verdicts]) == pytest.approx(0.95, abs=4e-3)
    assert np.mean([verdict.mean_nees_per_dof for verdict in verdicts]) == pytest.approx(1.0, abs=0.02)


def test_covariances_that_are_too_small_or_too_large_are_found_out():
    over, under = consistency(*draw(0, 500, overconfidence=1.5)), consistency(*draw(0, 500, overconfidence=1 / 1.5))
    assert not over.consistent and over.mean_nees_per_dof > over.upper_per_dof and over.fraction_inside < 0.95
    assert not under.consistent and under.mean_nees_per_dof < under.lower_per_dof and under.fraction_inside > 0.95


def test_covariances_that_are_none_are_refused():
    with pytest.raises(EstimatorError, match="covariance 1 is not positive definite"):
        nees(np.zeros((2, 2)), np.array([np.eye(2), np.diag([1.0, -1.0])]))
    with pytest.raises(EstimatorError, match="covariances"):
        nees(np.zeros((2, 2)), np.array([np.eye(2)]))
    with pytest.raises(EstimatorError, match="quantile"):
        chi_square_quantile(1.0, 3)
