"""Lidar odometry as a statistical model: true relative motion, with drift that accumulates and jitter that does not."""

import numpy as np
from scipy.spatial.transform import Rotation

from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedLidarOdometry
from holdfast.sim.motion import FrameMotion
from holdfast.sim.readings import Readings


def odometry_readings(
    sheet: SimulatedLidarOdometry, lidar: FrameMotion, times_s: Array, rng: np.random.Generator
) -> Readings:
    """Return the poses T_L0_L of a lidar whose odometry starts at the first time.

    T_L0_L(k) = D_1 E_1 D_2 E_2 ... D_k E_k J_k: D is the true motion between two poses, E the drift over it, whose
    sigmas are the datasheet's densities times the square root of way or turn, J the jitter of one pose.

    Args:
        sheet: of the odometry.
        lidar: (N,) motion of the lidar at `times_s`.
        times_s: (N,) true times of the poses.
        rng: of this sensor.

    Columns:
        position: (N, 3) of L in L0 [m].
        quaternion: (N, 4) x, y, z, w.
        covariance: (N, 6) variances in the order of ROS, translation [m^2] and rotation [rad^2]: those of the jitter,
            because a registration knows nothing of its drift.
    """
    before, after = lidar.R_W_F[:-1], lidar.R_W_F[1:]
    R_true = before.transpose(0, 2, 1) @ after
    p_true = np.einsum("nji,nj->ni", before, np.diff(lidar.p_W, axis=0))
    way_m = np.linalg.norm(p_true, axis=1, keepdims=True)
    turn_rad = Rotation.from_matrix(R_true).magnitude()[:, None]
    sigma_rad = np.sqrt(sheet.drift_rad_per_sqrt_m**2 * way_m + sheet.drift_rad_per_sqrt_rad**2 * turn_rad)
    drift = _poses(
        sigma_rad * rng.standard_normal(p_true.shape),
        sheet.drift_m_per_sqrt_m * np.sqrt(way_m) * rng.standard_normal(p_true.shape),
    )
    steps = np.tile(np.eye(4), (len(times_s), 1, 1))
    steps[1:, :3, :3], steps[1:, :3, 3] = R_true, p_true
    steps[1:] = steps[1:] @ drift
    shape = (len(times_s), 3)
    jitter = _poses(sheet.jitter_rad * rng.standard_normal(shape), sheet.jitter_m * rng.standard_normal(shape))
    T_L0_L = _running_product(steps) @ jitter
    columns = {
        "position": T_L0_L[:, :3, 3],
        "quaternion": Rotation.from_matrix(T_L0_L[:, :3, :3]).as_quat(),
        "covariance": np.tile(np.repeat([sheet.jitter_m**2, sheet.jitter_rad**2], 3), (len(times_s), 1)),
    }
    return Readings(times_s, columns)


def _poses(rotation_vectors: Array, translations: Array) -> Array:
    """Return (N, 4, 4) transforms from rotation vectors (N, 3) [rad] and translations (N, 3) [m]."""
    poses = np.tile(np.eye(4), (len(translations), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(rotation_vectors).as_matrix()
    poses[:, :3, 3] = translations
    return poses


def _running_product(steps: Array) -> Array:
    """Return (N, 4, 4) with steps[0] ... steps[k] in row k, in log2(N) rounds (Hillis and Steele, 1986)."""
    products, reach = steps.copy(), 1
    while reach < len(products):
        products[reach:] = products[:-reach] @ products[reach:]
        reach *= 2
    return products
