"""The section of every kind of sensor; a sensor has the name that the user gives it in `sensors`.

Noise densities carry the Kalibr names, their units stand in `json_schema_extra`.
"""

from typing import ClassVar, Literal

from pydantic import Field

from holdfast.config.section import Factors, Section, Topic, Vector3, quantity

Axis = Literal["x", "y", "z"]
MOST_OFFSET_S = 100  # leap seconds are 18, and 37 to atomic time
MAP_VOXEL_M, SCAN_VOXEL_M = 0.5, 0.35  # `lidar_odometry.small_gicp` says why


class RobustLoss(Section):
    """Loss that takes weight from outliers; `threshold` is in standard deviations."""

    kind: Literal["none", "huber", "tukey", "cauchy"] = "none"
    threshold: float = quantity("sigma", 1.345, gt=0, doc="where the loss departs from the square")


class SensorConfig(Section):
    """What all sensors have; `topic` is None for what has no messages."""

    kind: str
    topic: Topic | None = None
    time_offset_s: float = quantity(
        "s", 0.0, ge=-MOST_OFFSET_S, le=MOST_OFFSET_S, doc="added to every stamp of this sensor"
    )

    def is_in_world(self) -> bool:
        """Whether it measures in W without being on the earth, so that GNSS beside it needs a known datum."""
        return False


class ClockedConfig(SensorConfig):
    """What all sensors have whose clock is estimated."""

    time_offset_sigma_s: float = quantity("s", 0.03, ge=0, le=1, doc="of `time_offset_s`, which is estimated; 0: known")


class MountedConfig(SensorConfig):
    """What all sensors have whose mounting matters; some may sit on the chassis, beyond the turn joint."""

    may_be_on_chassis: ClassVar[bool] = False

    frame: str | None = Field(None, description="its frame in `extrinsics`; by default named as the sensor")


class InertialConfig(MountedConfig):
    """An inertial measurement unit; densities as in Kalibr's imu.yaml (continuous time)."""

    topic: Topic
    gyroscope_factors: Factors = quantity(
        "1",
        (1.0, 1.0, 1.0),
        doc="what the topic says of each axis, times this, is rad/s: 0.0174533 of a driver that gives deg/s, -1 of an "
        "axis with the wrong sign",
    )
    accelerometer_factors: Factors = quantity(
        "1", (1.0, 1.0, 1.0), doc="likewise, for m/s^2: 9.80665 of a driver that gives multiples of g"
    )
    accelerometer_noise_density: float = quantity("m/s^2/sqrt(Hz)", 2e-3, gt=0, le=1, doc="white noise")
    gyroscope_noise_density: float = quantity("rad/s/sqrt(Hz)", 2e-4, gt=0, le=1, doc="white noise")
    accelerometer_random_walk: float = quantity("m/s^3/sqrt(Hz)", 1e-4, gt=0, le=1, doc="drift of the bias")
    gyroscope_random_walk: float = quantity("rad/s^2/sqrt(Hz)", 3e-5, gt=0, le=1, doc="drift of the bias")
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
    max_gap_s: float = quantity("s", 0.05, gt=0, le=1, doc="longer silence (or 2.5 usual periods) is a drop-out")

    @property
    def factors(self) -> tuple[float, ...] | None:
        """Both factors (6,), of the gyroscope first; None where the messages are as they should be."""
        factors = (*self.gyroscope_factors, *self.accelerometer_factors)
        return None if all(factor == 1.0 for factor in factors) else factors


class PositionConfig(MountedConfig, ClockedConfig):
    """What all sensors have that measure the position of a point of the machine."""

    topic: Topic
    gate_sigma: float = quantity(
        "sigma",
        4.0,
        gt=2,
        le=100,
        doc="fixes further from the prediction lose weight; twice as far, they are held back",
    )
    robust_loss: RobustLoss = RobustLoss()


class JudgedConfig(SensorConfig):
    """What all sensors have that are judged one by one, by an innovation test with hysteresis."""

    correlation_s: float = quantity(
        "s", 1.0, ge=0, le=600, doc="correlation time of the errors: measurements closer together weigh less each"
    )
    gate_sigma: float = quantity("sigma", 4.0, gt=2, le=100, doc="further from the prediction it is refused")
    lose_after: int = Field(5, ge=1, le=1000, description="so many refused in a row lose the sensor")
    regain_after: int = Field(5, ge=1, le=1000, description="so many good ones in a row regain it")


class ImuConfig(InertialConfig):
    """The inertial measurement unit whose pose is estimated; densities as in Kalibr's imu.yaml (continuous time)."""

    kind: Literal["imu"]
    primary: bool = Field(False, description="which one is I, where there are several; the others are not used")


class GnssConfig(PositionConfig):
    """One GNSS antenna."""

    kind: Literal["gnss"]
    min_status: Literal["fix", "sbas", "gbas"] = Field("fix", description="worst NavSatFix status that is used")
    max_sigma_m: float = quantity("m", 1.0, gt=0, doc="fixes with a larger horizontal sigma are refused")
    default_sigma_m: Vector3 | None = Field(
        None,
        description="east, north, up [m] where the receiver reports no covariance; by default by status: "
        "fix 2.5, 2.5, 4, sbas 0.8, 0.8, 1.5, gbas 0.02, 0.02, 0.04",
    )
    min_sigma_m: float = quantity("m", 0.005, gt=0, doc="floor under the receiver's claim, per axis")
    lever_arm_sigma_m: float | None = quantity(
        "m",
        None,
        ge=0,
        le=1,
        doc="of the antenna's place in `extrinsics`, which is estimated; 0: known; by default as if known until it "
        "proves to be wrong",
    )
    correlation_s: float = quantity(
        "s", 0.25, ge=0, le=60, doc="correlation time of the errors: fixes closer together weigh less each"
    )
    float_above_m: float = quantity("m", 0.05, gt=0, doc="with a larger sigma the ambiguities are not resolved")
    float_correlation_s: float = quantity("s", 10.0, ge=0, le=600, doc="correlation time of such fixes")
    slow_time_constant_s: float = quantity(
        "s",
        60.0,
        ge=0,
        le=3600,
        doc="of the slow part of the errors, which is estimated; 0: `correlation_s` weighs them",
    )

    @property
    def slow_size(self) -> int:
        """How many numbers its slow error has."""
        return 3 if self.slow_time_constant_s > 0.0 and self.correlation_s > 0.0 else 0


class HeadingConfig(JudgedConfig, ClockedConfig):
    """Heading of a dual-antenna receiver or a compass."""

    kind: Literal["heading"]
    topic: Topic
    clockwise: bool = Field(False, description="its angle is clockwise from north, not counter-clockwise from east")
    mounting_yaw_deg: float | None = quantity(
        "deg", None, ge=-360, le=360, doc="yaw of the measured axis in the IMU frame; else that of the baseline"
    )
    mounting_sigma_deg: float = quantity(
        "deg", 15.0, ge=0, le=180, doc="of that yaw if it is wrong, which is estimated; 0: known"
    )
    baseline: tuple[str, str] | None = Field(
        None, description="from which antenna to which, as named in `sensors`; by default the first two"
    )
    slow_time_constant_s: float = quantity(
        "s",
        60.0,
        ge=0,
        le=3600,
        doc="of the slow part of the errors, which is estimated; 0: `correlation_s` weighs them",
    )
    default_sigma_deg: float = quantity("deg", 1.0, gt=0, le=180, doc="where the sensor reports no covariance")
    min_sigma_deg: float = quantity("deg", 0.05, gt=0, le=180, doc="floor under the sensor's claim")

    @property
    def slow_size(self) -> int:
        """How many numbers its slow error has."""
        return 1 if self.slow_time_constant_s > 0.0 and self.correlation_s > 0.0 else 0


class DriftingConfig(MountedConfig, ClockedConfig):
    """What all odometries have: poses that drift. Noise is that between two poses."""

    topic: Topic
    translation_sigma_m: float = quantity("m", 0.02, gt=0, doc="noise of the motion between two poses, per axis")
    rotation_sigma_rad: float = quantity("rad", 0.002, gt=0, doc="noise of the rotation between two poses, per axis")
    drift_m_per_sqrt_m: float = quantity("m/sqrt(m)", 0.04, ge=0, le=10, doc="random walk of position over distance")
    drift_rad_per_sqrt_m: float = quantity("rad/sqrt(m)", 1e-3, ge=0, le=1, doc="random walk of attitude over distance")
    drift_rad_per_sqrt_rad: float = quantity("sqrt(rad)", 5e-3, ge=0, le=1, doc="random walk of attitude over rotation")
    mounting_sigma_deg: float = quantity(
        "deg",
        1.0,
        ge=0,
        le=45,
        doc="of the frame's rotation in `extrinsics`, which is estimated, as is its place; 0: both are known",
    )
    scale: float = quantity("1", 1.0, gt=0, le=1000, doc="by which the distances of its poses are multiplied")
    scale_sigma: float = quantity("1", 0.1, ge=0, le=1, doc="of `scale` if it is wrong, which is estimated; 0: known")
    covariance: Literal["directions", "always", "never"] = Field(
        "directions",
        description="of a message: what it adds to the noise; `directions`: those that it says are not known",
    )
    max_interval_s: float = quantity("s", 1.0, gt=0, le=10, doc="poses further apart are not joined")
    jump_sigma: float = quantity(
        "sigma", 8.0, gt=3, doc="a motion further from that of the IMU is a jump of the odometry"
    )
    robust_loss: RobustLoss = RobustLoss(kind="huber", threshold=2.5)

    @property
    def silence_s(self) -> float:
        """Time without a pose after which it is silent: two of the longest intervals that are joined [s]."""
        return 2.0 * self.max_interval_s


class OdometryConfig(DriftingConfig):
    """A pose that drifts, of a lidar, a camera or wheels, made by another program; noise is that between two poses."""

    kind: Literal["odometry"]


class ScansConfig(DriftingConfig):
    """Scans of a lidar, of which Holdfast makes an odometry itself, in its own process; noise is that of its poses.

    The scans are never seen by the estimator, nor is the estimate by the odometry: it knows the IMU and its own
    past, and nothing of GNSS.
    """

    kind: Literal["scans"]
    scale_sigma: float = quantity("1", 0.0, ge=0, le=1, doc="of `scale` if it is wrong; 0: a laser measures distances")
    method: Literal["small-gicp", "genz-icp", "kiss-icp"] = Field(
        "small-gicp", description="library that registers the scans; of the others only its poses are guided"
    )
    min_range_m: float = quantity("m", 1.0, ge=0, le=100, doc="nearer points are the machine itself")
    max_range_m: float = quantity("m", 120.0, gt=1, le=1000, doc="farther points are left out")
    machine_boxes_m: tuple[tuple[float, float, float, float, float, float], ...] = Field(
        (), description="parts of the machine in the lidar's frame, whose points are cut: two corners x y z x y z [m]"
    )
    learn_machine: bool = Field(True, description="cut what is learnt to move with the machine, such as its arm")
    map_voxel_m: float = quantity("m", MAP_VOXEL_M, gt=0.05, le=5, doc="cell of the map (small-gicp)")
    scan_voxel_m: float = quantity(
        "m", SCAN_VOXEL_M, gt=0.02, le=5, doc="of each cell of a scan one point is used (small-gicp)"
    )
    use_gyroscope: bool = Field(True, description="deskew and predict with what the IMU measures")
    latency_s: float = quantity(
        "s", 0.08, ge=0, le=5, doc="in a replay a pose comes so long after its scan; live it is what it is"
    )
    threads: int = Field(1, ge=1, le=64, description="of the registration; more than 1 varies the bits")


class TwistConfig(JudgedConfig, MountedConfig):
    """Velocity of a frame of the machine in that frame, such as that of its wheels or tracks."""

    may_be_on_chassis: ClassVar[bool] = True
    kind: Literal["twist"]
    topic: Topic
    axes: tuple[Axis, ...] = Field(("x",), min_length=1, description="linear velocities that are used")
    sigma_m_s: float = quantity("m/s", 0.05, gt=0, le=10, doc="per axis, where none is claimed; floor of a claim")
    slip_ratio: float = quantity("1", 0.02, ge=0, le=1, doc="error in proportion to the speed")
    scale_sigma: float = quantity("1", 0.05, ge=0, le=1, doc="of the scale factor, which is estimated; 0: known")


class GnssVelocityConfig(JudgedConfig, MountedConfig, ClockedConfig):
    """Velocity of a GNSS antenna by Doppler: east, north, up, as its receiver reports it beside its fixes."""

    kind: Literal["gnss_velocity"]
    topic: Topic
    frame: str | None = Field(None, description="that of the antenna in `extrinsics`; by default named as the sensor")
    axes: tuple[Axis, ...] = Field(
        ("x", "y", "z"), min_length=1, description="that are measured: east, north, up; NMEA tells no vertical velocity"
    )
    sigma_m_s: float = quantity(
        "m/s", 0.05, gt=0, le=10, doc="per axis, up twice as much; where none is claimed, and floor of a claim"
    )


class NonholonomicConfig(JudgedConfig, MountedConfig):
    """A constraint instead of a sensor: a machine whose wheels slip neither sideways nor off the ground."""

    may_be_on_chassis: ClassVar[bool] = True
    kind: Literal["nonholonomic"]
    topic: None = Field(None, description="there are no messages")
    axes: tuple[Axis, ...] = Field(("y", "z"), min_length=1, description="directions in which its frame does not move")
    rate_hz: float = quantity("Hz", 10.0, gt=0, le=100, doc="so often the constraint is applied")
    sigma_m_s: float = quantity("m/s", 0.05, gt=0, le=10, doc="by which the axle moves all the same")
    slip_ratio: float = quantity("1", 0.01, ge=0, le=1, doc="slip in proportion to the speed")
    mounting_sigma_deg: float = quantity(
        "deg", 1.0, ge=0, le=45, doc="of the frame's rotation against the motion, which is estimated; 0: known"
    )


class PoseConfig(JudgedConfig, MountedConfig):
    """An absolute pose, from a map matcher or a marker; its frame may be offset from W by a constant."""

    kind: Literal["pose"]
    topic: Topic
    position_sigma_m: float = quantity("m", 0.05, gt=0, le=100, doc="where none is claimed; floor of a claim")
    rotation_sigma_rad: float = quantity("rad", 0.01, gt=0, le=3, doc="where none is claimed; floor of a claim")
    offset_sigma_m: float = quantity("m", 0.0, ge=0, le=1e6, doc="of the frame in W, which is estimated; 0: it is W")
    offset_sigma_deg: float = quantity("deg", 0.0, ge=0, le=180, doc="of the frame's yaw in W; 0: it is that of W")

    def is_in_world(self) -> bool:
        """Whether its frame is W."""
        return self.offset_sigma_m == 0.0


class PrismConfig(PositionConfig):
    """A prism that a robotic total station follows."""

    kind: Literal["prism"]
    latency_s: float = quantity("s", 0.0, ge=0, le=10, doc="by which a measurement is older than its stamp")
    sigma_m: float = quantity("m", 0.005, gt=0, le=10, doc="per axis, where the station claims none; floor of a claim")
    max_sigma_m: float = quantity("m", 1.0, gt=0, doc="positions that claim a larger sigma are refused")
    correlation_s: float = quantity(
        "s", 0.25, ge=0, le=60, doc="correlation time of the errors: positions closer together weigh less each"
    )
    grid_position_m: Vector3 = quantity("m", (0.0, 0.0, 0.0), doc="origin of the station's site grid in W")
    grid_yaw_deg: float = quantity("deg", 0.0, ge=-360, le=360, doc="of the site grid's x axis in W: 0 is east")

    def is_in_world(self) -> bool:
        """Whether its frame is W."""
        return True


class HeightConfig(JudgedConfig, MountedConfig):
    """Height of a point of the machine, of a laser receiver or a barometer."""

    kind: Literal["height"]
    topic: Topic
    sigma_m: float = quantity("m", 0.05, gt=0, le=100, doc="where none is claimed; floor of a claim")
    offset_sigma_m: float = quantity("m", 0.0, ge=0, le=1e4, doc="of a constant that is estimated; 0: it is that of W")

    def is_in_world(self) -> bool:
        """Whether its frame is W."""
        return self.offset_sigma_m == 0.0


class JointConfig(SensorConfig):
    """Encoder of the cabin's turn joint."""

    kind: Literal["joint"]
    topic: Topic
    joint_name: str | None = Field(None, description="name in JointState; needed if the message has several joints")
    zero_offset_deg: float = quantity("deg", 0.0, ge=-360, le=360, doc="added to every angle")
    zero_offset_sigma_deg: float = quantity("deg", 0.1, gt=0, le=180, doc="trust in zero_offset_deg")
    noise_deg: float = quantity("deg", 0.02, gt=0, le=10, doc="noise of a reading, rounding to its resolution included")
    max_age_s: float = quantity("s", 0.2, gt=0, le=10, doc="older readings are late: not used, but reported")


class BaseImuConfig(InertialConfig):
    """The inertial measurement unit on the chassis."""

    kind: Literal["base_imu"]
    mounting_sigma_deg: float = quantity(
        "deg",
        0.3,
        ge=0,
        le=45,
        doc="of its yaw in `extrinsics` and of the axes in it: the encoder's zero is learnt no better than that",
    )
