"""What an optimiser may return and is no solution: not finite, or beyond what any machine can do."""

import gtsam
import numpy as np

from holdfast.covariances import correlation_eigenvalues
from holdfast.graph.tail import Tail
from holdfast.messages import Array
from holdfast.state import OptimisedState

GREATEST_VARIANCE = 1e16  # no position on the Earth is as uncertain, and its squares are still numbers
LEAST_EIGENVALUE = 1e-12  # of correlations: what is smaller is lost in rounding; half a minute of IMU alone has 3e-4
GREATEST_SPEED_M_S = 400.0  # what is faster is none of the machines that carry such an IMU
MAX_STEP_M_S, MAX_STEP_M, MAX_STEP_SIGMA = 10.0, 10.0, 10.0  # of the newest node, in one optimisation


def check_solution(state: OptimisedState, tail: Tail, greatest_bias: Array) -> None:
    """Refuse a newest state that is no solution.

    Args:
        state: as it was optimised.
        tail: its covariance with that of what is behind it.
        greatest_bias: (6,) within the range of the IMU [m/s^2, rad/s].

    Raises:
        ValueError: says why.
    """
    if not state.is_finite():
        raise ValueError("the optimised state is not finite")
    if not correlation_eigenvalues(tail.state[None])[0] > LEAST_EIGENVALUE:
        raise ValueError("the covariance of the optimised state is not positive")
    if not (np.abs(tail.covariance) < GREATEST_VARIANCE).all():
        raise ValueError("the covariance of the optimised state is beyond all bounds")
    if (speed_m_s := float(np.linalg.norm(state.nav.velocity()))) > GREATEST_SPEED_M_S:
        raise ValueError(f"it diverges: the speed is {speed_m_s:.0f} m/s")
    if (np.abs(state.bias.vector()) > greatest_bias).any():
        raise ValueError("it diverges: a bias is beyond the range of the IMU")


def check_step(nav: gtsam.NavState, expected: gtsam.NavState, covariance: Array) -> None:
    """Refuse a newest node that steps further than an optimisation does that converges.

    Args:
        nav: as it was optimised.
        expected: as it was predicted.
        covariance: (9, 9) of that.

    Raises:
        ValueError: says what steps.
    """
    of_position, of_velocity = (np.sqrt(max(0.0, covariance.diagonal()[first : first + 3].sum())) for first in (3, 6))
    step_m_s = float(np.linalg.norm(nav.velocity() - expected.velocity()))
    if step_m_s > MAX_STEP_M_S + MAX_STEP_SIGMA * of_velocity:
        raise ValueError(f"it diverges: the velocity steps by {step_m_s:.0f} m/s")
    step_m = float(np.linalg.norm(nav.position() - expected.position()))
    if step_m > MAX_STEP_M + MAX_STEP_SIGMA * of_position:
        raise ValueError(f"it diverges: the position steps by {step_m:.0f} m")
