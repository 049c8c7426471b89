"""What the estimator says: estimates, events, and trajectories made of stamped poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.messages import Array


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Stamped poses of one frame in another, sorted by time.

    Attributes:
        stamps_ns: (N,) strictly increasing.
        positions: (N, 3) [m].
        quaternions: (N, 4) x, y, z, w, of unit norm.
    """

    stamps_ns: NDArray[np.int64]
    positions: Array
    quaternions: Array
