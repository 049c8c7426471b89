"""Matrices of many at once, against GTSAM's of one."""

import gtsam
import numpy as np

from holdfast.geometry.rotations import about_z, skew


def test_skew_matrices_are_cross_products():
    vectors = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_array_equal(skew(vectors), [gtsam.SO3.Hat(vector) for vector in vectors])
    np.testing.assert_array_equal(skew(vectors[0]), gtsam.SO3.Hat(vectors[0]))


def test_rotations_about_z_turn_from_x_to_y():
    angles = np.array([0.0, 1e-9, 0.7, -2.0, np.pi, 40.0])
    expected = [gtsam.Rot3.Rz(angle).matrix() for angle in angles]
    np.testing.assert_allclose(about_z(angles), expected, rtol=0, atol=1e-15)
