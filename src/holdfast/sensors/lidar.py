"""Lidar odometry: the motion of the IMU between two scans, and the factor that it becomes."""

import gtsam
import numpy as np

from holdfast.config.model import LidarConfig
from holdfast.messages import Array, LidarPose
from holdfast.sensors.noise import noise_model
from holdfast.state import Outcome

MAX_DISTANCE_M = 1e6
MAX_SPEED_M_S = 100.0
FREE_VELOCITY = 1e6  # [m/s]: a relative pose says nothing about the velocity part of a NavState


class LidarModel:
    """One lidar odometry; `T_I_L` is the pose of the lidar in the IMU's frame."""

    def __init__(self, config: LidarConfig, T_I_L: gtsam.Pose3) -> None:
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.max_interval_ns = round(config.max_interval_s * 1e9)
        self._config = config
        self._T_I_L = T_I_L
        self._T_L_I = T_I_L.inverse()

    def check(self, pose: LidarPose) -> Outcome:
        """Say whether a pose can be used."""
        finite = np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all()
        if not finite:
            return Outcome.NOT_FINITE
        return Outcome.USED if abs(pose.position).max() <= MAX_DISTANCE_M else Outcome.OUT_OF_RANGE

    def check_motion(self, motion: gtsam.Pose3, duration_s: float) -> Outcome:
        """Say whether a machine can have moved like this between two scans."""
        possible = np.linalg.norm(motion.translation()) <= MAX_SPEED_M_S * duration_s
        return Outcome.USED if possible else Outcome.OUT_OF_RANGE

    def T_I0_I(self, pose: LidarPose) -> gtsam.Pose3:
        """Return the pose of the IMU in the frame where the IMU was when the odometry started: T_I_L T_L0_L T_L_I."""
        x, y, z, w = pose.quaternion
        return self._T_I_L * gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), pose.position) * self._T_L_I

    def covariance(self, motion: gtsam.Pose3) -> Array:
        """Return the covariance (6, 6) of the IMU's motion between two scans, rotation [rad] then translation [m].

        The lidar's own noise is carried over the lever arm to the IMU by the adjoint: (16) in docs/math.md.
        """
        drift = self._config.drift_ratio * float(np.linalg.norm(motion.translation()))
        sigmas = np.repeat([self._config.rotation_sigma_rad, np.hypot(self._config.translation_sigma_m, drift)], 3)
        adjoint = self._T_I_L.AdjointMap()
        covariance: Array = adjoint @ np.diag(sigmas**2) @ adjoint.T
        return covariance

    def factor(self, key_i: int, key_j: int, motion: gtsam.Pose3) -> gtsam.NonlinearFactor:
        """Return the relative factor between two nodes for the IMU's motion T_Ii_Ij (paper, IV-A.4a).

        It is a factor between two `NavState`s whose velocity part is free.
        """
        covariance = np.eye(9) * FREE_VELOCITY**2
        covariance[:6, :6] = self.covariance(motion)
        model = noise_model(covariance, self._config.robust_loss)
        return gtsam.BetweenFactorNavState(key_i, key_j, gtsam.NavState(motion, np.zeros(3)), model)
