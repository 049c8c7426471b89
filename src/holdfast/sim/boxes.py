"""Boxes that move, and where the rays of a sweep meet them: each at the box as it stands when the ray is measured."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from holdfast.messages import Array


@dataclass(frozen=True, slots=True, eq=False)
class BoxMotion:
    """How one box moves.

    Attributes:
        R_W_X: (N, 3, 3) axes of the box.
        p_W: (N, 3) its middle [m].
        half_size: (3,) half of length, width and height [m].
    """

    R_W_X: Array
    p_W: Array
    half_size: Array


class MovingBoxes(Protocol):
    """What moves, as boxes."""

    def at(self, times_s: Array) -> list[BoxMotion]:
        """Return how every box moves at true times (N,) [s]."""


def distances(boxes: list[BoxMotion], rays: Array, R_W_L: Array, p_W: Array) -> Array:
    """Return how far (columns, channels) each ray goes until it meets a box from outside [m]; infinity where none.

    Args:
        boxes: at the times of the columns.
        rays: (columns, channels, 3) unit vectors in L.
        R_W_L: (columns, 3, 3) attitude of the lidar.
        p_W: (columns, 3) its position [m].
    """
    nearest = np.full(rays.shape[:2], np.inf)
    heading = np.arctan2(rays[:, 0, 1], rays[:, 0, 0])
    for box in boxes:
        seen = _columns_towards(box, heading, R_W_L, p_W)
        if len(seen):
            nearest[seen] = np.minimum(nearest[seen], _entry(box, seen, rays, R_W_L, p_W))
    return nearest


def _columns_towards(box: BoxMotion, heading: Array, R_W_L: Array, p_W: Array) -> np.ndarray:
    """Return the columns whose rays may meet the sphere around a box."""
    radius_m = float(np.linalg.norm(box.half_size))
    middle = np.einsum("nji,nj->ni", R_W_L, box.p_W - p_W)
    away_m = np.hypot(middle[:, 0], middle[:, 1])
    wide = np.arcsin(np.minimum(radius_m / np.maximum(away_m, 1e-9), 1.0))
    off = np.abs(np.remainder(np.arctan2(middle[:, 1], middle[:, 0]) - heading + np.pi, 2.0 * np.pi) - np.pi)
    return np.flatnonzero((away_m <= radius_m) | (off <= wide))


def _entry(box: BoxMotion, columns: np.ndarray, rays: Array, R_W_L: Array, p_W: Array) -> Array:
    """Return the distance (len(columns), channels) to where the rays enter the box [m], or infinity (slab method)."""
    R_X_W = box.R_W_X[columns].transpose(0, 2, 1)
    origin = np.einsum("nij,nj->ni", R_X_W, p_W[columns] - box.p_W[columns])[:, None]
    directions = rays[columns] @ (R_X_W @ R_W_L[columns]).transpose(0, 2, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-box.half_size - origin) / directions, (box.half_size - origin) / directions
    enter = np.minimum(first, second).max(axis=2)
    leave = np.maximum(first, second).min(axis=2)
    return np.asarray(np.where((enter < leave) & (enter > 0.0), enter, np.inf))
