"""Estimates as ROS messages: poses, twists and covariances in the conventions of REP-103 and nav_msgs/Odometry."""

from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.chassis.kinematics import BaseGeometry
from holdfast.messages import Array
from holdfast.state import BaseState, Estimate


class RosOdometry(NamedTuple):
    """The fields of nav_msgs/Odometry: pose in the frame of the header, twist in the child frame."""

    position: Array
    quaternion_xyzw: Array
    pose_covariance: Array
    linear: Array
    angular: Array
    twist_covariance: Array


def quaternion_xyzw(rotation: gtsam.Rot3) -> Array:
    """Return the quaternion (4,) x, y, z, w."""
    coefficients: Array = rotation.toQuaternion().coeffs()  # type: ignore[attr-defined]  # absent from the stubs
    return coefficients


def pose_covariance(covariance: Array, R: Array) -> Array:
    """Return the covariance (6, 6) of a pose in ROS order, translation before rotation, both about the fixed axes.

    From GTSAM's tangent in the body (rotation, position, ...) with R (3, 3) the attitude: both blocks are rotated, none
    is carried over a lever to the origin: (26) in docs/math.md.
    """
    M = np.zeros((6, 6))
    M[:3, 3:] = R
    M[3:, :3] = R
    rotated: Array = M @ covariance[:6, :6] @ M.T
    return rotated


def base_odometry(estimate: Estimate, base: BaseState, geometry: BaseGeometry, rate_variance: float) -> RosOdometry:
    """Return the odometry of the chassis: T_O_B, and its twist in B; arguments as for `BaseGeometry.covariances`."""
    pose, twist = geometry.covariances(estimate, base, rate_variance)
    rotation = base.T_O_B.rotation()
    return RosOdometry(
        base.T_O_B.translation(),
        quaternion_xyzw(rotation),
        pose_covariance(pose, rotation.matrix()).ravel(),
        base.velocity,
        base.angular_velocity,
        np.roll(twist, 3, axis=(0, 1)).ravel(),
    )


def odometry(estimate: Estimate, pose: gtsam.Pose3, rate_variance: float) -> RosOdometry:
    """Return the odometry for `pose`, T_W_I or T_O_I; `rate_variance` [rad^2/s^2] is that of the angular velocity."""
    attitude = estimate.nav.attitude()
    linear = attitude.unrotate(estimate.nav.velocity())
    # v_I = R^T v: its error is that of v in the body, plus the error of attitude across v
    J = np.zeros((3, 9))
    x, y, z = linear
    J[0, 1], J[0, 2], J[1, 0], J[1, 2], J[2, 0], J[2, 1] = -z, y, z, -x, -y, x
    J[0, 6] = J[1, 7] = J[2, 8] = 1.0
    twist_covariance = np.zeros((6, 6))
    twist_covariance[:3, :3] = J @ estimate.covariance @ J.T
    twist_covariance[3, 3] = twist_covariance[4, 4] = twist_covariance[5, 5] = rate_variance
    return RosOdometry(
        pose.translation(),
        quaternion_xyzw(pose.rotation()),
        pose_covariance(estimate.covariance, pose.rotation().matrix()).ravel(),
        linear,
        estimate.angular_velocity,
        twist_covariance.ravel(),
    )


def seen_from(other: RosOdometry, estimate: Estimate, pose: gtsam.Pose3) -> RosOdometry:
    """Return the odometry of the same estimate for another pose; the twist is in the body, so it stays."""
    return other._replace(
        position=pose.translation(),
        quaternion_xyzw=quaternion_xyzw(pose.rotation()),
        pose_covariance=pose_covariance(estimate.covariance, pose.rotation().matrix()).ravel(),
    )
