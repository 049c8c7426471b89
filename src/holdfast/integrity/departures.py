"""How positions depart from an estimate: smoothly from one that is wrong; roughly if they wander.

An estimate that nothing corrects is wrong by what its velocity, its tilt or its IMU is wrong by: beside true positions
it goes a smooth way, whatever is wrong. (84) in docs/math.md.
"""

from collections import deque
from math import nan

import numpy as np

from holdfast.messages import Array

FEWEST, MOST = 5, 12  # positions
SPACING_NS = 900_000_000  # between them: what wanders is smooth, too, over a time that is too short
# squares that the best parabola leaves over what is claimed: at four faults of an IMU 1.4 at most, of fixes that wander
# 3.2 to 10
ROUGH, SMOOTH = 3.0, 1.5
FAR = 0.15**2  # of the squared distances, which a parabola must leave: of fixes that wander it leaves 0.25**2
COEFFICIENTS = 3  # of a parabola


class Departures:
    """How far the newest positions of one receiver are from an estimate that they hardly correct."""

    def __init__(self) -> None:
        self._newest: deque[tuple[int, Array, float]] = deque(maxlen=MOST)

    def add(self, stamp_ns: int, off_W: Array, covariance: Array) -> None:
        """Take in (3,) how far a position is from the estimate [m], and its covariance (3, 3) as it is claimed.

        Of positions that follow each other faster than `SPACING_NS` the first ones count.
        """
        if not self._newest or stamp_ns - self._newest[-1][0] >= SPACING_NS:
            self._newest.append((stamp_ns, off_W[:2], 0.5 * float(np.trace(covariance[:2, :2]))))

    def clear(self) -> None:
        """Forget them: the estimate was corrected."""
        self._newest.clear()

    @property
    def excess(self) -> float:
        """Mean square of the distances, per axis, over what is claimed."""
        squares = [float(off @ off) / (2.0 * variance) for _, off, variance in self._newest]
        return sum(squares) / max(len(squares), 1)

    def are_rough(self) -> bool:
        """Whether no parabola explains them: the positions are at fault, and not the estimate.

        Unless they are far away by much more than that: then both are.
        """
        return self._left(FEWEST) > max(ROUGH, FAR * self.excess)

    def are_smooth(self) -> bool:
        """Whether a parabola explains them, and they are so many that it could not by chance."""
        return self._left(MOST) < SMOOTH

    def _left(self, fewest: int) -> float:
        """Return what the best parabola leaves of the squares, over what is claimed; NaN where nothing tells."""
        if len(self._newest) < fewest:
            return nan
        stamps, off, variances = zip(*self._newest, strict=True)
        t = np.array([stamp - stamps[0] for stamp in stamps]) * 1e-9
        weights = 1.0 / np.sqrt(variances)[:, None]
        _, left, rank, _ = np.linalg.lstsq(np.vander(t, COEFFICIENTS) * weights, np.array(off) * weights)
        return float(left.sum()) / (2 * (len(t) - COEFFICIENTS)) if rank == COEFFICIENTS else nan
