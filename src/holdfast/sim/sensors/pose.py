"""Absolute poses, as of a map matcher or a marker, in a frame that may be offset from W."""

from math import hypot
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from holdfast.config.section import Vector3, quantity
from holdfast.sim.datasheets import SimulatedSensor, correlation_s, positive
from holdfast.sim.effects import jump, offset
from holdfast.sim.readings import Readings, elapsed, slow_vectors
from holdfast.sim.ros import WORLD, Encode, RosMessages
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import SensorKind, register

MESSAGE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class SimulatedPose(SimulatedSensor):
    """An absolute pose, of a map matcher or a marker, in a frame of its own that may be offset from W."""

    kind: Literal["pose"]
    jitter_m: float = quantity("m", 0.02, ge=0, doc="sigma of the white part, per axis")
    jitter_rad: float = quantity("rad", 3e-3, ge=0, doc="sigma of the white part, per axis")
    slow_m: float = quantity("m", 0.02, ge=0, doc="sigma of the slow part, per axis")
    slow_rad: float = quantity("rad", 3e-3, ge=0, doc="sigma of the slow part, per axis")
    time_constant_s: float = quantity("s", 10.0, gt=0, doc="the slow part decorrelates in this time")
    offset_m: Vector3 = quantity("m", (0.0, 0.0, 0.0), doc="origin of its frame in W; the owner knows the size only")
    offset_yaw_deg: float = quantity("deg", 0.0, ge=-180, le=180, doc="yaw of its frame in W; as above")


def measure(at: Sampling) -> Readings:
    """Return the poses T_M_F of a frame F in the frame M of the source.

    T_M_F = T_W_M^-1 (p_W + e_p, R_W_F Exp(e_R)) with the constant offset T_W_M of the datasheet and errors
    e = jitter n + slow m, n white and m a Gauss-Markov process, both of unit variance on every axis.

    Columns:
        position: (N, 3) of F in M [m].
        quaternion: (N, 4) x, y, z, w of R_M_F.
        covariance: (N, 6) variances in the order of ROS, translation [m^2] and rotation [rad^2].
    """
    sheet, moving, times_s, rng = at.sheet, at.moving, at.times_s, at.rng
    steps, shape = elapsed(times_s, sheet.time_constant_s), moving.p_W.shape
    error_m = sheet.jitter_m * rng.standard_normal(shape) + sheet.slow_m * slow_vectors(rng, steps)
    error_rad = sheet.jitter_rad * rng.standard_normal(shape) + sheet.slow_rad * slow_vectors(rng, steps)
    R_M_W = Rotation.from_euler("z", sheet.offset_yaw_deg, degrees=True).inv()
    attitude = R_M_W * Rotation.from_matrix(moving.R_W_F) * Rotation.from_rotvec(error_rad)
    variances = [sheet.jitter_m**2 + sheet.slow_m**2] * 3 + [sheet.jitter_rad**2 + sheet.slow_rad**2] * 3
    columns = {
        "position": R_M_W.apply(moving.p_W + error_m - sheet.offset_m),
        "quaternion": attitude.as_quat(),
        "covariance": np.tile(variances, (len(times_s), 1)),
    }
    return Readings(times_s, columns)


def encode(ros: RosMessages, _sheet: SimulatedPose, readings: Readings) -> Encode:
    """Return what makes a geometry_msgs/PoseWithCovarianceStamped."""
    positions, quaternions, variances = (readings.values[name] for name in ("position", "quaternion", "covariance"))
    return lambda row, stamp_ns: ros.make(
        MESSAGE,
        header=ros.header(stamp_ns, WORLD),
        pose=ros.pose(positions[row], quaternions[row], variances[row]),
    )


def entry(sheet: SimulatedPose) -> dict[str, Any]:
    """Return what the datasheet says, not its true errors."""
    return positive(
        position_sigma_m=hypot(sheet.jitter_m, sheet.slow_m),
        rotation_sigma_rad=hypot(sheet.jitter_rad, sheet.slow_rad),
        offset_sigma_m=hypot(*sheet.offset_m),
        offset_sigma_deg=abs(sheet.offset_yaw_deg),
        correlation_s=correlation_s(sheet.jitter_m, sheet.slow_m, sheet.time_constant_s),
    )


FAULTS = {"offset": offset, "jump": jump}
EXAMPLE = ("markers", {"frame": "lidar", "rate_hz": 5, "topic": "/markers"})
register(SensorKind(SimulatedPose, measure, MESSAGE, encode, entry, faults=FAULTS, gives_heading=True, example=EXAMPLE))
