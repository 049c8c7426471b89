"""Odometry: which poses can be used, what their motion weighs, and the factors that they become.

Its poses are relative, so one state says nothing of them: `holdfast.graph.odometry_track` joins them.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import gtsam
import numpy as np

from holdfast.config.sensors import DriftingConfig, OdometryConfig, ScansConfig
from holdfast.errors import EstimatorError
from holdfast.events import Outcome
from holdfast.geometry.motions import size_of
from holdfast.geometry.world import World
from holdfast.messages import Array, Message, SensorPose
from holdfast.sensors.noise import FREE_VARIANCE, noise_model
from holdfast.sensors.odometry_calibration import OdometryCalibration
from holdfast.sensors.odometry_claim import claimed_excess
from holdfast.sensors.sensor import STEADY, Role, mounting, pose_of, register

MAX_SPEED_M_S = 100.0
MAX_RATE_RAD_S = 10.0
MAX_SCALE = 30.0
LOOSE_TILT_RAD = 0.2  # of a pseudo-global pose, whose roll and pitch are left to the IMU
STILL_M_S = 1e-3  # velocity of a frame, which has one only because it shares the type of the nodes
STANDING = np.zeros(3)
LEAST_YAW_DRIFT = 2e-3  # [rad/sqrt(rad)] whatever is learnt, unless less is configured
UNMEASURED_RAD, UNMEASURED_M = 10.0, 1e3  # sigmas of a motion since the pose before that nobody measured
STANDING_DRIFT_M_PER_SQRT_S = 1e-4  # what even a standing odometry is allowed; a tenth of it in rad


@dataclass(frozen=True, slots=True, eq=False)
class TrackPose:
    """A checked pose: T_I0_I of the IMU in the frame where it was when the odometry started, time offset applied.

    Attributes:
        excess: (6, 6) covariance in the tangent of I that the odometry itself adds to the motion since the pose before,
            rotation [rad] then translation [m]; None where it adds nothing.
        begins_anew: the odometry says that it did not measure the motion since the pose before.
        early_ns: by how much its stamp was known to be early; that is in it already.
    """

    stamp_ns: int
    sensor: str
    T_I0_I: gtsam.Pose3
    excess: Array | None = None
    begins_anew: bool = False
    early_ns: int = 0

    @property
    def claimed_ns(self) -> int:
        """When it was measured, by its own clock."""
        return self.stamp_ns - self.early_ns

    def repeats(self, other: "TrackPose") -> bool:
        """Whether it is another one in every digit."""
        return np.array_equal(self.T_I0_I.matrix(), other.T_I0_I.matrix())

    def dated(self, early_ns: int) -> "TrackPose":
        """Return the same pose, its stamp known to be early by so much."""
        return replace(self, stamp_ns=self.claimed_ns + early_ns, early_ns=early_ns)


class OdometryModel:
    """One odometry; `T_I_L` is the pose of its sensor in the IMU's frame."""

    role: ClassVar[Role] = Role.ODOMETRY
    message: ClassVar[type[Message] | None] = SensorPose

    def __init__(self, name: str, config: DriftingConfig, T_I_L: gtsam.Pose3) -> None:
        self.name = name
        self.config = config
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.max_interval_ns = round(config.max_interval_s * 1e9)
        self.adjoint: Array = T_I_L.AdjointMap()
        self.calibration = OdometryCalibration(config, T_I_L)
        self.parameters = self.calibration.parameters
        self._T_I_L = T_I_L
        self._T_L_I = T_I_L.inverse()

    def convert(self, message: SensorPose, world: World) -> TrackPose | Outcome:  # noqa: ARG002 (it starts anywhere)
        """Return the pose of the IMU on the track, T_I_L T_L0_L T_L_I, or what is wrong with it.

        Raises:
            EstimatorError: it is no pose: scans become poses before the estimator, in `holdfast.lidar_odometry`.
        """
        if not isinstance(message, SensorPose):
            raise EstimatorError(f"{self.name}: a {type(message).__name__} came (allowed: SensorPose)")
        T_L0_L = pose_of(message)
        if isinstance(T_L0_L, Outcome):
            return T_L0_L
        T_L0_L = gtsam.Pose3(T_L0_L.rotation(), self.config.scale * T_L0_L.translation())
        T_I0_I, stamp_ns = self._T_I_L * T_L0_L * self._T_L_I, message.stamp_ns + self.offset_ns
        excess, begins_anew = self._excess(message, T_L0_L), _is_unmeasured(message.covariance)
        return TrackPose(stamp_ns, self.name, T_I0_I, excess, begins_anew)

    def _excess(self, message: SensorPose, T_L0_L: gtsam.Pose3) -> Array | None:
        """Return what the message claims beyond the configured noise, brought from the axes of L0 at L to I."""
        if message.covariance is None:
            return None
        turned = np.kron(np.eye(2), T_L0_L.rotation().matrix().T)
        excess = claimed_excess(turned @ message.covariance @ turned.T, self.config)
        return None if excess is None else self.adjoint @ excess @ self.adjoint.T


def _is_unmeasured(covariance: Array | None) -> bool:
    """Whether a covariance of a motion (6, 6) says that nobody measured it."""
    return covariance is not None and bool((covariance.diagonal()[3:] >= UNMEASURED_M**2).all())


def is_possible(motion: gtsam.Pose3, duration_s: float) -> bool:
    """Whether a machine can have moved like this between two poses."""
    moved_m, turned_rad = size_of(motion)
    return moved_m <= MAX_SPEED_M_S * duration_s and turned_rad <= MAX_RATE_RAD_S * duration_s


class LearntNoise(NamedTuple):
    """How many times larger the sigmas of an odometry are than configured: noise of its poses, and drift.

    Its rotation drifts about the vertical by another factor than about the horizontal.
    """

    rotation_noise: float = 1.0
    translation_noise: float = 1.0
    tilt_drift: float = 1.0
    translation_drift: float = 1.0
    yaw_drift: float = 1.0


CONFIGURED = LearntNoise()


class OdometryNoise:
    """What the motion of an odometry weighs: as configured, times a scale that grows where it proves to be worse.

    What is learnt of it counts for the factors alone: a test for jumps or slips that learnt would go blind.
    It lives as long as one start of the estimator.
    """

    def __init__(self, model: OdometryModel) -> None:
        self.scale = 1.0
        self.learnt = CONFIGURED
        self.calibration = model.calibration
        self._config = model.config
        self._adjoint = model.adjoint
        self._p_I_L = model.calibration.lever_arm

    def trust_less(self, factor: float) -> None:
        """The odometry has proved to be worse than configured."""
        self.scale = min(factor * self.scale, MAX_SCALE)

    def jump(self, motion: gtsam.Pose3, predicted: gtsam.Pose3, excess: Array | None = None) -> Array | None:
        """Return by how many sigmas (6,) a motion departs from the IMU's; None if by less than `jump_sigma`.

        `excess` (6, 6) is what is added to the noise of the odometry.
        """
        residual = gtsam.Pose3.Logmap(predicted.between(motion))
        sigmas: Array = np.linalg.solve(np.linalg.cholesky(self.covariance(motion, excess)), residual)
        return sigmas if float(sigmas @ sigmas) > self._config.jump_sigma**2 else None

    def covariance(self, motion: gtsam.Pose3, excess: Array | None = None, learnt: LearntNoise = CONFIGURED) -> Array:
        """Return the covariance (6, 6) of the IMU's motion between two poses, rotation [rad] then translation [m].

        The odometry's own noise, that of both poses and the drift between them, is carried over the lever arm to the
        IMU by the adjoint: (16) in docs/math.md. `excess` (6, 6) is what the odometry itself adds to it.
        """
        rotation_rad = float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation())))
        drift = self._drift(self._distance_m(motion), rotation_rad)
        drift *= np.repeat([max(learnt.tilt_drift, learnt.yaw_drift), learnt.translation_drift], 3)
        return with_excess(excess, self._at_imu(self._sigmas(learnt) ** 2 + drift**2))

    def pose_variances(self) -> tuple[float, float]:
        """Return the variances of one pose per axis, half of that of a motion: rotation [rad^2], translation [m^2]."""
        sigmas = self._sigmas()
        return 0.5 * float(sigmas[0]) ** 2, 0.5 * float(sigmas[3]) ** 2

    def drift(self, motion: gtsam.Pose3, duration_s: float) -> Array:
        """Return the sigmas (6,) of the configured drift over a motion, rotation [rad] then translation [m].

        What cannot be told from the noise of two poses is no motion: a standing odometry hardly drifts.
        """
        rotation_sigma, translation_sigma = self._sigmas()[0], self._sigmas()[3]
        distance_m = max(0.0, self._distance_m(motion) - 2.0 * translation_sigma)
        rotated = float(np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation())))
        standing = STANDING_DRIFT_M_PER_SQRT_S * np.sqrt(duration_s)
        sigmas: Array = self._drift(distance_m, max(0.0, rotated - 2.0 * rotation_sigma))
        sigmas += np.repeat([0.1 * standing, standing], 3)
        return sigmas

    # --- factors -----------------------------------------------------------------------------------------------------

    def relative_factor(
        self, key_i: int, key_j: int, motion: gtsam.Pose3, excess: Array | None = None
    ) -> gtsam.NonlinearFactor:
        """Return the factor between two nodes for the IMU's motion T_Ii_Ij, as configured (paper, IV-A.4a).

        It is a factor between two `NavState`s whose velocity part is free.
        """
        return self._between(key_i, key_j, motion, self.covariance(motion, excess))

    def learnt_factor(self, key_i: int, key_j: int, motion: gtsam.Pose3) -> gtsam.NonlinearFactor:
        """Return the factor between two nodes for the IMU's motion T_Ii_Ij, by what was learnt of the noise."""
        return self._between(key_i, key_j, motion, self.covariance(motion, learnt=self.learnt))

    def anchored_factor(
        self,
        frame_key: int,
        key: int,
        motion: gtsam.Pose3,
        calibration_keys: tuple[int, ...] = (),
        *,
        angular_velocity: Array = STANDING,
        beyond: Array = STEADY,
        known_s: float = 0.0,
    ) -> gtsam.NonlinearFactor:
        """Return the factor that joins a node to a pose on the track, `motion` away: (29) in docs/math.md.

        Its noise is that of one pose, half the variance of a motion between two. Where the calibration is estimated,
        it is on that, too; then it needs the `angular_velocity` (3,) of I [rad/s], by how much the mean twist over
        the offset of the clock is `beyond` (6,) that of the node, and what of that offset is in the stamp already.
        """
        covariance = self._at_imu(0.5 * self._sigmas(self.learnt) ** 2)
        if not calibration_keys:
            return self._between(frame_key, key, motion, covariance)
        noise = noise_model(covariance, self._config.robust_loss)
        keys = frame_key, key, *calibration_keys
        return self.calibration.anchored_factor(keys, motion, angular_velocity, beyond, noise, known_s=known_s)

    def pseudo_global_factor(self, key: int, T_W_I: gtsam.Pose3, excess: Array | None = None) -> gtsam.NonlinearFactor:
        """Return the pose factor in W of the paper's fallback graph (IV-A.4b): roll and pitch are left to the IMU."""
        covariance = np.eye(9) * FREE_VARIANCE
        covariance[:6, :6] = with_excess(excess, self._at_imu(0.5 * self._sigmas(self.learnt) ** 2))
        R = T_W_I.rotation().matrix()
        covariance[:3, :3] += R.T @ np.diag([LOOSE_TILT_RAD**2, LOOSE_TILT_RAD**2, 0.0]) @ R
        model = noise_model(covariance, self._config.robust_loss)
        return gtsam.PriorFactorNavState(key, gtsam.NavState(T_W_I, np.zeros(3)), model)

    def drift_factor(  # noqa: PLR0917 (two nodes, the motion between them, and what else it rests on)
        self,
        before_key: int,
        key: int,
        motion: gtsam.Pose3,
        duration_s: float,
        up: Array,
        calibration_keys: tuple[int, ...] = (),
        excess: Array | None = None,
    ) -> gtsam.NonlinearFactor:
        """Return the factor between two poses on the track, which may drift between them: (29) in docs/math.md.

        Where the calibration is estimated, it is on that, too. `up` (3,) is the vertical at the second, in I.
        """
        covariance = np.eye(9) * STILL_M_S**2
        learnt, drift = self.learnt, self.drift(motion, duration_s)
        sigmas = np.repeat([learnt.tilt_drift, learnt.translation_drift], 3) * drift
        covariance[:6, :6] = with_excess(excess, self._at_imu(sigmas**2))
        about_up = np.concatenate([up, np.cross(self._p_I_L, up)])
        yaw_drift = max(learnt.yaw_drift, min(1.0, LEAST_YAW_DRIFT / max(self._config.drift_rad_per_sqrt_rad, 1e-12)))
        covariance[:6, :6] += ((yaw_drift * drift[0]) ** 2 - sigmas[0] ** 2) * np.outer(about_up, about_up)
        model = gtsam.noiseModel.Gaussian.Covariance(covariance)
        if calibration_keys:
            return self.calibration.drift_factor((before_key, key, *calibration_keys), motion, model)
        return gtsam.BetweenFactorNavState(before_key, key, gtsam.NavState(motion, np.zeros(3)), model)

    def _distance_m(self, motion: gtsam.Pose3) -> float:
        """Return how far the sensor has moved, which on a slewing cabin may be further than the IMU has."""
        lever_arm = self.calibration.lever_arm
        return float(np.linalg.norm(motion.transformFrom(lever_arm) - lever_arm))

    def _drift(self, distance_m: float, rotation_rad: float) -> Array:
        config = self._config
        rotation = np.hypot(
            config.drift_rad_per_sqrt_m * np.sqrt(distance_m), config.drift_rad_per_sqrt_rad * np.sqrt(rotation_rad)
        )
        sigmas: Array = self.scale * np.repeat([rotation, config.drift_m_per_sqrt_m * np.sqrt(distance_m)], 3)
        return sigmas

    def _sigmas(self, learnt: LearntNoise = CONFIGURED) -> Array:
        rotation_rad = learnt.rotation_noise * self._config.rotation_sigma_rad
        translation_m = learnt.translation_noise * self._config.translation_sigma_m
        sigmas: Array = self.scale * np.repeat([rotation_rad, translation_m], 3)
        return sigmas

    def _at_imu(self, variances: Array) -> Array:
        covariance: Array = self._adjoint @ np.diag(variances) @ self._adjoint.T
        return covariance

    def _between(self, key_i: int, key_j: int, motion: gtsam.Pose3, covariance: Array) -> gtsam.NonlinearFactor:
        free = np.eye(9) * FREE_VARIANCE
        free[:6, :6] = covariance
        model = noise_model(free, self._config.robust_loss)
        return gtsam.BetweenFactorNavState(key_i, key_j, gtsam.NavState(motion, np.zeros(3)), model)


def with_excess(excess: Array | None, covariance: Array) -> Array:
    """Return a covariance with what an odometry claims beyond it, if it claims anything."""
    return covariance if excess is None else covariance + excess


for _section in (OdometryConfig, ScansConfig):
    register(_section, lambda name, section, config: OdometryModel(name, section, mounting(name, config)))
