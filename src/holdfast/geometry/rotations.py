"""Matrices of many rotations and cross products at once, and quaternions of them."""

import numpy as np

from holdfast.messages import Array

GENERATORS = np.zeros((3, 3, 3))  # of SO(3): [v]x = sum v_k G_k
GENERATORS[0, 2, 1] = GENERATORS[1, 0, 2] = GENERATORS[2, 1, 0] = 1.0
GENERATORS[0, 1, 2] = GENERATORS[1, 2, 0] = GENERATORS[2, 0, 1] = -1.0


def skew(vectors: Array) -> Array:
    """Return the matrices (..., 3, 3) with [v]x w = v x w of vectors (..., 3)."""
    matrices: Array = vectors @ GENERATORS.reshape(3, 9)
    return matrices.reshape(*vectors.shape, 3)


def exponentials(vectors: Array) -> Array:
    """Return the rotations (K, 3, 3) of rotation vectors (K, 3) [rad], by Rodrigues' formula."""
    angles = np.linalg.norm(vectors, axis=1)[:, None, None]
    hats = skew(vectors)
    # sin(a) / a, and (1 - cos(a)) / a^2 = (sin(a/2) / (a/2))^2 / 2
    first, second = np.sinc(angles / np.pi), 0.5 * np.sinc(0.5 * angles / np.pi) ** 2
    found: Array = np.eye(3) + first * hats + second * (hats @ hats)
    return found


def attitudes(turns: Array) -> Array:
    """Return the attitudes (K + 1, 3, 3) after each of K turns about the body's own axes, the first the identity.

    Args:
        turns: (K, 3) rotation vectors [rad].
    """
    products = np.concatenate([np.eye(3)[None], exponentials(turns)])
    reach = 1
    while reach < len(products):  # in log2(K) rounds (Hillis and Steele, 1986)
        products[reach:] = products[:-reach] @ products[reach:]
        reach *= 2
    return products


def about_z(angles_rad: Array) -> Array:
    """Return the rotations (N, 3, 3) about the z axis by angles (N,)."""
    matrices = np.zeros((len(angles_rad), 3, 3))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(angles_rad)
    matrices[:, 1, 0] = np.sin(angles_rad)
    matrices[:, 0, 1] = -matrices[:, 1, 0]
    matrices[:, 2, 2] = 1.0
    return matrices


def quaternions_xyzw(rotations: Array) -> Array:
    """Return the quaternions (N, 4) x, y, z, w of rotations (N, 3, 3): by w, or by the largest where that is small.

    Source: Shepperd, "Quaternion from Rotation Matrix", J. Guidance and Control 1978; each row of 4 q q^T is along q.
    """
    (a, d, g), (b, e, h), (c, f, i) = rotations.transpose(2, 1, 0)
    rows = np.array([
        [1.0 + a - e - i, b + d, c + g, h - f],
        [b + d, 1.0 + e - a - i, f + h, c - g],
        [c + g, f + h, 1.0 + i - a - e, d - b],
        [h - f, c - g, d - b, 1.0 + a + e + i],
    ])  # fmt: skip
    number, largest = np.arange(len(rotations)), np.array([a, e, i]).argmax(axis=0)
    largest[a + e + i > 0.0] = 3
    chosen = rows[largest, :, number]
    quaternions: Array = chosen / (2.0 * np.sqrt(chosen[number, largest]))[:, None]
    return quaternions
