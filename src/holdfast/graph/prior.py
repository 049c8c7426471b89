"""The prior with which a window begins."""

from collections.abc import Iterator
from dataclasses import replace

import gtsam
import numpy as np

from holdfast.messages import Array
from holdfast.sensors.lever_arm import IF_WRONG_M
from holdfast.sensors.sensor import Position, PositionSensor, State, innovation_factor
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


def priors_through(  # noqa: PLR0917 (what a window begins with)
    antenna: PositionSensor, key: int, bias_key: int, arm_key: int, state: OptimisedState, shift: Array
) -> Iterator[gtsam.NonlinearFactor]:
    """Yield the same where an antenna has told the position: it is the antenna that is there, (88) in docs/math.md.

    Where the IMU is rests on the lever arm, of which the position must not be taken for a witness later.

    Args:
        antenna: whose shift of the lever arm is a variable.
        key: of the node.
        bias_key: of its bias.
        arm_key: of the shift.
        state: where the window begins.
        shift: (3,) as it is believed.
    """
    at = State(state.nav, state.covariance[:9, :9], parameter=shift, parameter_covariance=np.zeros((3, 3)))
    p_W_P = state.nav.pose().transformFrom(antenna.p_I_P + shift)
    point = Position(state.stamp_ns, antenna.name, p_W_P, np.eye(3), 0.0)
    H, loose = antenna.innovation(point, at).H, state.covariance.copy()
    loose[3:6, 3:6] += np.eye(3) * IF_WRONG_M**2
    yield joint_prior(key, bias_key, replace(state, covariance=loose))
    yield innovation_factor(antenna, [key, arm_key], point, at, H @ at.covariance @ H.T)


def _sqrt_information(covariance: Array) -> Array:
    """Return W (n, n) with W.T @ W the inverse of a covariance, which may have lost its last digits."""
    sigmas = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigmas, sigmas))
    weights: Array = (vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE))).T / sigmas
    return weights
