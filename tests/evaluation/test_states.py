"""Errors of states lie in the tangent in which GTSAM's NavState carries its covariance."""

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from holdfast.errors import EstimatorError
from holdfast.evaluation.states import States, from_rotation_vector, rotation_vector, state_errors
from holdfast.state import Trajectory

COUNT = 50


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def states(rotations, positions, velocities, stamps=None):
    stamps = np.arange(len(positions)) if stamps is None else stamps
    return States(Trajectory(stamps, positions, rotations.as_quat()), velocities)


def test_the_tangent_is_that_of_navstate(rng):
    R, p, v = Rotation.random(COUNT, rng=rng), rng.standard_normal((COUNT, 3)), rng.standard_normal((COUNT, 3))
    tangent = rng.standard_normal((COUNT, 9)) * 0.3
    navs = [gtsam.NavState(gtsam.Rot3(R[k].as_matrix()), p[k], v[k]).retract(tangent[k]) for k in range(COUNT)]
    true = states(
        Rotation.from_matrix([nav.attitude().matrix() for nav in navs]),
        np.array([nav.position() for nav in navs]),
        np.array([nav.velocity() for nav in navs]),
    )
    np.testing.assert_allclose(state_errors(states(R, p, v), true).tangent, tangent, atol=1e-12)


def test_errors_in_the_world_are_estimate_minus_truth(rng):
    R, p, v = Rotation.random(COUNT, rng=rng), rng.standard_normal((COUNT, 3)), rng.standard_normal((COUNT, 3))
    rotation = Rotation.from_rotvec([0.001, -0.002, 0.03])
    errors = state_errors(states(rotation * R, p + np.array([1.0, 2.0, 3.0]), v), states(R, p, v))
    np.testing.assert_allclose(errors.position, np.tile([1.0, 2.0, 3.0], (COUNT, 1)))
    np.testing.assert_allclose(errors.attitude, np.tile([0.001, -0.002, 0.03], (COUNT, 1)), atol=1e-12)


def test_states_of_different_stamps_are_not_compared(rng):
    R, p = Rotation.random(3, rng=rng), np.zeros((3, 3))
    with pytest.raises(EstimatorError, match="equal stamps"):
        state_errors(states(R, p, p), states(R, p, p, stamps=np.arange(3) + 1))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, np.pi - 1e-6])
def test_rotation_vectors_are_those_of_scipy_and_come_back(angle, rng):
    axes = rng.standard_normal((COUNT, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    quaternions = from_rotation_vector(vectors)
    np.testing.assert_allclose(quaternions, Rotation.from_rotvec(vectors).as_quat(), atol=1e-15)
    np.testing.assert_allclose(rotation_vector(quaternions), vectors, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(rotation_vector(-quaternions), vectors, rtol=1e-9, atol=1e-15)
