"""The gate: which fixes may enter the graph, judged against what the estimator expects."""

import gtsam
import numpy as np

from holdfast.messages import Array

HOLD_BACK = 4.0  # in units of the limit on NIS: twice the gate in sigma
MAX_IN_A_ROW = 5  # so many fixes in a row that contradict the estimate make the estimate suspect, not the fixes


class InnovationGate:
    """Weighs fixes by their normalised innovation squared (NIS): (21) in docs/math.md.

    Up to the gate a fix counts in full; beyond it its covariance grows with the square of the excess, because the
    estimate may be at fault as well as the fix; beyond twice the gate it is held back.
    """

    def __init__(self, gate_sigma: float) -> None:
        self.limit = gate_sigma**2
        self._in_a_row = 0

    def inflation(self, nis: float) -> float | None:
        """Return the factor on the covariance of a fix with this NIS, or None if the fix is held back."""
        excess = nis / self.limit
        if not excess <= HOLD_BACK:
            self._in_a_row += 1
            return None
        self._in_a_row = 0
        return max(1.0, excess**2)

    def blames_estimate(self) -> bool:
        """Whether so many fixes in a row were held back that the estimate is suspect; counting starts over if so."""
        suspect = self._in_a_row >= MAX_IN_A_ROW
        if suspect:
            self._in_a_row = 0
        return suspect


def innovation_nis(nav: gtsam.NavState, covariance: Array, p_I_G: Array, p_W_G: Array, fix_covariance: Array) -> float:
    """Return the normalised innovation squared of an antenna position: y^T (H P H^T + R)^-1 y."""
    R_W_I = nav.attitude().matrix()
    innovation = p_W_G - nav.position() - R_W_I @ p_I_G
    H = np.zeros((3, 9))
    H[:, :3] = -R_W_I @ skew(p_I_G)
    H[:, 3:6] = R_W_I
    return float(innovation @ np.linalg.solve(H @ covariance @ H.T + fix_covariance, innovation))


def skew(v: Array) -> Array:
    """Return the matrix (3, 3) of the cross product with v (3,)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
