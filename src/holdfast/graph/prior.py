"""The prior with which a window begins."""

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.state import OptimisedState

MIN_EIGENVALUE = 1e-10  # of a matrix of correlations


def joint_prior(
    key: int, bias_key: int, state: OptimisedState, arm: tuple[int, Array] | None = None
) -> gtsam.NonlinearFactor:
    """Return the prior on a state and its bias with their full covariance (15, 15), correlations included.

    Where an antenna has told the position it is the antenna that is there: of the IMU that is true only if the arm is
    where it is believed to be: `arm` are the key and the value (3,) of its shift, (88) in docs/math.md.
    """
    root, at = _sqrt_information(state.covariance), gtsam.Values()
    at.insert(key, state.nav)
    at.insert(bias_key, state.bias)
    unit = gtsam.noiseModel.Unit.Create(15)
    if arm is None:
        linear = gtsam.JacobianFactor(key, root[:, :9], bias_key, root[:, 9:], np.zeros(15), unit)
    else:
        arm_key, shift = arm
        at.insert(arm_key, shift)
        linear = gtsam.JacobianFactor(
            key, root[:, :9], bias_key, root[:, 9:], arm_key, root[:, 3:6], np.zeros(15), unit
        )
    return gtsam.LinearContainerFactor(linear, at)


def _sqrt_information(covariance: Array) -> Array:
    """Return W (n, n) with W.T @ W the inverse of a covariance, which may have lost its last digits."""
    sigmas = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigmas, sigmas))
    weights: Array = (vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE))).T / sigmas
    return weights
