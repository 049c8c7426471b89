"""The solver of long stretches: what is marginalised stays as information, and factors come and go."""

from itertools import pairwise

import gtsam
import numpy as np
import pytest

from holdfast.graph.batch import Batch

UNIT = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
KEYS = [gtsam.symbol("p", k) for k in range(6)]


def chain():
    """Points (3,) in a row with a prior on the first, a step between neighbours, and a measurement of every other."""
    batch, rng = Batch(), np.random.default_rng(0)
    for k, key in enumerate(KEYS):
        batch.insert(key, np.zeros(3), k)
    batch.add(gtsam.PriorFactorVector(KEYS[0], np.zeros(3), UNIT))
    for a, b in pairwise(KEYS):
        batch.add(gtsam.BetweenFactorPoint3(a, b, rng.normal(size=3), UNIT))
    for key in KEYS[::2]:
        batch.add(gtsam.PriorFactorVector(key, rng.normal(size=3), UNIT))
    return batch


def test_marginalising_changes_neither_estimate_nor_covariance():
    batch = chain()
    batch.converge()
    before = [(batch.vector(key), batch.covariance(key)) for key in KEYS[3:]]
    batch.solve(3)
    assert KEYS[2] not in batch and len(batch) == 3
    batch.converge()
    for key, (value, covariance) in zip(KEYS[3:], before, strict=True):
        assert np.allclose(batch.vector(key), value, atol=1e-9)
        assert np.allclose(batch.covariance(key), covariance, atol=1e-9)


def test_a_factor_that_is_taken_out_leaves_no_trace():
    batch = chain()
    batch.converge()
    without = batch.vector(KEYS[5])
    placed = batch.add(gtsam.PriorFactorVector(KEYS[5], np.full(3, 9.0), UNIT))
    batch.converge()
    assert not np.allclose(batch.vector(KEYS[5]), without, atol=0.1)
    batch.retract(placed)
    batch.converge()
    assert np.allclose(batch.vector(KEYS[5]), without, atol=1e-9)


def test_the_cost_falls_to_that_of_the_optimum():
    batch = chain()
    solved = batch.converge()
    assert solved.after < solved.before and solved.iterations >= 1
    assert batch.converge().after == pytest.approx(solved.after)


def test_a_copy_goes_its_own_way():
    batch = chain()
    batch.converge()
    other, _ = batch.copy()
    other.add(gtsam.PriorFactorVector(KEYS[0], np.full(3, 9.0), UNIT))
    other.converge()
    assert not np.allclose(other.vector(KEYS[0]), batch.vector(KEYS[0]))
