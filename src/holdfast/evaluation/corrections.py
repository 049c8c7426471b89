"""How far updates move what had been published: the paper's consistency (V-B, Fig. 6).

The state that an update finds for a time is compared with the state that had been published for that time before.
"""

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation.association import Association, associate
from holdfast.messages import Array
from holdfast.state import Trajectory


def corrections(published: Trajectory, optimised: Trajectory) -> tuple[NDArray[np.int64], Array]:
    """Return stamps (M,) and |p_optimised - p_published| (M,) [m] at those stamps of `optimised` that were published.

    Args:
        published: at IMU rate; interpolated to the stamps of the nodes.
        optimised: the newest node after each update, each stamp once.
    """
    pairs = associate(published, optimised, Association(position_only=True, max_gap_s=0.05))
    distance = np.linalg.norm(pairs.estimate.positions - pairs.reference.positions, axis=1)
    return pairs.reference.stamps_ns, distance
