"""Points on the machine itself, cut out of a sweep: by boxes that are given, and by what is learnt of its body and arm.

Whatever belongs to the machine moves with the lidar: where one of its points was, seen from the world, there is nothing
any more when the machine has moved on. So each point near the lidar is looked for again from the next place: a ray that
goes through where it was says that it has moved on, a return there says that it stands in the world. Votes are counted
in voxels of the lidar's frame. The ground is always in the same voxels, too, but its points are still there, so it is
kept; so is a person who walked by once. An arm that moves leaves votes in all that it sweeps. Who stands still sees
nothing of this, and learns nothing.
"""

from collections import deque
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.geometry.motions import size_of
from holdfast.lidar_odometry.range_image import BINS, ROWS, Rays, lengths, pixels, with_neighbours
from holdfast.messages import Array

REACH_M = 10.0  # beyond it nothing is the machine's
VOXEL_M = 0.25
CELLS = int(2 * REACH_M / VOXEL_M)
STEP_RAD, STEP_M = 0.15, 0.5  # the lidar is at another place
APART_M = 0.6  # a point that the motion between two places moved by less in the lidar's frame says nothing
FREE_M = 0.4  # a ray that goes on so far behind a point went through it
SAME_M = 0.15  # a ray that ends so near to a point met it
ENOUGH = 3.0  # votes; each is of another place
RATIO = 0.5  # of votes that it stands, as it seems to where another part of the machine is now
PLACES = 16  # a point near the turn joint has moved on only after two radians
MEMORY = 0.98  # of votes at each place: half are forgotten after 34

Boxes = tuple[tuple[Array, Array], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Where the lidar was, and its points within reach, thinned."""

    T_L0_L: gtsam.Pose3
    points: Array


class MachineMask:
    """Which points of a sweep are the machine's; deterministic, and of constant size.

    Args:
        boxes: corners (3,), (3,) [m] in the lidar's frame, of parts of the machine that are known.
        learning: whether the rest is learnt.
    """

    def __init__(self, boxes: Boxes = (), learning: bool = True) -> None:
        self._boxes = boxes
        self._learning = learning
        self._gone = np.zeros(CELLS**3, dtype=np.float32)
        self._stood = np.zeros(CELLS**3, dtype=np.float32)
        self._masked = np.zeros(CELLS**3, dtype=np.bool_)
        self._rays = Rays()
        self._places: deque[_Place] = deque(maxlen=PLACES)

    def covers(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (N, 3), in the lidar's frame [m], are the machine's."""
        inside = np.zeros(len(points), dtype=np.bool_)
        for low, high in self._boxes:
            inside |= np.all((points >= low) & (points <= high), axis=1)
        if self._learning:
            near = np.flatnonzero(_is_near(points))
            inside[near] |= self._masked[_cells(points[near])]
        return inside

    def is_due(self, T_L0_L: gtsam.Pose3) -> bool:
        """Whether the lidar has moved on, so that a sweep from here would teach something."""
        return self._learning and not (self._places and not _has_moved(self._places[-1].T_L0_L.between(T_L0_L)))

    def forget_places(self) -> None:
        """Compare with no place before: how the lidar has moved since is not known."""
        self._places.clear()

    def learn(self, points: Array, T_L0_L: gtsam.Pose3) -> None:
        """Take in all points (N, 3) of a sweep [m], also those that are covered, and where the lidar was."""
        if not self.is_due(T_L0_L):
            return
        image = _range_image(points, self._rays)
        if self._places:
            self._vote(T_L0_L, image)
        near = points[_is_near(points)]
        self._places.append(_Place(T_L0_L, _thinned(near)))

    def _vote(self, T_L0_L: gtsam.Pose3, image: Array) -> None:
        """Look for the points of the places before from here."""
        gone, stood = (np.zeros(CELLS**3, dtype=np.bool_) for _ in range(2))
        for place in self._places:
            L_place = T_L0_L.between(place.T_L0_L)
            seen = place.points @ L_place.rotation().matrix().T + L_place.translation()
            distances = lengths(seen)
            nearest = image[pixels(seen)]
            decides = lengths(seen - place.points) > APART_M
            cells = _cells(place.points)
            gone[cells[decides & (nearest > distances + FREE_M)]] = True
            stood[cells[decides & (np.abs(nearest - distances) < SAME_M)]] = True
        self._gone = MEMORY * self._gone + gone
        self._stood = MEMORY * self._stood + stood
        machine = (self._gone >= ENOUGH) & (self._gone > RATIO * self._stood)
        self._masked = _grown(machine) & (self._gone > RATIO * self._stood)


def _has_moved(motion: gtsam.Pose3) -> bool:
    moved_m, turned_rad = size_of(motion)
    return turned_rad > STEP_RAD or moved_m > STEP_M


def _is_near(points: Array) -> NDArray[np.bool_]:
    x, y, z = np.abs(points.T) < REACH_M
    return np.asarray(x & y & z)


def _cells(points: Array) -> NDArray[np.intp]:
    """Return the voxel (N,) of points within reach."""
    index = np.clip(((points + REACH_M) / VOXEL_M).astype(np.intp), 0, CELLS - 1)
    return np.asarray((index[:, 0] * CELLS + index[:, 1]) * CELLS + index[:, 2])


def _thinned(points: Array) -> Array:
    """Return one point of each voxel, the first."""
    _, first = np.unique(_cells(points), return_index=True)
    return points[np.sort(first)]


def _grown(machine: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the voxels and their six neighbours: a surface lies now in one, now in the next."""
    cube = machine.reshape(CELLS, CELLS, CELLS)
    grown = cube.copy()
    for axis in range(3):
        grown |= np.roll(cube, 1, axis) | np.roll(cube, -1, axis)
    return grown.ravel()


def _range_image(points: Array, rays: Rays) -> Array:
    """Return (ROWS, BINS) the nearest return in a direction and around it [m]; `rays` is completed by what is seen.

    Where no ray came back it is infinite, as before the sky; above and below all rays, and where the lidar may not have
    looked, it is zero, so that nothing is decided there.
    """
    image = np.full((ROWS, BINS), np.inf)
    at = pixels(points)
    np.minimum.at(image, at, lengths(points))
    rays.add(at)
    image[rays.unknown(at)] = 0.0
    return with_neighbours(rays.between(image, np.minimum, beyond=0.0), np.minimum)
