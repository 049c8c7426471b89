import numpy as np
import pytest

from holdfast.state import Trajectory


def _wander(seed=1, count=400, step_s=0.1, start_s=0.0):
    """A random walk in all six degrees of freedom, rich enough that no two axes can be confused."""
    rng = np.random.default_rng(seed)
    stamps = (np.arange(count) * round(step_s * 1e9) + round(start_s * 1e9)).astype(np.int64)
    velocity = np.cumsum(rng.normal(0.0, 0.1, (count, 3)), axis=0) * [1.0, 1.0, 0.2] + np.array([1.0, 0.3, 0.0])
    quaternions = np.cumsum(rng.normal(0.0, 0.03, (count, 4)), axis=0) + np.array([0.0, 0.0, 0.0, 1.0])
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return Trajectory(stamps, np.cumsum(velocity * step_s, axis=0), quaternions)


def _disturbed(trajectory, seed=2, position_m=0.05, rotation=0.01):
    rng = np.random.default_rng(seed)
    positions = trajectory.positions + np.cumsum(rng.normal(0.0, position_m, trajectory.positions.shape), axis=0)
    quaternions = trajectory.quaternions + rng.normal(0.0, rotation, trajectory.quaternions.shape)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return Trajectory(trajectory.stamps_ns, positions, quaternions)


@pytest.fixture(scope="session")
def wander():
    return _wander


@pytest.fixture(scope="session")
def disturbed():
    return _disturbed
