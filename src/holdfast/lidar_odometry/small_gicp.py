"""small_gicp: scan-to-map VGICP; what makes an odometry of the library's alignment is here.

The map is a grid of Gaussians, the cloud is thinned and has a plane around each point. The settings follow from a site
of 100 m: voxels of 0.5 m hold two rings of ground up to 20 m from a lidar 3 m high with a ray every 0.7 deg; a cabin
that starts to slew with 0.6 rad/s^2 departs from a constant rate by 0.5 m at 20 m between two sweeps at 5 Hz, and so
far points must look for a partner. On ray-cast sites voxels of 1 m cost a third more error where the
ground is bare and nothing elsewhere, and half or twice the other values change errors by less than a fifth.
"""

import gtsam
import numpy as np
import small_gicp

from holdfast.lidar_odometry.degeneracy import Degeneracy, Observability
from holdfast.lidar_odometry.deskew import Rates, deskew
from holdfast.lidar_odometry.registration import Registered
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.messages import Array

VOXEL_M = 0.5
RESOLUTION_M = 0.25
COARSE = 2.0  # times that resolution is the first pass where nothing measures the rotation: it finds the motion
DESKEWED_M = 0.01  # a velocity that errs by so much over half a sweep is worth a second pass
NEIGHBOURS = 10
PARTNER_M = 1.0
EPSILON_RAD, EPSILON_M = 5e-5, 5e-4  # a fifth of what scans are known by against each other
MEMORY_SWEEPS = 3000  # ten minutes at 5 Hz: a machine that returns finds its map
# neighbouring points have the error of their voxel in common, which H takes for independent: on two ray-cast sites
# s^2 H^-1 is right for new noise at one position, and 2.3 to 3.6 times too small over positions; deskewing errors add
CORRELATION = 3.0
LOST_INLIER_FRACTION = 0.4  # it is 0.7 at the edge of the map and 1 within; flat ground alone fits anywhere
MAX_GAP_S = 1.0  # the motion in a longer one is unknown
NEVER_NS = -(1 << 62)


class SmallGicp:
    """An odometry whose poses refer to the middle of the sweep, where deskewing errs least.

    Between sweeps the lidar is predicted, and during a sweep its points are deskewed, with the gyroscope's rotation if
    the sweep brings it, else with a constant rate; in either case with a constant velocity. They come from the last
    two sweeps, and again from this one once it is aligned, because a cabin starts and stops within one: without a
    gyroscope always, after a coarse pass, else where the velocity has changed. In directions that the sweep does not
    hold, the prediction stays.

    Args:
        threads: of the library; more than one varies the bits.
        map_voxel_m: cell of the map [m].
        scan_voxel_m: of a scan one point is used per cell [m].
    """

    def __init__(self, threads: int, map_voxel_m: float = VOXEL_M, scan_voxel_m: float = RESOLUTION_M) -> None:
        self._threads = threads
        self._map_voxel_m, self._scan_voxel_m = map_voxel_m, scan_voxel_m
        self._at_ns = NEVER_NS
        self._T_L0_L = gtsam.Pose3()
        self._angular = np.zeros(3)
        self._velocity = np.zeros(3)
        self._map = small_gicp.GaussianVoxelMap(map_voxel_m)
        self._degeneracy = Degeneracy()
        self._found: Observability | None = None  # of the sweep before; the coarse pass is too coarse to tell

    def register(self, sweep: Sweep) -> Registered:
        """Join the next sweep to the map; the first one makes the map."""
        at_s = sweep.middle_s
        at_ns = sweep.stamp_ns + round(at_s * 1e9)
        interval_s = (at_ns - self._at_ns) * 1e-9
        if interval_s > MAX_GAP_S:
            self._angular, self._velocity = np.zeros(3), np.zeros(3)
            return self._begin(sweep, at_s, self._T_L0_L)
        rotation = self._rates(sweep).rotation(at_s - interval_s, at_s)
        guess = T_L0_L = self._T_L0_L.compose(gtsam.Pose3(rotation, self._velocity * interval_s))
        self._velocity = rotation.unrotate(self._velocity)
        is_guided, found, has_looked = sweep.rates is not None, self._found, False
        for resolution_m in (
            [self._scan_voxel_m] * 2 if is_guided else [COARSE * self._scan_voxel_m, self._scan_voxel_m]
        ):
            (cloud, tree), deskewed_by = self._cloud(sweep, at_s, resolution_m), self._velocity
            result = self._align(cloud, T_L0_L)
            if result.num_inliers < LOST_INLIER_FRACTION * cloud.size():
                return self._begin(sweep, at_s, T_L0_L)
            if resolution_m == self._scan_voxel_m and not has_looked:
                guessed_motion = self._T_L0_L.between(guess).matrix()
                has_looked, found = True, self._degeneracy.look(_points(cloud), tree, guessed_motion)
            T_L0_L = _where_held(found, guess, gtsam.Pose3(result.T_target_source))
            motion = self._T_L0_L.between(T_L0_L)
            self._velocity = motion.rotation().unrotate(motion.translation()) / interval_s
            self._angular = gtsam.Rot3.Logmap(motion.rotation()) / interval_s
            if is_guided and np.linalg.norm(self._velocity - deskewed_by) * sweep.half_s < DESKEWED_M:
                break
        self._map.insert(cloud, T_L0_L.matrix())
        self._at_ns, self._T_L0_L = at_ns, T_L0_L
        assert found is not None
        self._found = found
        guessed = self._degeneracy.guess_covariance(interval_s, found, sweep.rates is not None)
        claimed = found.covariance(covariance(result), guessed, gtsam.Pose3.Logmap(motion))
        return Registered(at_ns, T_L0_L.matrix(), claimed, unheld=found.unheld)

    def _begin(self, sweep: Sweep, at_s: float, T_L0_L: gtsam.Pose3) -> Registered:
        at_ns, restarted = sweep.stamp_ns + round(at_s * 1e9), self._at_ns > NEVER_NS
        self._map = small_gicp.GaussianVoxelMap(self._map_voxel_m)
        self._map.set_lru(MEMORY_SWEEPS, 100)
        cloud, tree = self._cloud(sweep, at_s, self._scan_voxel_m)
        self._map.insert(cloud, T_L0_L.matrix())
        self._degeneracy, self._found = Degeneracy(), None
        self._degeneracy.look(_points(cloud), tree, np.eye(4))
        self._at_ns, self._T_L0_L = at_ns, T_L0_L
        return Registered(at_ns, T_L0_L.matrix(), restarted=restarted)

    def _rates(self, sweep: Sweep) -> Rates:
        return sweep.rates or Rates.constant(self._angular)

    def _cloud(self, sweep: Sweep, at_s: float, resolution_m: float) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
        """Return a sweep as from one instant, thinned, with a plane around each point, and the tree of its points."""
        points = sweep.points
        if sweep.offsets_s is not None:
            points = deskew(points, sweep.offsets_s, at_s, self._rates(sweep), self._velocity)
        cloud, tree = small_gicp.preprocess_points(points, resolution_m, NEIGHBOURS, self._threads)
        return cloud, tree

    def _align(self, cloud: small_gicp.PointCloud, guess: gtsam.Pose3) -> small_gicp.RegistrationResult:
        return small_gicp.align(
            self._map,
            cloud,
            guess.matrix(),
            max_correspondence_distance=PARTNER_M,
            num_threads=self._threads,
            rotation_epsilon=EPSILON_RAD,
            translation_epsilon=EPSILON_M,
        )


def _points(cloud: small_gicp.PointCloud) -> Array:
    return np.asarray(cloud.points())[:, :3]


def _where_held(found: Observability | None, guess: gtsam.Pose3, aligned: gtsam.Pose3) -> gtsam.Pose3:
    """Return the aligned pose where the scan holds it, else the guess."""
    if found is None or not found.unheld:
        return aligned
    return guess.compose(gtsam.Pose3.Expmap(found.held_part(gtsam.Pose3.Logmap(guess.between(aligned)))))


def covariance(result: small_gicp.RegistrationResult) -> Array:
    """Return the covariance (6, 6) of an alignment: rotation [rad], then translation [m], expressed in L.

    The library minimises e = 1/2 sum r^T M r over T Exp(delta), delta rotation first, so its Hessian H is that of
    GTSAM's tangent. M is the library's guess (planes 3 cm thick), scaled by the residuals: s^2 = 2 e / (n - 6), as
    each of n points is measured across its plane only. The covariance is CORRELATION s^2 H^-1.
    """
    ratio = CORRELATION * 2.0 * result.error / max(result.num_inliers - 6, 1)
    scaled: Array = ratio * np.linalg.inv(result.H)
    return scaled
