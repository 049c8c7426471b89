"""What an optimiser may return and is no solution: not finite, or beyond what any machine can do."""

import numpy as np

from holdfast.covariances import correlation_eigenvalues
from holdfast.graph.tail import Tail
from holdfast.messages import Array
from holdfast.state import OptimisedState

GREATEST_VARIANCE = 1e16  # no position on the Earth is as uncertain, and its squares are still numbers
LEAST_EIGENVALUE = 1e-12  # of correlations: what is smaller is lost in rounding; half a minute of IMU alone has 3e-4
GREATEST_SPEED_M_S = 1e4  # what is faster leaves the Earth


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
