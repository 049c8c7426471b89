"""Every section of the configuration, its defaults and its bounds.

A field's name carries its unit; noise densities carry the Kalibr names, their units stand in `json_schema_extra`.
Unknown keys are refused. Defaults come from physics and datasheets and serve every machine.
"""

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from holdfast.config.frame_tree import Link, poses_from
from holdfast.config.live import LiveConfig
from holdfast.config.realtime import RealtimeConfig
from holdfast.config.section import Section, Topic, Vector3, quantity
from holdfast.messages import Array


class RobustLoss(Section):
    """Loss that takes weight from outliers; `threshold` is in standard deviations."""

    kind: Literal["none", "huber", "tukey", "cauchy"] = "none"
    threshold: float = quantity("sigma", 1.345, gt=0, doc="where the loss departs from the square")


class ImuConfig(Section):
    """An inertial measurement unit; densities as in Kalibr's imu.yaml (continuous time)."""

    topic: Topic
    frame: str = Field("imu", description="name of the IMU's frame in `extrinsics`")
    time_offset_s: float = quantity("s", 0.0, ge=-10, le=10, doc="added to every stamp of this sensor")
    accelerometer_noise_density: float = quantity("m/s^2/sqrt(Hz)", 2e-3, gt=0, le=1, doc="white noise")
    gyroscope_noise_density: float = quantity("rad/s/sqrt(Hz)", 2e-4, gt=0, le=1, doc="white noise")
    accelerometer_random_walk: float = quantity("m/s^3/sqrt(Hz)", 1e-4, gt=0, le=1, doc="drift of the bias")
    gyroscope_random_walk: float = quantity("rad/s^2/sqrt(Hz)", 1e-5, gt=0, le=1, doc="drift of the bias")
    accelerometer_error_ratio: float = quantity(
        "1", 0.005, ge=0, le=0.2, doc="error in proportion to the acceleration: scale, misalignment, missed vibration"
    )
    gyroscope_error_ratio: float = quantity(
        "1", 0.003, ge=0, le=0.2, doc="error in proportion to the turning: scale factor, misalignment"
    )
    accelerometer_bias_sigma: float = quantity("m/s^2", 0.1, gt=0, le=5, doc="bias at power-on, from the datasheet")
    gyroscope_bias_sigma: float = quantity("rad/s", 0.01, gt=0, le=1, doc="bias at power-on, from the datasheet")
    accelerometer_range: float = quantity("m/s^2", 160.0, gt=10, doc="samples beyond are refused")
    gyroscope_range: float = quantity("rad/s", 35.0, gt=0.1, doc="samples beyond are refused")
    max_gap_s: float = quantity("s", 0.05, gt=0, le=1, doc="longer silence (or 2.5 periods, if more) is a drop-out")


class BaseImuConfig(ImuConfig):
    """The inertial measurement unit on the chassis; settings as those of the IMU in the cabin."""

    frame: str = Field("base_imu", description="name of the IMU's frame in `extrinsics`")


class GnssConfig(Section):
    """One GNSS antenna."""

    topic: Topic
    frame: str = Field("gnss", description="name of the antenna's frame in `extrinsics`")
    time_offset_s: float = quantity("s", 0.0, ge=-10, le=10, doc="added to every stamp of this sensor")
    min_status: Literal["fix", "sbas", "gbas"] = Field("fix", description="worst NavSatFix status that is used")
    max_sigma_m: float = quantity("m", 1.0, gt=0, doc="fixes with a larger horizontal sigma are refused")
    default_sigma_m: Vector3 | None = Field(
        None,
        description="east, north, up [m] where the receiver reports no covariance; without it such fixes are refused",
    )
    gate_sigma: float = quantity(
        "sigma",
        4.0,
        gt=2,
        le=100,
        doc="fixes further from the prediction lose weight; twice as far, they are held back",
    )
    min_sigma_m: float = quantity("m", 0.005, gt=0, doc="floor under the receiver's claim, per axis")
    correlation_s: float = quantity(
        "s", 0.25, ge=0, le=60, doc="errors of fixes are alike for so long: fixes closer together weigh less each"
    )
    float_above_m: float = quantity("m", 0.05, gt=0, doc="with a larger sigma the ambiguities are not resolved")
    float_correlation_s: float = quantity("s", 10.0, ge=0, le=600, doc="and errors are alike for so long")
    robust_loss: RobustLoss = RobustLoss()


class LidarConfig(Section):
    """Odometry of a lidar, made by another program; the noise is that of the motion between two scans."""

    topic: Topic
    frame: str = Field("lidar", description="name of the lidar's frame in `extrinsics`")
    time_offset_s: float = quantity("s", 0.0, ge=-10, le=10, doc="added to every stamp of this sensor")
    translation_sigma_m: float = quantity("m", 0.02, gt=0, doc="noise of the motion between two scans, per axis")
    rotation_sigma_rad: float = quantity("rad", 0.002, gt=0, doc="noise of the turn between two scans, per axis")
    drift_m_per_sqrt_m: float = quantity("m/sqrt(m)", 0.04, ge=0, le=10, doc="random walk of the position, per way")
    drift_rad_per_sqrt_m: float = quantity("rad/sqrt(m)", 1e-3, ge=0, le=1, doc="random walk of the attitude, per way")
    drift_rad_per_sqrt_rad: float = quantity("sqrt(rad)", 5e-3, ge=0, le=1, doc="random walk of the attitude, per turn")
    max_interval_s: float = quantity("s", 1.0, gt=0, le=10, doc="scans further apart are not joined")
    jump_sigma: float = quantity(
        "sigma", 8.0, gt=3, doc="a motion further from that of the IMU is a jump of the odometry"
    )
    robust_loss: RobustLoss = RobustLoss(kind="huber", threshold=2.5)


class HeadingConfig(Section):
    """Heading of a dual-antenna receiver or a compass."""

    topic: Topic
    time_offset_s: float = quantity("s", 0.0, ge=-10, le=10, doc="added to every stamp of this sensor")
    mounting_yaw_deg: float | None = quantity(
        "deg", None, ge=-360, le=360, doc="yaw of the measured axis in the IMU frame; else from left to right antenna"
    )
    default_sigma_deg: float = quantity("deg", 1.0, gt=0, le=180, doc="where the sensor reports no covariance")
    min_sigma_deg: float = quantity("deg", 0.05, gt=0, le=180, doc="floor under the sensor's claim")
    correlation_s: float = quantity(
        "s", 1.0, ge=0, le=60, doc="errors are alike for so long: headings closer together weigh less each"
    )
    gate_sigma: float = quantity("sigma", 4.0, gt=2, le=100, doc="headings further from the prediction are refused")


class JointConfig(Section):
    """Encoder of the cabin's turn joint."""

    topic: Topic
    joint_name: str | None = Field(None, description="name in JointState; needed if the message has several joints")
    time_offset_s: float = quantity("s", 0.0, ge=-10, le=10, doc="added to every stamp of this sensor")
    zero_offset_deg: float = quantity("deg", 0.0, ge=-360, le=360, doc="added to every angle")
    zero_offset_sigma_deg: float = quantity("deg", 0.1, gt=0, le=180, doc="trust in zero_offset_deg")
    noise_deg: float = quantity("deg", 0.02, gt=0, le=10, doc="noise of a reading, rounding to its resolution included")
    max_age_s: float = quantity("s", 0.2, gt=0, le=10, doc="older readings are late: not used, and their absence said")


class SensorsConfig(Section):
    """The sensors of the machine."""

    imu: ImuConfig
    gnss: GnssConfig | None = Field(None, description="the only, or the left, antenna")
    gnss_right: GnssConfig | None = Field(None, description="the right antenna")
    lidar: LidarConfig | None = None
    heading: HeadingConfig | None = None
    joint: JointConfig | None = None
    base_imu: BaseImuConfig | None = Field(
        None, description="IMU of the chassis, in frame `base_imu` if not said; of its noise the gyroscope's is used"
    )

    def antennas(self) -> dict[str, GnssConfig]:
        """Return the configured GNSS antennas by sensor name, the left one first."""
        both = {"gnss": self.gnss, "gnss_right": self.gnss_right}
        return {name: gnss for name, gnss in both.items() if gnss is not None}


class Extrinsic(Section):
    """T_parent_child: the pose of the child frame in the parent frame. Give one form of rotation, or none."""

    parent: str = Field(description="name of the frame in which the pose is given")
    child: str = Field(description="name of the frame whose pose is given")
    translation_m: Vector3 = quantity("m", (0.0, 0.0, 0.0), doc="origin of the child in the parent: x, y, z")
    rotation_quaternion_xyzw: tuple[float, float, float, float] | None = Field(None, description="x, y, z, w")
    rotation_matrix: tuple[Vector3, Vector3, Vector3] | None = Field(None, description="rows of R_parent_child")
    rotation_rpy_deg: Vector3 | None = quantity("deg", None, doc="fixed-axis roll, pitch, yaw, as in URDF")

    @model_validator(mode="after")
    def _check_rotation(self) -> Self:
        forms = (self.rotation_quaternion_xyzw, self.rotation_matrix, self.rotation_rpy_deg)
        if sum(form is not None for form in forms) > 1:
            raise ValueError("give only one of rotation_quaternion_xyzw, rotation_matrix, rotation_rpy_deg")
        if self.rotation_quaternion_xyzw is not None:
            norm = float(np.linalg.norm(self.rotation_quaternion_xyzw))
            if abs(norm - 1.0) > 1e-3:
                raise ValueError(f"rotation_quaternion_xyzw has norm {norm:.6g}: must be 1 (order is x, y, z, w)")
        if self.rotation_matrix is not None:
            R = np.array(self.rotation_matrix)
            if not np.allclose(R @ R.T, np.eye(3), atol=1e-4) or np.linalg.det(R) < 0:
                raise ValueError("rotation_matrix is not a rotation: rows must be orthonormal, determinant +1")
        return self

    def matrix(self) -> Array:
        """Return T_parent_child as a (4, 4) homogeneous matrix [m]; the rotation is projected onto SO(3)."""
        R = np.eye(3)
        if self.rotation_matrix is not None:
            R = np.array(self.rotation_matrix)
        elif self.rotation_quaternion_xyzw is not None:
            x, y, z, w = np.array(self.rotation_quaternion_xyzw) / np.linalg.norm(self.rotation_quaternion_xyzw)
            R = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
                ]
            )
        elif self.rotation_rpy_deg is not None:
            rpy = np.radians(self.rotation_rpy_deg)
            (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
            R = np.array(
                [
                    [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                    [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                    [-sp, cp * sr, cp * cr],
                ]
            )
        U, _, Vt = np.linalg.svd(R)
        T = np.eye(4)
        T[:3, :3] = U @ Vt
        T[:3, 3] = self.translation_m
        return T


class TurnJointConfig(Extrinsic):
    """How the cabin sits on the chassis while the turn joint reads zero; it turns about the z axis of `parent`."""

    parent: str = Field("base_link", description="frame on the side of the chassis: its z axis is that of the joint")
    child: str = Field(description="frame on the side of the cabin, its origin on the axis")


class Datum(Section):
    """Origin of the world frame W (east, north, up) on the WGS84 ellipsoid."""

    latitude_deg: float = quantity("deg", ge=-90, le=90, doc="geodetic latitude")
    longitude_deg: float = quantity("deg", ge=-180, le=360, doc="longitude")
    altitude_m: float = quantity("m", ge=-1000, le=20000, doc="height above the ellipsoid, not above sea level")


class InitialisationConfig(Section):
    """How the estimator comes up."""

    heading_deg: float | None = quantity(
        "deg", None, ge=-360, le=360, doc="yaw of the IMU's x axis at the start: 0 is east, counter-clockwise"
    )
    heading_sigma_deg: float = quantity("deg", 2.0, gt=0, le=180, doc="trust in heading_deg")
    standstill_s: float = quantity("s", 1.0, gt=0.1, le=60, doc="standstill that is averaged")
    max_heading_sigma_deg: float = quantity(
        "deg", 5.0, gt=0, le=45, doc="starting in motion: heading must be this sure"
    )
    window_s: float = quantity("s", 30.0, gt=1, le=300, doc="starting in motion: the longest stretch that is used")


class StandstillConfig(Section):
    """Zero-velocity updates."""

    enabled: bool = True
    window_s: float = quantity("s", 1.0, gt=0.1, le=10, doc="quiet for this long is standstill")
    max_angular_rate_rad_s: float = quantity("rad/s", 0.01, gt=0, doc="spread of the gyroscope that counts as quiet")
    max_acceleration: float = quantity("m/s^2", 0.15, gt=0, doc="spread of the accelerometer that counts as quiet")
    max_speed_m_s: float = quantity("m/s", 0.03, gt=0, doc="estimated speed, beyond 3 sigma, that is not standstill")
    velocity_sigma_m_s: float = quantity("m/s", 0.01, gt=0, doc="noise of the zero-velocity update")


class GateConfig(Section):
    """When GNSS is lost and regained; fixes that fail a test never enter the graph."""

    innovation: bool = Field(True, description="test fixes against the prediction")
    baseline: bool = Field(True, description="test the distance between two antennas")
    witness: bool = Field(True, description="test whether fixes drag the lidar odometry's frame through the world")
    max_speed_m_s: float = quantity("m/s", 40.0, gt=0, doc="no antenna moves faster between two fixes")
    lose_after: int = Field(5, ge=1, le=1000, description="so many bad fixes in a row lose an antenna")
    regain_after: int = Field(5, ge=1, le=1000, description="so many good fixes in a row regain it")
    regain_s: float = quantity("s", 2.0, gt=0, le=60, doc="or two good ones so far apart, without a bad one between")
    silence_s: float = quantity("s", 1.0, gt=0, le=60, doc="no fix for so long (or 3 periods, if more) loses it too")
    quarantine_s: float = quantity("s", 1.5, ge=0, le=10, doc="at a loss, used fixes of this age are taken out again")
    believe_after_s: float = quantity(
        "s", 30.0, gt=0, le=3600, doc="lost fixes that agree with each other for so long are right after all"
    )


class MotionModelConfig(Section):
    """Constant twist, used only where the IMU is silent: how far a machine departs from it, as white noise."""

    acceleration_density: float = quantity("m/s^2/sqrt(Hz)", 1.5, gt=0, doc="acceleration of the machine")
    angular_rate_density: float = quantity("rad/s/sqrt(Hz)", 0.2, gt=0, doc="turning of the machine")


class GraphConfig(Section):
    """The fixed-lag smoother."""

    nodes: Literal["measurement", "imu"] = Field(
        "measurement", description="a node where measurements are, or (the paper) at every IMU sample"
    )
    lag_s: float = quantity("s", 3.0, gt=0.5, le=60, doc="length of the sliding window; later measurements are dropped")
    relinearize_threshold_rad: float = quantity(
        "rad", 5e-3, gt=0, le=0.5, doc="iSAM2 relinearises a node whose attitude moved by more"
    )
    max_node_interval_s: float = quantity("s", 0.5, gt=0.01, le=5, doc="without measurements a node is made this often")
    dual: bool = Field(True, description="a fallback graph beside the main one while GNSS is lost (the paper)")
    main_lidar: Literal["anchored", "relative"] = Field(
        "anchored", description="scans are joined to the frame of their odometry, or (the paper) each to the one before"
    )
    fallback_lidar: Literal["anchored", "frozen"] = Field(
        "anchored", description="the odometry's frame drifts, or (the paper, Eq. 10) stays where it was at the loss"
    )
    position_integration_sigma: float = quantity(
        "m/sqrt(s)", 1e-4, gt=0, le=1, doc="what linear interpolation between IMU samples leaves"
    )


class FramesConfig(Section):
    """Names of the published frames (REP-105) and the datum."""

    world: str = Field("map", description="W: east, north, up at the datum")
    odometry: str = Field("odom", description="O: continuous, never jumps")
    base: str = Field(
        "base_link", description="B: the chassis; published if `extrinsics` or `turn_joint` join it to the IMU"
    )
    odometry_policy: Literal["always", "at_recovery"] = Field(
        "always", description="T_W_O takes every correction, or (the paper) only the one at the recovery of GNSS"
    )
    datum: Datum | None = Field(None, description="without it the first accepted fix is the datum")
    gravity: float | None = quantity("m/s^2", None, gt=9.7, lt=9.9, doc="without it WGS84 gravity at the datum")


class Config(Section):
    """The whole configuration."""

    preset: Literal["holdfast", "paper"] = Field("holdfast", description="whose defaults: ours, or the paper's rules")
    sensors: SensorsConfig
    extrinsics: tuple[Extrinsic, ...] = ()
    turn_joint: TurnJointConfig | None = Field(None, description="where the cabin turns on the chassis")
    frames: FramesConfig = FramesConfig()
    initialisation: InitialisationConfig = InitialisationConfig()
    graph: GraphConfig = GraphConfig()
    gate: GateConfig = GateConfig()
    standstill: StandstillConfig = StandstillConfig()
    motion_model: MotionModelConfig = MotionModelConfig()
    realtime: RealtimeConfig = RealtimeConfig()
    live: LiveConfig = LiveConfig()

    @model_validator(mode="after")
    def _check_extrinsics(self) -> Self:
        children = [extrinsic.child for extrinsic in self.extrinsics]
        twice = {child for child in children if children.count(child) > 1}
        if twice:
            raise ValueError(f"extrinsics: frame {sorted(twice)[0]!r} has two parents")
        faults = []
        for name in ("gnss", "gnss_right", "lidar"):
            sensor = getattr(self.sensors, name)
            if sensor is not None and not self.reaches(sensor.frame):
                faults.append(f"sensors.{name}.frame: {self._unreachable(sensor.frame)}")
        left, right = self.sensors.gnss, self.sensors.gnss_right
        if left is not None and right is not None and left.frame == right.frame:
            faults.append("sensors.gnss_right.frame: two antennas cannot share one frame")
        faults += self._faults_of_chassis()
        if faults:
            raise ValueError("\n".join(faults))
        return self

    def _faults_of_chassis(self) -> list[str]:
        imu, base, joint = self.sensors.imu.frame, self.frames.base, self.turn_joint
        faults = []
        if joint is not None:
            if self.sensors.joint is None:
                faults.append("turn_joint: needs sensors.joint, the encoder that reads its angle")
            if self.reaches(base):
                faults.append(f"turn_joint: extrinsics join {imu!r} and {base!r} already, as if nothing turned")
            elif not self.reaches(joint.parent, base):
                faults.append(f"turn_joint.parent: {self._unreachable(joint.parent, base)}")
            if not self.reaches(joint.child):
                faults.append(f"turn_joint.child: {self._unreachable(joint.child)}")
        base_imu = self.sensors.base_imu
        if base_imu is not None and not self.reaches(base_imu.frame, base):
            faults.append(f"sensors.base_imu.frame: {self._unreachable(base_imu.frame, base)}")
        return faults

    def has_base(self) -> bool:
        """Whether the chassis is joined to the IMU, rigidly or by the turn joint, and is not the IMU itself."""
        base = self.frames.base
        return self.turn_joint is not None or (self.reaches(base) and base != self.sensors.imu.frame)

    def reaches(self, frame: str, origin: str | None = None) -> bool:
        """Whether `extrinsics` join a frame to another, by default to the IMU's."""
        return frame in self._frames_from(origin or self.sensors.imu.frame)

    def T(self, origin: str, frame: str) -> Array:
        """Return T_origin_frame, the pose of a frame in another, as a (4, 4) matrix [m].

        Raises:
            ValueError: no chain of `extrinsics` joins the two frames.
        """
        frames = self._frames_from(origin)
        if frame not in frames:
            raise ValueError(self._unreachable(frame, origin))
        return frames[frame]

    def T_I(self, frame: str) -> Array:
        """Return T_I_frame, the pose of a frame in the IMU's frame, as `T` does."""
        return self.T(self.sensors.imu.frame, frame)

    def links(self) -> list[Link]:
        """Return the transforms of `extrinsics`."""
        return [Link(extrinsic.parent, extrinsic.child, extrinsic.matrix()) for extrinsic in self.extrinsics]

    def _frames_from(self, origin: str) -> dict[str, Array]:
        return poses_from(origin, self.links())

    def _unreachable(self, frame: str, origin: str | None = None) -> str:
        known = ", ".join(sorted({e.parent for e in self.extrinsics} | {e.child for e in self.extrinsics})) or "none"
        start = origin or self.sensors.imu.frame
        return f"no transforms lead from {start!r} to {frame!r} (frames in extrinsics: {known})"
