"""The map that sweeps are aligned to: a grid of Gaussians, which a sweep joins when it has shown what in it stays.

A truck that drives off was never where nothing had been, so nothing tells its rear from the world, and mapped it draws
the lidar along. A moment later the lidar looks through where the rear was. So a sweep waits, and loses what is looked
through by then. That it waits is good where the world stands still, too: where rays follow the same pattern in each
sweep, alignment is pulled towards the sweeps that have just been mapped.
"""

from collections import deque
from dataclasses import dataclass

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray

from holdfast.lidar_odometry.free_space import FreeSpace
from holdfast.lidar_odometry.planes import Planes, points_of
from holdfast.messages import Array

PARTNER_M = 1.0
EPSILON_RAD, EPSILON_M = 3e-4, 3e-3  # what scans are known by against each other: the first smaller step is the last
MEMORY_SWEEPS = 3000  # ten minutes at 5 Hz: a machine that returns finds its map
WAIT_NS, WAIT_M = 2 * 10**9, 2.0  # a person goes on by 2 m, a truck by half its length; the lidar's view changes little
ENOUGH = 0.7  # of a sweep meets the map where it is known; with less, what waits is needed


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A sweep that has a pose.

    Attributes:
        cloud: of the world that stays, thinned, with planes.
        T_L0_L: pose, by which points in L are in the frame of the map.
        at_ns: when.
        unheld: number of directions in which its pose is guessed.
    """

    cloud: small_gicp.PointCloud
    T_L0_L: gtsam.Pose3
    at_ns: int
    unheld: int = 0


class ScanMap:
    """What sweeps before have seen; deterministic with one thread, and of constant size.

    Args:
        voxel_m: cell of the grid [m].
        threads: of the library.
    """

    def __init__(self, voxel_m: float, threads: int) -> None:
        self._threads = threads
        self._voxels = small_gicp.GaussianVoxelMap(voxel_m)
        self._voxels.set_lru(MEMORY_SWEEPS, 100)
        self._free = FreeSpace()
        self._waiting: deque[Placed] = deque()
        self._began_ns: int | None = None

    def differing(self, points: Array, T_L0_L: gtsam.Pose3) -> NDArray[np.bool_]:
        """Return which points (N, 3) of a sweep [m], in L at a pose, were not there to be seen a moment ago."""
        return self._free.differing(points, T_L0_L)

    def align(self, cloud: small_gicp.PointCloud, guess: gtsam.Pose3) -> small_gicp.RegistrationResult:
        """Return the pose of a cloud with planes, near a guess."""
        return small_gicp.align(
            self._voxels,
            cloud,
            guess.matrix(),
            max_correspondence_distance=PARTNER_M,
            num_threads=self._threads,
            rotation_epsilon=EPSILON_RAD,
            translation_epsilon=EPSILON_M,
        )

    def add(self, sweep: Placed, points: Array, own: Array, met: float) -> None:
        """Take in a sweep, in which the library goes over all voxels.

        Args:
            sweep: later than those before.
            points: (N, 3) all of the world in it, in L [m].
            own: (M, 3) those on the machine itself.
            met: share of its points that met the map.
        """
        if self._began_ns is None:
            self._began_ns = sweep.at_ns
        if sweep.unheld:  # how the lidar has moved since what it saw before is a guess
            self._free = FreeSpace()
        self._free.add(points, own, sweep.T_L0_L, sweep.at_ns * 1e-9)
        self._waiting.append(sweep)
        is_needed = met < ENOUGH or sweep.at_ns - self._began_ns < WAIT_NS or not self._free.looks_around
        while self._waiting and (is_needed or _has_waited(self._waiting[0], sweep)):
            waited = self._waiting.popleft()
            self._voxels.insert(self._staying(waited, sweep), waited.T_L0_L.matrix())

    def _staying(self, waited: Placed, newest: Placed) -> small_gicp.PointCloud:
        """Return what of a sweep is still there."""
        if waited is newest or waited.unheld or newest.unheld:
            return waited.cloud
        points = points_of(waited.cloud)
        gone = self._free.looked_through(points, waited.T_L0_L)
        if not gone.any():
            return waited.cloud
        return Planes.around(small_gicp.PointCloud(points[~gone]), self._threads).cloud


def _has_waited(sweep: Placed, newest: Placed) -> bool:
    moved_m = float(np.linalg.norm(sweep.T_L0_L.translation() - newest.T_L0_L.translation()))
    return newest.at_ns - sweep.at_ns >= WAIT_NS or moved_m > WAIT_M
