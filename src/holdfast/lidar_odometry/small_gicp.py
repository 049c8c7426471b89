"""small_gicp: scan-to-map VGICP; what makes an odometry of the library's alignment is here.

The map is a grid of Gaussians (`scan_map`), the cloud is thinned and has a plane around each point. The settings follow
from a site of 100 m: voxels of 0.5 m hold two rings of ground up to 20 m from a lidar 3 m high with a ray every
0.7 deg; a cabin that starts to slew with 0.6 rad/s^2 departs from a constant rate by 0.5 m at 20 m between two sweeps
at 5 Hz, and so far points must look for a partner. On ray-cast sites voxels of 1 m cost a third more error where the
ground is bare and nothing elsewhere, and half or twice the other values change errors by less than a fifth.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import gtsam
import numpy as np
import small_gicp

from holdfast.config.sensors import MAP_VOXEL_M, SCAN_VOXEL_M
from holdfast.lidar_odometry.degeneracy import GYROSCOPE_RAD_S, Degeneracy, Observability
from holdfast.lidar_odometry.deskew import STILL, Moving, Rates, deskew
from holdfast.lidar_odometry.motion_filter import MotionFilter
from holdfast.lidar_odometry.pattern import Pattern
from holdfast.lidar_odometry.planes import Planes, points_of
from holdfast.lidar_odometry.registration import Registered, Registration
from holdfast.lidar_odometry.scan_map import Placed, ScanMap
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.messages import Array

COARSE = 2.0  # times that resolution is the first pass where nothing measures the rotation: it finds the motion
DESKEWED_M = 0.01  # a velocity that errs by so much over half a sweep is worth a second pass
FASTEST_M = 3.0  # between the first two sweeps: 15 m/s at 5 Hz
# neighbouring points have the error of their voxel in common, which H takes for independent: on two ray-cast sites
# s^2 H^-1 is right for new noise at one position, and 2.3 to 3.6 times too small over positions; deskewing errors add
CORRELATION = 3.0
LOST_INLIER_FRACTION = 0.4  # it is 0.7 at the edge of the map and 1 within; flat ground alone fits anywhere
MAX_GAP_S = 1.0  # the motion in a longer one is unknown
BLIND = 1e6 * np.eye(6)  # a guess without an IMU is nothing to weigh a registration by
NEVER_NS = -(1 << 62)


@dataclass(frozen=True, slots=True, eq=False)
class _First:
    """The first sweep of a map: the velocity is not known, so that the next one must be looked for."""

    sweep: Sweep
    planes: Planes
    T_L0_L: gtsam.Pose3

    def pose_of(self, cloud: small_gicp.PointCloud, guess: gtsam.Pose3, threads: int) -> gtsam.Pose3:
        """Return where the next sweep was: its points meet the nearest ones, not only those of their voxel."""
        result = small_gicp.align(
            self.planes.cloud,
            cloud,
            self.planes.tree,
            self.T_L0_L.between(guess).matrix(),
            max_correspondence_distance=FASTEST_M,
            num_threads=threads,
        )
        return self.T_L0_L.compose(gtsam.Pose3(result.T_target_source))


class SmallGicp(Registration):
    """An odometry whose poses refer to the middle of the sweep, where deskewing errs least.

    Between sweeps the lidar is predicted, and during a sweep its points are deskewed, with the rotation and the forces
    that an IMU measured if the sweep brings them, else with a constant rate and velocity. The velocity comes from the
    sweeps before, and again from this one once it is aligned, because a cabin starts and stops within one: without an
    IMU always, after a coarse pass, else where it has changed. In directions that the sweep does not hold, the
    prediction stays.

    Args:
        threads: of the library; more than one varies the bits.
        map_voxel_m: cell of the map [m].
        scan_voxel_m: of a scan one point is used per cell [m].
    """

    def __init__(self, threads: int, map_voxel_m: float = MAP_VOXEL_M, scan_voxel_m: float = SCAN_VOXEL_M) -> None:
        self._threads = threads
        self._map_voxel_m, self._scan_voxel_m = map_voxel_m, scan_voxel_m
        self._at_ns = NEVER_NS
        self._T_L0_L = gtsam.Pose3()
        self._angular = np.zeros(3)
        self._motion = MotionFilter.beginning()
        self._map = ScanMap(map_voxel_m, threads)
        self._join: Callable[[], None] | None = None  # the last sweep to the map
        self._first: _First | None = None  # of the map, until a second one shows the velocity
        self._pattern = Pattern()
        self._degeneracy = Degeneracy()
        self._found: Observability | None = None  # of the sweep before; the coarse pass is too coarse to tell

    def register(self, sweep: Sweep) -> Registered:
        """Return where the lidar was in the next sweep; the first one makes the map."""
        self.finish()
        self._pattern.add(sweep.points)
        return self._joined(sweep)

    def _joined(self, sweep: Sweep) -> Registered:
        """Return where the lidar was in a sweep, all before it being in the map."""
        at_s = sweep.middle_s
        at_ns = sweep.stamp_ns + round(at_s * 1e9)
        interval_s = (at_ns - self._at_ns) * 1e-9
        if interval_s > MAX_GAP_S:
            self._angular = np.zeros(3)
            return self._begin(sweep, self._T_L0_L)
        rates = self._rates(sweep)
        predicted, guess = self._motion.predicted(self._T_L0_L, rates, at_s - interval_s, at_s)
        guessed = BLIND if sweep.rates is None else predicted.covariance_of(guess, GYROSCOPE_RAD_S * interval_s)
        expected = self._T_L0_L.between(guess)
        way = gtsam.Pose3.Logmap(expected)
        T_L0_L, motion, is_guided, found = guess, predicted, sweep.rates is not None, None
        first, self._first = self._first, None
        for resolution_m in (
            [self._scan_voxel_m] * 2 if is_guided else [COARSE * self._scan_voxel_m, self._scan_voxel_m]
        ):
            deskewed_by = motion.moving(T_L0_L, rates)
            points = self._deskewed(sweep, at_s, deskewed_by)
            is_coarse = resolution_m > self._scan_voxel_m
            is_known = not is_coarse and first is None
            planes = self._planes(points, resolution_m, T_L0_L if is_known else None)
            cloud = planes.cloud
            result = self._map.align(cloud, T_L0_L if first is None else first.pose_of(cloud, T_L0_L, self._threads))
            if result.num_inliers < LOST_INLIER_FRACTION * cloud.size():
                return self._begin(sweep, T_L0_L)
            if not is_coarse and found is None:
                found = self._degeneracy.look(planes, expected.matrix(), self._pattern.repeats)
            known = found or self._found  # the coarse pass is too coarse to tell
            aligned, measured = gtsam.Pose3(result.T_target_source), covariance(result)
            if known is None:
                T_L0_L, unheld = aligned, np.zeros((3, 0))
            else:
                correction = gtsam.Pose3.Logmap(guess.between(aligned))
                doubted, unheld = known.doubted(way), known.unheld_axes
                T_L0_L = guess.compose(gtsam.Pose3.Expmap(known.held_part(correction, guessed, doubted)))
                measured = known.covariance(measured, np.zeros((6, 6)), doubted)
            motion = predicted.corrected(T_L0_L if unheld.size else aligned, rates, measured[3:, 3:], unheld)
            moved = self._T_L0_L.between(T_L0_L)
            self._angular = gtsam.Rot3.Logmap(moved.rotation()) / interval_s
            corrected_by = motion.moving(T_L0_L, rates).velocity - deskewed_by.velocity
            if is_guided and np.linalg.norm(corrected_by) * sweep.half_s < DESKEWED_M:
                break
            rates = self._rates(sweep)
        if first is not None:
            missed = motion.faster_than(predicted)
            if np.linalg.norm(missed) * first.sweep.half_s > DESKEWED_M:
                return self._begin_again(first.sweep, missed, sweep)
        assert found is not None
        placed = Placed(cloud, T_L0_L, at_ns, found.unheld)
        self._join = partial(self._map.add, placed, points, sweep.own, result.num_inliers / cloud.size())
        self._at_ns, self._T_L0_L, self._motion = at_ns, T_L0_L, motion
        self._found = found
        gone_on = self._degeneracy.guess_covariance(interval_s, found, is_guided)
        claimed = found.covariance(covariance(result), gone_on, found.joined(found.doubted(way), guessed))
        return Registered(at_ns, T_L0_L.matrix(), claimed, unheld=found.unheld)

    def finish(self) -> None:
        """Hand the last sweep to the map."""
        if self._join is not None:
            join, self._join = self._join, None
            join()

    def _begin(self, sweep: Sweep, T_L0_L: gtsam.Pose3, velocity: Array = STILL) -> Registered:
        """Begin a map with a sweep at a pose, deskewed with a velocity (3,) in L0 [m/s]."""
        at_s = sweep.middle_s
        at_ns, restarted = sweep.stamp_ns + round(at_s * 1e9), self._at_ns > NEVER_NS
        self._map = ScanMap(self._map_voxel_m, self._threads)
        rates = self._rates(sweep)
        self._motion = self._motion.placed(T_L0_L, rates, velocity)
        points = self._deskewed(sweep, at_s, self._motion.moving(T_L0_L, rates))
        planes = self._planes(points, self._scan_voxel_m, None)
        self._join = partial(self._map.add, Placed(planes.cloud, T_L0_L, at_ns), points, sweep.own, 1.0)
        self._degeneracy, self._found = Degeneracy(), None
        self._degeneracy.look(planes, np.eye(4))
        self._at_ns, self._T_L0_L, self._first = at_ns, T_L0_L, _First(sweep, planes, T_L0_L)
        return Registered(at_ns, T_L0_L.matrix(), restarted=restarted)

    def _begin_again(self, first: Sweep, velocity: Array, second: Sweep) -> Registered:
        """Begin with a sweep that was deskewed as at rest and, as the next one shows, was not."""
        self._begin(first, self._T_L0_L, velocity)
        self._first = None
        self.finish()
        return self._joined(second)

    def _rates(self, sweep: Sweep) -> Rates:
        return sweep.rates or Rates.constant(self._angular)

    def _deskewed(self, sweep: Sweep, at_s: float, moving: Moving) -> Array:
        """Return the points of a sweep as from one instant."""
        if sweep.offsets_s is None:
            return sweep.points
        return deskew(sweep.points, sweep.offsets_s, at_s, self._rates(sweep), moving)

    def _planes(self, points: Array, resolution_m: float, T_L0_L: gtsam.Pose3 | None) -> Planes:
        """Return points thinned, with a plane around each; at a pose without what differs there."""
        thinned = small_gicp.voxelgrid_sampling(points, resolution_m, self._threads)
        if T_L0_L is not None:
            kept = points_of(thinned)
            thinned = small_gicp.PointCloud(kept[~self._map.differing(kept, T_L0_L)])
        return Planes.around(thinned, self._threads)


def covariance(result: small_gicp.RegistrationResult) -> Array:
    """Return the covariance (6, 6) of an alignment: rotation [rad], then translation [m], expressed in L.

    The library minimises e = 1/2 sum r^T M r over T Exp(delta), delta rotation first, so its Hessian H is that of
    GTSAM's tangent. M is the library's guess (planes 3 cm thick), scaled by the residuals: s^2 = 2 e / (n - 6), as
    each of n points is measured across its plane only. The covariance is CORRELATION s^2 H^-1.
    """
    ratio = CORRELATION * 2.0 * result.error / max(result.num_inliers - 6, 1)
    scaled: Array = ratio * np.linalg.inv(result.H)
    return scaled
