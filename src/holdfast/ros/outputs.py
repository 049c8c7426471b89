"""Estimates as ROS messages: poses, twists and covariances in the conventions of REP-103 and nav_msgs/Odometry."""

from typing import NamedTuple

import numpy as np

from holdfast.chassis.covariances import BaseUncertainty
from holdfast.geometry.rotations import skew
from holdfast.messages import Array
from holdfast.ros.rows import Poses, Rows

TRANSLATION_FIRST = np.array([3, 4, 5, 0, 1, 2])


class RosOdometry(NamedTuple):
    """The fields of N nav_msgs/Odometry: pose in the frame of the header, twist in the child frame.

    Shapes: positions, linear and angular (N, 3), quaternions (N, 4), covariances (N, 36).
    """

    positions: Array
    quaternions_xyzw: Array
    pose_covariances: Array
    linear: Array
    angular: Array
    twist_covariances: Array


def pose_covariances(covariances: Array, R: Array) -> Array:
    """Return covariances (N, 6, 6) of poses in ROS order, translation before rotation, both about the fixed axes.

    From GTSAM's tangent in the body (rotation, position, ...) with R (N, 3, 3) the attitude: both blocks are rotated,
    none is carried over a lever to the origin: (26) in docs/math.md.
    """
    M = np.zeros((len(R), 6, 6))
    M[:, :3, 3:] = R
    M[:, 3:, :3] = R
    rotated: Array = M @ covariances[:, :6, :6] @ M.transpose(0, 2, 1)
    return rotated


def base_odometry(rows: Rows, uncertainty: BaseUncertainty, rate_variances: Array) -> RosOdometry:
    """Return the odometry of the chassis: T_O_B, and its twist in B; arguments as for `BaseUncertainty.covariances`."""
    poses = rows.T_O_B
    pose, twist = uncertainty.covariances(rows.covariances, rows.velocities, rows.chassis, rate_variances)
    return RosOdometry(
        poses.translations,
        poses.quaternions,
        pose_covariances(pose, poses.rotations).reshape(-1, 36),
        rows.chassis["velocity"],
        rows.chassis["angular_velocity"],
        twist[:, TRANSLATION_FIRST[:, None], TRANSLATION_FIRST].reshape(-1, 36),
    )


def odometry(rows: Rows, poses: Poses, rate_variances: Array) -> RosOdometry:
    """Return the odometry for `poses`, T_W_I or T_O_I; `rate_variances` (N,) [rad^2/s^2] as for the chassis."""
    # v_I = R^T v: its error is that of v in the body, plus the error of attitude across v
    J = np.zeros((len(rows.stamps_ns), 3, 9))
    J[:, :, :3], J[:, :, 6:] = skew(rows.velocities), np.eye(3)
    twist = np.zeros((len(rows.stamps_ns), 6, 6))
    twist[:, :3, :3] = J @ rows.covariances @ J.transpose(0, 2, 1)
    twist[:, range(3, 6), range(3, 6)] = rate_variances[:, None]
    return RosOdometry(
        poses.translations,
        poses.quaternions,
        pose_covariances(rows.covariances, poses.rotations).reshape(-1, 36),
        rows.velocities,
        rows.angular_velocities,
        twist.reshape(-1, 36),
    )


def seen_from(other: RosOdometry, rows: Rows, poses: Poses) -> RosOdometry:
    """Return the odometry of the same estimates for other poses; the twist is in the body, so it stays."""
    return other._replace(
        positions=poses.translations,
        quaternions_xyzw=poses.quaternions,
        pose_covariances=pose_covariances(rows.covariances, poses.rotations).reshape(-1, 36),
    )
