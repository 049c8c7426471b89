"""What the datasheet of every simulated sensor says: rates, noise, delays and clocks.

These are sections of a scenario. Topics and frames end up in the configuration that is written beside the recording.
"""

from typing import Literal

from pydantic import Field

from holdfast.config.section import Section, Topic, quantity


class Transport(Section):
    """How messages travel from the sensor to the recording."""

    latency_s: float = quantity("s", 0.0, ge=0, le=10, doc="from the measurement to its arrival, at least")
    jitter_s: float = quantity("s", 0.0, ge=0, le=10, doc="mean of the exponential delay on top")
    loss_ratio: float = quantity("1", 0.0, ge=0, lt=1, doc="share of messages that never arrive")
    duplicate_ratio: float = quantity("1", 0.0, ge=0, lt=1, doc="share of messages that arrive twice")


class Clock(Section):
    """How the sensor's stamps depart from true time, which is the clock of the recording computer."""

    offset_s: float = quantity("s", 0.0, ge=-10, le=10, doc="added to every stamp")
    drift_ppm: float = quantity("ppm", 0.0, ge=-1000, le=1000, doc="growth of the offset")
    jitter_s: float = quantity("s", 0.0, ge=0, le=1, doc="sigma of every stamp")
    calibrated: bool = Field(True, description="the configuration written beside the recording knows offset_s")


class SimulatedSensor(Section):
    """What all sensors have."""

    topic: Topic
    frame: str = Field(min_length=1, description="its frame in `extrinsics`")
    rate_hz: float = quantity("Hz", gt=0, le=2000, doc="messages per second")
    transport: Transport = Transport()
    clock: Clock = Clock()


class SimulatedImu(SimulatedSensor):
    """An inertial measurement unit; densities as in Kalibr's imu.yaml (continuous time)."""

    accelerometer_noise_density: float = quantity("m/s^2/sqrt(Hz)", 1e-3, ge=0, le=1, doc="white noise")
    gyroscope_noise_density: float = quantity("rad/s/sqrt(Hz)", 1e-4, ge=0, le=1, doc="white noise")
    accelerometer_random_walk: float = quantity("m/s^3/sqrt(Hz)", 5e-5, ge=0, le=1, doc="drift of the bias")
    gyroscope_random_walk: float = quantity("rad/s^2/sqrt(Hz)", 2e-6, ge=0, le=1, doc="drift of the bias")
    accelerometer_bias_sigma: float = quantity("m/s^2", 0.03, ge=0, le=5, doc="bias at power-on")
    gyroscope_bias_sigma: float = quantity("rad/s", 2e-3, ge=0, le=1, doc="bias at power-on")
    accelerometer_scale_sigma: float = quantity("1", 5e-4, ge=0, le=0.1, doc="scale factor error per axis")
    gyroscope_scale_sigma: float = quantity("1", 5e-4, ge=0, le=0.1, doc="scale factor error per axis")
    misalignment_sigma_rad: float = quantity("rad", 5e-4, ge=0, le=0.1, doc="of the axes against each other")
    accelerometer_range: float = quantity("m/s^2", 78.0, gt=10, doc="readings saturate here")
    gyroscope_range: float = quantity("rad/s", 8.0, gt=0.1, doc="readings saturate here")
    accelerometer_resolution: float = quantity("m/s^2", 5e-4, ge=0, doc="readings are multiples of it")
    gyroscope_resolution: float = quantity("rad/s", 2e-5, ge=0, doc="readings are multiples of it")


class FixQuality(Section):
    """Error of a fix of one quality: white noise plus an error that changes slowly, per axis.

    The slow part (multipath, atmosphere) decorrelates with time and, being a pattern in space, with the antenna's way.
    """

    white_horizontal_m: float = quantity("m", ge=0, doc="sigma of the white part, east and north")
    white_vertical_m: float = quantity("m", ge=0, doc="sigma of the white part, up")
    slow_horizontal_m: float = quantity("m", ge=0, doc="sigma of the slow part, east and north")
    slow_vertical_m: float = quantity("m", ge=0, doc="sigma of the slow part, up")
    time_constant_s: float = quantity("s", 60.0, gt=0, doc="the slow part decorrelates in this time")
    distance_constant_m: float = quantity("m", 0.5, gt=0, doc="and over this way of the antenna")


class SimulatedGnss(SimulatedSensor):
    """One antenna of an RTK receiver.

    The fixed solution follows carrier-phase noise and multipath of geodetic antennas: 8 mm horizontally and 15 mm
    vertically in all, which is what the datasheets of machine control receivers claim.
    """

    rtk_fixed: FixQuality = FixQuality(
        white_horizontal_m=0.007, white_vertical_m=0.0125, slow_horizontal_m=0.004, slow_vertical_m=0.008
    )
    rtk_float: FixQuality = FixQuality(
        white_horizontal_m=0.03,
        white_vertical_m=0.05,
        slow_horizontal_m=0.3,
        slow_vertical_m=0.5,
        time_constant_s=30.0,
        distance_constant_m=10.0,
    )
    single: FixQuality = FixQuality(
        white_horizontal_m=0.3,
        white_vertical_m=0.5,
        slow_horizontal_m=1.5,
        slow_vertical_m=2.5,
        time_constant_s=60.0,
        distance_constant_m=20.0,
    )
    shared_ratio: float = quantity(
        "1", 0.3, ge=0, le=1, doc="share of the slow variance that both antennas have in common"
    )
    claim_ratio: float = quantity("1", 1.0, gt=0, doc="claimed sigma over the true one: 1 is an honest receiver")
    float_below: float = quantity("1", 0.6, ge=0, le=1, doc="with less open sky the fix falls to float")
    single_below: float = quantity("1", 0.35, ge=0, le=1, doc="with less open sky to single")
    none_below: float = quantity("1", 0.12, ge=0, le=1, doc="with less open sky there is none")
    refix_s: float = quantity("s", 6.0, ge=0, doc="good sky for so long resolves the ambiguities again")


class SimulatedHeading(SimulatedSensor):
    """Heading of a dual-antenna receiver: yaw of the baseline from the left to the right antenna."""

    white_rad: float = quantity("rad", 1.5e-3, ge=0, doc="sigma of the white part")
    slow_rad: float = quantity("rad", 8e-4, ge=0, doc="sigma of the slow part")
    time_constant_s: float = quantity("s", 60.0, gt=0, doc="the slow part decorrelates in this time")


class SimulatedJoint(SimulatedSensor):
    """Encoder of the cabin's turn joint."""

    joint_name: str = Field("cabin_turn", description="name in JointState")
    bias_sigma_rad: float = quantity("rad", 2e-3, ge=0, doc="zero offset of the mounting")
    noise_rad: float = quantity("rad", 2e-4, ge=0, doc="sigma of the white part")
    resolution_rad: float = quantity("rad", 3.83e-4, ge=0, doc="readings are multiples of it: 14 bits a turn")


class SimulatedLidar(SimulatedSensor):
    """A spinning lidar: one column of `channels` rays at a time."""

    channels: int = Field(128, ge=1, le=256, description="rays per column")
    columns: int = Field(512, ge=16, le=4096, description="columns per turn")
    field_of_view_deg: tuple[float, float] = Field((-45.0, 45.0), description="lowest and highest ray [deg]")
    min_range_m: float = quantity("m", 0.5, ge=0, doc="nearer returns are lost")
    max_range_m: float = quantity("m", 60.0, gt=0, doc="farther returns are lost")
    range_noise_m: float = quantity("m", 0.02, ge=0, doc="sigma of the range")
    dropout_ratio: float = quantity("1", 0.02, ge=0, lt=1, doc="share of returns that are lost")
    point_times: bool = Field(True, description="a field `t` tells when each point was measured")


class SimulatedLidarOdometry(SimulatedSensor):
    """A lidar odometry as a statistical model: pose of the lidar since its start, with jitter and drift."""

    jitter_m: float = quantity("m", 0.005, ge=0, doc="sigma of each pose, per axis")
    jitter_rad: float = quantity("rad", 3e-4, ge=0, doc="sigma of each pose, per axis")
    drift_m_per_sqrt_m: float = quantity("m/sqrt(m)", 0.01, ge=0, doc="random walk of the position, per way")
    drift_rad_per_sqrt_m: float = quantity("rad/sqrt(m)", 5e-4, ge=0, doc="random walk of the attitude, per way")
    drift_rad_per_sqrt_rad: float = quantity("sqrt(rad)", 1e-3, ge=0, doc="random walk of the attitude, per turn")


class SimulatedSensors(Section):
    """The sensors of a machine; one that is null is not there."""

    imu: SimulatedImu
    base_imu: SimulatedImu | None = None
    gnss: SimulatedGnss | None = None
    gnss_right: SimulatedGnss | None = None
    heading: SimulatedHeading | None = None
    joint: SimulatedJoint | None = None
    lidar: SimulatedLidarOdometry | None = None
    scanner: SimulatedLidar | None = Field(None, description="the lidar whose scans are ray-cast where asked for")

    def present(self) -> dict[str, SimulatedSensor]:
        """Return the sensors that are there, by name."""
        return {name: sensor for name in type(self).model_fields if (sensor := getattr(self, name)) is not None}


SensorName = Literal["imu", "base_imu", "gnss", "gnss_right", "heading", "joint", "lidar", "scanner"]
