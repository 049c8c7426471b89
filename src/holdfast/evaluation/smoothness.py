"""Does the odometry frame O jump? Each published T_O_I against the one before it, propagated by the IMU.

A controller that uses T_O_I at IMU rate must never see a step, whatever corrections the world pose takes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation import quaternions
from holdfast.evaluation.states import States, from_rotation_vector
from holdfast.messages import Array


@dataclass(frozen=True, slots=True, eq=False)
class Inertial:
    """What the IMU measured at N stamps, biases removed.

    Attributes:
        angular_velocity: (N, 3) in I [rad/s].
        acceleration: (N, 3) of I in O, gravity removed [m/s^2].
        received: (N,) the IMU had no drop-out from the stamp before to this one.
        gyroscope_bias: (N, 3) that was removed [rad/s].
    """

    angular_velocity: Array
    acceleration: Array
    received: NDArray[np.bool_]
    gyroscope_bias: Array


def steps(odometry: States, inertial: Inertial) -> tuple[Array, Array]:
    """Return by how much each T_O_I departs from the one before, propagated by the IMU: (N,) [m] and (N,) [deg].

    Readings are linear between samples: R_k = R_{k-1} Exp((w_{k-1} + w_k) dt / 2) and
    p_k = p_{k-1} + v_{k-1} dt + (2 a_{k-1} + a_k) dt^2 / 6. NaN in drop-outs of the IMU, and for the first.
    """
    poses, a, w = odometry.poses, inertial.acceleration, inertial.angular_velocity
    dt = np.diff(poses.stamps_ns)[:, None] * 1e-9
    p = poses.positions[:-1] + odometry.velocities[:-1] * dt + (2.0 * a[:-1] + a[1:]) * dt**2 / 6.0
    q = quaternions.multiply(poses.quaternions[:-1], from_rotation_vector((w[:-1] + w[1:]) * dt / 2.0))
    rotation = quaternions.multiply(quaternions.conjugate(q), poses.quaternions[1:])
    moved = np.concatenate([[np.nan], np.linalg.norm(poses.positions[1:] - p, axis=1)])
    turned = np.concatenate([[np.nan], np.degrees(quaternions.angle_rad(rotation))])
    return np.where(inertial.received, moved, np.nan), np.where(inertial.received, turned, np.nan)


def drift_m(odometry: States, truth: States) -> tuple[float, float]:
    """Return the error of the last T_O_I [m], O aligned with the first true pose, and the distance driven [m]."""
    ours, theirs = odometry.poses, truth.poses
    q = quaternions.multiply(theirs.quaternions[0], quaternions.conjugate(ours.quaternions[0]))
    end = theirs.positions[0] + quaternions.rotate(q, ours.positions[-1] - ours.positions[0])
    distance = np.linalg.norm(np.diff(theirs.positions, axis=0), axis=1).sum()
    return float(np.linalg.norm(end - theirs.positions[-1])), float(distance)
