"""The prior of a window takes any covariance that an optimiser has left behind."""

import gtsam
import numpy as np
import pytest

from holdfast.graph.prior import joint_prior
from holdfast.state import OptimisedState

X, B = gtsam.symbol("x", 0), gtsam.symbol("b", 0)


def state_of(covariance):
    return OptimisedState(0, gtsam.NavState(), gtsam.imuBias.ConstantBias(), covariance, np.zeros(3))


def information(covariance):
    at = gtsam.Values()
    at.insert(X, gtsam.NavState())
    at.insert(B, gtsam.imuBias.ConstantBias())
    jacobian, _ = joint_prior(X, B, state_of(covariance)).linearize(at).jacobian()
    return jacobian.T @ jacobian


def covariance_of(seed):
    root = np.random.default_rng(seed).normal(size=(15, 15)) * np.repeat([1e-2, 1.0, 0.1, 1e-2, 1e-4], 3)[:, None]
    return root @ root.T


@pytest.mark.parametrize("seed", range(5))
def test_it_holds_the_inverse_of_the_covariance_correlations_included(seed):
    covariance = covariance_of(seed)
    np.testing.assert_allclose(information(covariance) @ covariance, np.eye(15), atol=1e-5)


def test_a_covariance_that_has_lost_its_last_digits_is_no_error():
    """Two states that are known to be equal, but for a rounding that makes one eigenvalue negative."""
    covariance = covariance_of(1)
    covariance[3], covariance[:, 3] = covariance[4], covariance[:, 4]
    covariance[3, 3] = covariance[4, 4] * (1.0 - 1e-13)
    assert np.linalg.eigvalsh(covariance)[0] < 0.0
    assert np.isfinite(information(covariance)).all()
