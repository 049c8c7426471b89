"""An odometry as a statistical model: true relative motion, with drift that accumulates and jitter that does not."""

from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from holdfast.config.section import quantity
from holdfast.messages import Array
from holdfast.sim.datasheets import SimulatedSensor
from holdfast.sim.effects import freezing, jump
from holdfast.sim.readings import Readings
from holdfast.sim.ros import NOTHING, Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register

MESSAGE = "nav_msgs/msg/Odometry"


class SimulatedOdometry(SimulatedSensor):
    """An odometry as a statistical model, of a lidar or a camera: its pose since the start, with jitter and drift."""

    kind: Literal["odometry"]
    jitter_m: float = quantity("m", 0.005, ge=0, doc="sigma of each pose, per axis")
    jitter_rad: float = quantity("rad", 3e-4, ge=0, doc="sigma of each pose, per axis")
    drift_m_per_sqrt_m: float = quantity("m/sqrt(m)", 0.01, ge=0, doc="random walk of the position, per distance")
    drift_rad_per_sqrt_m: float = quantity("rad/sqrt(m)", 5e-4, ge=0, doc="random walk of the attitude, per distance")
    drift_rad_per_sqrt_rad: float = quantity("sqrt(rad)", 1e-3, ge=0, doc="random walk of the attitude, per rotation")


def measure(at: Sampling) -> Readings:
    """Return the poses T_F0_F of a sensor F whose odometry starts at the first time.

    T_F0_F(k) = D_1 E_1 D_2 E_2 ... D_k E_k J_k: D is the true motion between two poses, E the drift over it, whose
    sigmas are the datasheet's densities times the square root of distance or rotation, J the jitter of one pose.

    Columns:
        position: (N, 3) of F in F0 [m].
        quaternion: (N, 4) x, y, z, w.
        covariance: (N, 6) variances in the order of ROS, translation [m^2] and rotation [rad^2]: those of the jitter,
            because a registration cannot observe its drift.
    """
    sheet, moving, times_s, rng = at.sheet, at.moving, at.times_s, at.rng
    before, after = moving.R_W_F[:-1], moving.R_W_F[1:]
    R_true = before.transpose(0, 2, 1) @ after
    p_true = np.einsum("nji,nj->ni", before, np.diff(moving.p_W, axis=0))
    distance_m = np.linalg.norm(p_true, axis=1, keepdims=True)
    rotation_rad = Rotation.from_matrix(R_true).magnitude()[:, None]
    sigma_rad = np.sqrt(sheet.drift_rad_per_sqrt_m**2 * distance_m + sheet.drift_rad_per_sqrt_rad**2 * rotation_rad)
    drift = poses(
        sigma_rad * rng.standard_normal(p_true.shape),
        sheet.drift_m_per_sqrt_m * np.sqrt(distance_m) * rng.standard_normal(p_true.shape),
    )
    steps = np.tile(np.eye(4), (len(times_s), 1, 1))
    steps[1:, :3, :3], steps[1:, :3, 3] = R_true, p_true
    steps[1:] = steps[1:] @ drift
    shape = (len(times_s), 3)
    jitter = poses(sheet.jitter_rad * rng.standard_normal(shape), sheet.jitter_m * rng.standard_normal(shape))
    T_F0_F = _running_product(steps) @ jitter
    columns = {
        "position": T_F0_F[:, :3, 3],
        "quaternion": Rotation.from_matrix(T_F0_F[:, :3, :3]).as_quat(),
        "covariance": np.tile(np.repeat([sheet.jitter_m**2, sheet.jitter_rad**2], 3), (len(times_s), 1)),
    }
    return Readings(times_s, columns)


def poses(rotation_vectors: Array, translations: Array) -> Array:
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


def encode(ros: RosMessages, sheet: SimulatedOdometry, readings: Readings) -> Encode:
    """Return what makes a nav_msgs/Odometry whose twist is not known."""
    positions, quaternions, variances = (readings.values[name] for name in ("position", "quaternion", "covariance"))
    unknown_twist = ros.twist(NOTHING, NOTHING, np.zeros(6))
    return lambda row, stamp_ns: ros.make(
        MESSAGE,
        header=ros.header(stamp_ns, f"{sheet.frame}_odom"),
        child_frame_id=sheet.frame,
        pose=ros.pose(positions[row], quaternions[row], variances[row]),
        twist=unknown_twist,
    )


EXAMPLE = ("camera", {"frame": "lidar", "rate_hz": 10, "topic": "/camera"})
FAULTS = {"jump": jump, "freeze": freezing("position", "quaternion")}
register(SensorKind(SimulatedOdometry, measure, MESSAGE, encode, faults=FAULTS, example=EXAMPLE))
