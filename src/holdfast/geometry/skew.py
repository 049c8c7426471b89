"""The cross product as a matrix, for many vectors at once."""

import numpy as np

from holdfast.messages import Array

GENERATORS = np.zeros((3, 3, 3))  # of SO(3): [v]x = sum v_k G_k
GENERATORS[0, 2, 1] = GENERATORS[1, 0, 2] = GENERATORS[2, 1, 0] = 1.0
GENERATORS[0, 1, 2] = GENERATORS[1, 2, 0] = GENERATORS[2, 0, 1] = -1.0


def skew(vectors: Array) -> Array:
    """Return the matrices (..., 3, 3) with [v]x w = v x w of vectors (..., 3)."""
    matrices: Array = vectors @ GENERATORS.reshape(3, 9)
    return matrices.reshape(*vectors.shape, 3)
