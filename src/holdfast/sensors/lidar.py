"""Lidar odometry: which poses can be believed, and the factors that they become."""

import gtsam
import numpy as np

from holdfast.config.model import LidarConfig
from holdfast.messages import Array, LidarPose
from holdfast.sensors.noise import noise_model
from holdfast.state import Outcome

MAX_DISTANCE_M = 1e6
MAX_SPEED_M_S = 100.0
FREE_VELOCITY = 1e6  # [m/s]: a pose says nothing about the velocity part of a NavState
DISTRUST, MAX_SCALE = 3.0, 30.0
JUMPS, JUMPS_NS = 4, 20_000_000_000  # so many jumps in this time are no jumps but noise
FREE_TILT = 0.2  # [rad]
STILL = 1e-3  # [m/s] of a frame, which has a velocity only because it shares the type of the nodes
STANDING_DRIFT = 1e-4  # [m/sqrt(s)], and a tenth of it in rad: what even a standing odometry is allowed


class LidarModel:
    """One lidar odometry; `T_I_L` is the pose of the lidar in the IMU's frame."""

    def __init__(self, config: LidarConfig, T_I_L: gtsam.Pose3) -> None:
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.max_interval_ns = round(config.max_interval_s * 1e9)
        self._config = config
        self._scale = 1.0  # of all noise
        self._jumps_ns: list[int] = []
        self._adjoint: Array = T_I_L.AdjointMap()
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

    def trust_less(self) -> None:
        """The odometry has held an estimate against fixes that were right: it is worse than is configured."""
        self._scale = min(DISTRUST * self._scale, MAX_SCALE)

    def note_jump(self, stamp_ns: int) -> bool:
        """Note that the odometry has jumped; say whether it does so too often to be as good as is configured."""
        self._jumps_ns = [jump for jump in self._jumps_ns if stamp_ns - jump < JUMPS_NS] + [stamp_ns]
        if len(self._jumps_ns) < JUMPS:
            return False
        self._jumps_ns.clear()
        self.trust_less()
        return True

    def jumped(self, motion: gtsam.Pose3, predicted: gtsam.Pose3) -> bool:
        """Whether the motion between two scans is beyond `jump_sigma` from the one that the IMU predicts."""
        miss = gtsam.Pose3.Logmap(predicted.between(motion))
        return bool(miss @ np.linalg.solve(self.covariance(motion), miss) > self._config.jump_sigma**2)

    def T_I0_I(self, pose: LidarPose) -> gtsam.Pose3:
        """Return the pose of the IMU in the frame where the IMU was when the odometry started: T_I_L T_L0_L T_L_I."""
        x, y, z, w = pose.quaternion
        return self._T_I_L * gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), pose.position) * self._T_L_I

    def covariance(self, motion: gtsam.Pose3) -> Array:
        """Return the covariance (6, 6) of the IMU's motion between two scans, rotation [rad] then translation [m].

        The lidar's own noise, that of both scans and the drift on the way, is carried over the lever arm to the IMU by
        the adjoint: (16) in docs/math.md.
        """
        drift = self._drift_sigmas(motion)
        return self._at_imu(self._sigmas() ** 2 + drift**2)

    def factor(self, key_i: int, key_j: int, motion: gtsam.Pose3) -> gtsam.NonlinearFactor:
        """Return the relative factor between two nodes for the IMU's motion T_Ii_Ij (paper, IV-A.4a).

        It is a factor between two `NavState`s whose velocity part is free.
        """
        return self._between(key_i, key_j, motion, self.covariance(motion))

    def anchored_factor(self, frame_key: int, key: int, motion: gtsam.Pose3) -> gtsam.NonlinearFactor:
        """Return the factor that joins a node to a place on the odometry's track, `motion` away: (29) in docs/math.md.

        Its noise is that of one scan, half the variance of a motion between two.
        """
        return self._between(frame_key, key, motion, self._at_imu(0.5 * self._sigmas() ** 2))

    def pseudo_global_factor(self, key: int, T_W_I: gtsam.Pose3) -> gtsam.NonlinearFactor:
        """Return the pose factor in W of the paper's fallback graph (IV-A.4b): roll and pitch are left to the IMU."""
        covariance = np.eye(9) * FREE_VELOCITY**2
        covariance[:6, :6] = self._at_imu(0.5 * self._sigmas() ** 2)
        R = T_W_I.rotation().matrix()
        covariance[:3, :3] += R.T @ np.diag([FREE_TILT**2, FREE_TILT**2, 0.0]) @ R
        model = noise_model(covariance, self._config.robust_loss)
        return gtsam.PriorFactorNavState(key, gtsam.NavState(T_W_I, np.zeros(3)), model)

    def drift_factor(self, before_key: int, key: int, motion: gtsam.Pose3, duration_s: float) -> gtsam.NonlinearFactor:
        """Return the factor between two places on the track, which may drift between them: (29) in docs/math.md."""
        covariance = np.eye(9) * STILL**2
        covariance[:6, :6] = np.diag(self.drift(motion, duration_s) ** 2)
        model = gtsam.noiseModel.Gaussian.Covariance(covariance)
        return gtsam.BetweenFactorNavState(before_key, key, gtsam.NavState(motion, np.zeros(3)), model)

    def pose_variances(self) -> tuple[float, float]:
        """Return the variances of one pose per axis, half of that of a motion: rotation [rad^2], translation [m^2]."""
        sigmas = self._sigmas()
        return 0.5 * float(sigmas[0]) ** 2, 0.5 * float(sigmas[3]) ** 2

    def drift(self, motion: gtsam.Pose3, duration_s: float) -> Array:
        """Return the sigmas (6,) of the drift of the odometry over a motion, rotation [rad] then translation [m].

        What cannot be told from the noise of two scans is no motion: a standing odometry hardly drifts.
        """
        rotation, translation = self._sigmas()[0], self._sigmas()[3]
        way = max(0.0, float(np.linalg.norm(motion.translation())) - 2.0 * translation)
        turn = max(0.0, float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation()))) - 2.0 * rotation)
        standing = STANDING_DRIFT * np.sqrt(duration_s)
        sigmas: Array = self._drift(way, turn) + np.repeat([0.1 * standing, standing], 3)
        return sigmas

    def _drift_sigmas(self, motion: gtsam.Pose3) -> Array:
        turn = float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation())))
        return self._drift(float(np.linalg.norm(motion.translation())), turn)

    def _drift(self, way_m: float, turn_rad: float) -> Array:
        config = self._config
        rotation = np.hypot(
            config.drift_rad_per_sqrt_m * np.sqrt(way_m), config.drift_rad_per_sqrt_rad * np.sqrt(turn_rad)
        )
        sigmas: Array = self._scale * np.repeat([rotation, config.drift_m_per_sqrt_m * np.sqrt(way_m)], 3)
        return sigmas

    def _sigmas(self) -> Array:
        sigmas: Array = self._scale * np.repeat([self._config.rotation_sigma_rad, self._config.translation_sigma_m], 3)
        return sigmas

    def _at_imu(self, variances: Array) -> Array:
        covariance: Array = self._adjoint @ np.diag(variances) @ self._adjoint.T
        return covariance

    def _between(self, key_i: int, key_j: int, motion: gtsam.Pose3, covariance: Array) -> gtsam.NonlinearFactor:
        free = np.eye(9) * FREE_VELOCITY**2
        free[:6, :6] = covariance
        model = noise_model(free, self._config.robust_loss)
        return gtsam.BetweenFactorNavState(key_i, key_j, gtsam.NavState(motion, np.zeros(3)), model)
