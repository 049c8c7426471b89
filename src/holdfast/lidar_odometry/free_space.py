"""What the lidar sees now that it did not see there a moment ago: people, trucks, its own arm, and what they hid.

A flat site holds a registration by little, so a truck that drives by pulls it along: its front lies where the truck
itself was seen the sweep before, and so does its rear. But a moment ago a ray went through where the front is now; and
the rear is where the truck hid the world. So each point is looked for in range images of some seconds: nearer than
all that was seen around that direction, it has come; farther than all, it was hidden. Neither is used. What stays is
there in every image some seconds later, and the map gets it then.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.lidar_odometry.range_image import BINS, ROWS, Pixels, Rays, lengths, pixels, with_neighbours
from holdfast.messages import Array

SPACING_S = 0.35  # between images: every second sweep at 5 Hz
# ages, in images, that a sweep is compared with, 0.4 to 10 s: a person has moved on by a step after the first, a truck
# of 7 m by its length after one of the next, and the machine does not hide the same places in all of them
AGES = (1, 3, 6, 12, 24)
HIDDEN_AGE = 1  # whatever was hidden longer ago has been seen since
# thinned points and deskewing err by decimetres where a surface is seen along itself, and by a part of the distance
DIFFERS_M, DIFFERS = 0.4, 0.02
REACHES = 0.75  # of its longest return is what the lidar sees of any surface; without a return nothing is nearer
SINGLE = np.float32  # half the time and memory; 10 um at 100 m
AROUND_M, ENOUGH = 0.7, 2  # cells of half a person; one point alone is noise
MOST = 0.3  # where more of a sweep differs, the pose that it is compared at is wrong, not the world


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """How near and how far was seen around each direction, from a pose; (ROWS, BINS) each [m].

    Where nothing is known the nearest is zero and the farthest infinite, so that nothing differs there.
    """

    T_L0_L: gtsam.Pose3
    at_s: float
    nearest: NDArray[Any]
    farthest: NDArray[Any]

    def before(self, points: NDArray[Any], T_L0_L: gtsam.Pose3) -> tuple[NDArray[Any], NDArray[Any], Pixels]:
        """Return what points (N, 3) in L at another pose are seen by from here.

        That is their distances (N,) [m], from how much on these differ from what was seen (N,) [m], and their pixels.
        """
        here = self.T_L0_L.between(T_L0_L)
        there = points @ here.rotation().matrix().T.astype(SINGLE) + here.translation().astype(SINGLE)
        distances = lengths(there)
        return distances, np.maximum(DIFFERS_M, DIFFERS * distances), pixels(there)


class FreeSpace:
    """Range images of the last seconds; deterministic, and of constant size."""

    def __init__(self) -> None:
        self._views: deque[_View] = deque(maxlen=AGES[-1])
        self._rays = Rays()

    @property
    def looks_around(self) -> bool:
        """Whether the lidar sees all directions around it, so that what it has seen it sees again."""
        return self._rays.go_around

    def differing(self, points: Array, T_L0_L: gtsam.Pose3) -> NDArray[np.bool_]:
        """Return which points (N, 3) of a sweep [m], in L at a pose, were not there to be seen a moment ago."""
        differs = np.zeros(len(points), dtype=np.bool_)
        points = points.astype(SINGLE)
        for age in AGES:
            if age > len(self._views):
                break
            view = self._views[-age]
            distances, apart, at = view.before(points, T_L0_L)
            differs |= distances < view.nearest[at] - apart
            if age <= HIDDEN_AGE:
                differs |= distances > view.farthest[at] + apart
        return _with_those_around(points, differs) if differs.mean() < MOST else np.zeros_like(differs)

    def looked_through(self, points: Array, T_L0_L: gtsam.Pose3) -> NDArray[np.bool_]:
        """Return which points (N, 3) of an earlier sweep [m], in L at its pose, the newest image looks through."""
        distances, apart, at = self._views[-1].before(points.astype(SINGLE), T_L0_L)
        through = distances < self._views[-1].nearest[at] - apart
        return through if through.mean() < MOST else np.zeros_like(through)

    def add(self, points: Array, own: Array, T_L0_L: gtsam.Pose3, at_s: float) -> None:
        """Take in a sweep.

        Args:
            points: (N, 3) of the world, all of them, in L [m].
            own: (M, 3) on the machine itself, that hide what is behind them.
            T_L0_L: where the lidar was.
            at_s: when, on any clock.
        """
        if self._views and at_s - self._views[-1].at_s < SPACING_S:
            return
        points, own = points.astype(SINGLE), own.astype(SINGLE)
        at, distances = pixels(points), lengths(points)
        self._rays.add(at)
        nearest = np.full((ROWS, BINS), REACHES * distances.max(), dtype=SINGLE)
        farthest = np.zeros((ROWS, BINS), dtype=SINGLE)
        np.minimum.at(nearest, at, distances)
        nearest[self._rays.unknown(at)] = 0.0
        np.maximum.at(farthest, at, distances)
        # no return is the sky, where the lidar has rays; but a part of the machine that is too near for it hides
        # the ground below as well
        nearest = self._rays.between(nearest, np.minimum, beyond=0.0)
        farthest = self._rays.between(farthest, np.maximum, beyond=0.0)
        widened = with_neighbours(farthest, np.maximum)
        nearest[~np.logical_or.accumulate(widened > 0.0, axis=0)] = 0.0
        farthest = np.where(widened > 0.0, widened, SINGLE(np.inf))
        np.minimum.at(nearest, pixels(own), lengths(own))
        nearest, farthest = with_neighbours(nearest, np.minimum), with_neighbours(farthest, np.maximum)
        self._views.append(_View(T_L0_L, at_s, nearest, farthest))


def _with_those_around(points: NDArray[Any], differs: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which points (N, 3) [m] differ or are in or beside a cell in which some do.

    Low on a truck the ground before it is as near, and where a person ends the image sees past.
    """
    cells = np.floor(points / AROUND_M).astype(np.int64)
    strides = np.array([1 << 40, 1 << 20, 1])
    keys = cells @ strides
    found, counts = np.unique(keys[differs], return_counts=True)
    beside = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3) @ strides
    around: NDArray[np.bool_] = np.isin(keys, found[counts >= ENOUGH, None] + beside)
    return differs | around
