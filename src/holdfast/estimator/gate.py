"""The gate: which fixes may enter the graph, judged against what the estimator expects."""

import gtsam
import numpy as np

from holdfast.messages import Array

MAX_IN_A_ROW = 5  # so many fixes in a row that contradict the estimate make the estimate suspect, not the fixes


class InnovationGate:
    """Holds back fixes whose normalised innovation squared (NIS) is too large: (21) in docs/math.md."""

    def __init__(self, gate_sigma: float) -> None:
        self._limit = gate_sigma**2
        self._in_a_row = 0

    def passes(self, nav: gtsam.NavState, covariance: Array, p_I_G: Array, p_W_G: Array, fix_covariance: Array) -> bool:
        """Judge one fix against the predicted state and its covariance (9, 9)."""
        nis = innovation_nis(nav, covariance, p_I_G, p_W_G, fix_covariance)
        if nis <= self._limit or self._in_a_row >= MAX_IN_A_ROW:
            self._in_a_row = 0
            return True
        self._in_a_row += 1
        return False


def innovation_nis(nav: gtsam.NavState, covariance: Array, p_I_G: Array, p_W_G: Array, fix_covariance: Array) -> float:
    """Return the normalised innovation squared of an antenna position: y^T (H P H^T + R)^-1 y."""
    R_W_I = nav.attitude().matrix()
    innovation = p_W_G - nav.position() - R_W_I @ p_I_G
    H = np.zeros((3, 9))
    H[:, :3] = -R_W_I @ _skew(p_I_G)
    H[:, 3:6] = R_W_I
    return float(innovation @ np.linalg.solve(H @ covariance @ H.T + fix_covariance, innovation))


def _skew(v: Array) -> Array:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
