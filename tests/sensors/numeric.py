"""Jacobians of factors by central differences, against those that GTSAM's optimiser is given."""

import gtsam
import numpy as np

STEP = 1e-5  # error of the difference: STEP^2 times the third derivative, plus round-off / STEP


def assert_jacobians(factor, values, tolerance=1e-6):
    """Compare `factor.linearize` with differences of its whitened residual, for every key."""
    A = _whitened(factor, values)
    column = 0
    for key in factor.keys():  # noqa: SIM118 - no mapping
        dim = 6 if gtsam.Symbol(key).chr() == ord("b") else 9
        for axis in range(dim):
            step = np.zeros(dim)
            step[axis] = STEP
            numeric = (residual(factor, moved(values, key, step)) - residual(factor, moved(values, key, -step))) / (
                2.0 * STEP
            )
            np.testing.assert_allclose(A[:, column], numeric, atol=tolerance * max(1.0, abs(A).max()))
            column += 1
    assert column == A.shape[1]


def moved(values, key, step):
    other = gtsam.Values(values)
    if len(step) == 6:
        other.update(key, values.atConstantBias(key).retract(step))
    else:
        other.update(key, values.atNavState(key).retract(step))
    return other


def residual(factor, values):
    """Whitened residual: what `linearize` keeps as -b."""
    return -factor.linearize(values).jacobian()[1]


def _whitened(factor, values):
    return factor.linearize(values).jacobian()[0]
