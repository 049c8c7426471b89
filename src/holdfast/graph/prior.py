"""The prior with which a window begins."""

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.state import OptimisedState

MIN_EIGENVALUE = 1e-10  # of a matrix of correlations


def joint_prior(key: int, bias_key: int, state: OptimisedState) -> gtsam.NonlinearFactor:
    """Return the prior on a state and its bias with their full covariance (15, 15), correlations included."""
    sqrt_information = _sqrt_information(state.covariance)
    linear = gtsam.JacobianFactor(
        key, sqrt_information[:, :9], bias_key, sqrt_information[:, 9:], np.zeros(15), gtsam.noiseModel.Unit.Create(15)
    )
    at = gtsam.Values()
    at.insert(key, state.nav)
    at.insert(bias_key, state.bias)
    return gtsam.LinearContainerFactor(linear, at)


def _sqrt_information(covariance: Array) -> Array:
    """Return W (n, n) with W.T @ W the inverse of a covariance, which may have lost its last digits."""
    sigmas = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigmas, sigmas))
    weights: Array = (vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE))).T / sigmas
    return weights
