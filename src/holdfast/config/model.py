"""Every section of the configuration but those of the sensors (`holdfast.config.sensors`), defaults and bounds.

A field's name carries its unit. Unknown keys are refused. Defaults come from physics and datasheets and serve every
machine.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Literal, Self, TypeVar

from pydantic import Field, model_validator

from holdfast.config.extrinsics import Extrinsic, TurnJointConfig
from holdfast.config.frame_tree import Link, poses_from
from holdfast.config.frames import FramesConfig
from holdfast.config.kinds import KINDS, AnySensor, kind_of
from holdfast.config.live import LiveConfig
from holdfast.config.realtime import RealtimeConfig
from holdfast.config.section import Section, quantity
from holdfast.config.sensors import (
    BaseImuConfig,
    GnssConfig,
    HeadingConfig,
    ImuConfig,
    JointConfig,
    MountedConfig,
    SensorConfig,
)
from holdfast.errors import ConfigError
from holdfast.messages import Array

Kind = TypeVar("Kind", bound=SensorConfig)
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
BELIEVE_BESIDE_ODOMETRY_S, BELIEVE_AFTER_JUMP_S, BELIEVE_ALONE_S = 30.0, 5.0, 1.0
RESERVED = ("standstill",)  # what counts and events name beside the sensors


class InitialisationConfig(Section):
    """How the estimator comes up."""

    heading_deg: float | None = quantity(
        "deg", None, ge=-360, le=360, doc="yaw of the IMU's x axis at the start: 0 is east, counter-clockwise"
    )
    heading_sigma_deg: float = quantity("deg", 2.0, gt=0, le=180, doc="trust in heading_deg")
    standstill_s: float = quantity("s", 1.0, gt=0.1, le=60, doc="standstill that is averaged")
    max_heading_sigma_deg: float = quantity(
        "deg", 10.0, gt=0, le=45, doc="starting in motion: heading must be this sure"
    )
    window_s: float = quantity(
        "s", 30.0, gt=1, le=300, doc="starting in motion: the longest stretch that is used, or eight positions"
    )


class StandstillConfig(Section):
    """Zero-velocity updates."""

    enabled: bool = True
    window_s: float = quantity("s", 1.0, gt=0.1, le=10, doc="quiet for this long is standstill")
    max_angular_rate_rad_s: float = quantity("rad/s", 0.01, gt=0, doc="std of the gyroscope that counts as quiet")
    max_acceleration: float = quantity("m/s^2", 0.15, gt=0, doc="std of the accelerometer that counts as quiet")
    max_speed_m_s: float = quantity("m/s", 0.03, gt=0, doc="estimated speed, beyond 3 sigma, that is not standstill")
    velocity_sigma_m_s: float = quantity("m/s", 0.01, gt=0, doc="noise of the zero-velocity update")


class GateConfig(Section):
    """When GNSS is lost and regained; fixes that fail a test never enter the graph."""

    innovation: bool = Field(True, description="test fixes against the prediction")
    baseline: bool = Field(True, description="test the distance between two antennas")
    drift_monitor: bool = Field(True, description="test whether fixes drag the frame of an odometry through W")
    max_speed_m_s: float = quantity(
        "m/s",
        40.0,
        gt=0,
        doc="no antenna moves faster between two fixes, unless the machine was known to; in long outages two sigma",
    )
    lose_after: int = Field(5, ge=1, le=1000, description="so many bad fixes in a row lose an antenna")
    regain_after: int = Field(5, ge=1, le=1000, description="so many good fixes in a row regain it")
    regain_s: float = quantity("s", 2.0, gt=0, le=60, doc="or two good ones so far apart, without a bad one between")
    silence_s: float = quantity("s", 1.0, gt=0, le=60, doc="no fix for so long (or 3 periods, if more) loses it too")
    quarantine_s: float = quantity("s", 1.5, ge=0, le=10, doc="at a loss, used fixes of this age are taken out again")
    believe_after_s: float | None = quantity(
        "s",
        None,
        gt=0,
        le=3600,
        doc="lost fixes that agree with each other for so long are right after all; by default 30 beside an "
        "odometry, which may know better, 5 where they have jumped, else 1",
    )

    def patience_s(self, *, has_odometry: bool, have_jumped: bool = False) -> float:
        """Return for how long lost fixes must agree with each other to be right after all [s]."""
        if self.believe_after_s is not None:
            return self.believe_after_s
        alone_s = BELIEVE_AFTER_JUMP_S if have_jumped else BELIEVE_ALONE_S
        return BELIEVE_BESIDE_ODOMETRY_S if has_odometry else alone_s


class MotionModelConfig(Section):
    """Constant twist, used only where the IMU is silent: how far a machine departs from it, as white noise.

    How it turns there its gyroscope shows, and soon counts for more.
    """

    acceleration_density: float = quantity("m/s^2/sqrt(Hz)", 1.5, gt=0, doc="acceleration of the machine")
    angular_rate_density: float = quantity("rad/s/sqrt(Hz)", 0.2, gt=0, doc="turning of the machine")


class GraphConfig(Section):
    """The fixed-lag smoother."""

    nodes: Literal["measurement", "imu"] = Field(
        "measurement", description="a node where measurements are, or (the paper) at every IMU sample"
    )
    lag_s: float = quantity("s", 3.0, gt=0.5, le=60, doc="length of the sliding window; it grows to hold what is later")
    relinearize_threshold_rad: float = quantity(
        "rad", 5e-3, gt=0, le=0.5, doc="iSAM2 relinearises a node whose attitude moved by more"
    )
    max_node_interval_s: float = quantity("s", 0.5, gt=0.01, le=5, doc="without measurements a node is made this often")
    dual: bool = Field(True, description="a fallback graph beside the main one while GNSS is lost (the paper)")
    main_odometry: Literal["anchored", "relative"] = Field(
        "anchored", description="poses are joined to the frame of their odometry, or (the paper) each to the one before"
    )
    fallback_odometry: Literal["anchored", "frozen"] = Field(
        "anchored", description="the odometry's frame drifts, or (the paper, Eq. 10) stays where it was at the loss"
    )
    gyroscope_scale: bool = Field(True, description="the scale factors of the gyroscope are estimated")
    position_integration_sigma: float = quantity(
        "m/sqrt(s)", 1e-4, gt=0, le=1, doc="what linear interpolation between IMU samples leaves"
    )


class SmoothingConfig(Section):
    """The optimum over a whole recording, of `holdfast smooth`."""

    loop_closures: bool = Field(
        True,
        description="places seen twice are registered, where the recording holds scans and small_gicp is installed",
    )


class Config(Section):
    """The whole configuration."""

    preset: Literal["holdfast", "paper"] = Field("holdfast", description="whose defaults: ours, or the paper's rules")
    sensors: dict[str, AnySensor] = Field(description="your name for a sensor -> its section, with `kind`")
    extrinsics: tuple[Extrinsic, ...] = ()
    turn_joint: TurnJointConfig | None = Field(None, description="where the cabin turns on the chassis")
    frames: FramesConfig = FramesConfig()
    initialisation: InitialisationConfig = InitialisationConfig()
    graph: GraphConfig = GraphConfig()
    gate: GateConfig = GateConfig()
    standstill: StandstillConfig = StandstillConfig()
    motion_model: MotionModelConfig = MotionModelConfig()
    smoothing: SmoothingConfig = SmoothingConfig()
    realtime: RealtimeConfig = RealtimeConfig()
    live: LiveConfig = LiveConfig()

    @model_validator(mode="after")
    def _check(self) -> Self:
        faults = list(faults_of(self))
        if faults:
            raise ValueError("\n".join(faults))
        return self

    # --- sensors -----------------------------------------------------------------------------------------------------

    def sensors_of(self, section: type[Kind]) -> dict[str, Kind]:
        """Return the sensors of one kind, by name, in the order of the file."""
        return {name: sensor for name, sensor in self.sensors.items() if isinstance(sensor, section)}

    def only(self, section: type[SensorConfig], name: str | None = None) -> str:
        """Return the name of a sensor of a kind: as it is given, or that of the only one.

        Raises:
            ConfigError: there is none of that name, or which one is meant is not clear.
        """
        known = self.sensors_of(section)
        if name in known or (name is None and len(known) == 1):
            return name or next(iter(known))
        allowed = ", ".join(known) or "none is configured"
        raise ConfigError(f"sensor = {name!r}: must name a sensor with `kind: {kind_of(section)}` ({allowed})")

    @property
    def imu_name(self) -> str:
        """The name of the primary IMU."""
        imus = self.sensors_of(ImuConfig)
        return next((name for name, imu in imus.items() if imu.primary), next(iter(imus)))

    @property
    def imu(self) -> ImuConfig:
        """The primary IMU."""
        return self.sensors_of(ImuConfig)[self.imu_name]

    @property
    def imu_frame(self) -> str:
        """The name of I."""
        return self.imu.frame or self.imu_name

    def frame_of(self, name: str) -> str:
        """Return the frame in which a sensor sits: the one that it names, or else its own name."""
        return getattr(self.sensors[name], "frame", None) or name

    @property
    def joint(self) -> tuple[str, JointConfig] | None:
        """The encoder of the turn joint, name and section."""
        return next(iter(self.sensors_of(JointConfig).items()), None)

    @property
    def base_imu(self) -> tuple[str, BaseImuConfig] | None:
        """The IMU of the chassis, name and section."""
        return next(iter(self.sensors_of(BaseImuConfig).items()), None)

    # --- frames ------------------------------------------------------------------------------------------------------

    def has_base(self) -> bool:
        """Whether the chassis is joined to the IMU, rigidly or by the turn joint, and is not the IMU itself."""
        base = self.frames.base
        return self.turn_joint is not None or (self.reaches(base) and base != self.imu_frame)

    def is_beyond_joint(self, frame: str) -> bool:
        """Whether a frame sits on the chassis, which the turn joint joins to the IMU."""
        return self.turn_joint is not None and not self.reaches(frame) and self.reaches(frame, self.turn_joint.parent)

    def reaches(self, frame: str, origin: str | None = None) -> bool:
        """Whether `extrinsics` join a frame to another, by default to the IMU's."""
        return frame in poses_from(origin or self.imu_frame, self.links())

    def T(self, origin: str, frame: str) -> Array:
        """Return T_origin_frame, the pose of a frame in another, as a (4, 4) matrix [m].

        Raises:
            ValueError: no chain of `extrinsics` joins the two frames.
        """
        frames = poses_from(origin, self.links())
        if frame not in frames:
            raise ValueError(self.unreachable(frame, origin))
        return frames[frame]

    def T_I(self, frame: str) -> Array:
        """Return T_I_frame, the pose of a frame in the IMU's frame, as `T` does."""
        return self.T(self.imu_frame, frame)

    def links(self) -> list[Link]:
        """Return the transforms of `extrinsics`."""
        return [Link(extrinsic.parent, extrinsic.child, extrinsic.matrix()) for extrinsic in self.extrinsics]

    def unreachable(self, frame: str, origin: str | None = None) -> str:
        """Return the fault of a frame that no transforms join to another."""
        known = ", ".join(sorted({e.parent for e in self.extrinsics} | {e.child for e in self.extrinsics})) or "none"
        return f"no transforms lead from {origin or self.imu_frame!r} to {frame!r} (frames in extrinsics: {known})"


def register_kind(section: type[SensorConfig]) -> type[SensorConfig]:
    """Let configurations name one more kind of sensor; usable as a decorator of its section."""
    KINDS[kind_of(section)] = section
    Config.model_rebuild(force=True)
    return section


def check_config(config: object) -> None:
    """Refuse what is no configuration, such as the path of one.

    Raises:
        ConfigError: names the type that came.
    """
    if not isinstance(config, Config):
        raise ConfigError(f"config: must be a Config, as load_config gives, not {type(config).__name__}")


def check_sensor(config: Config, sensor: object) -> None:
    """Refuse what is no sensor of a configuration.

    Raises:
        ConfigError: names those that there are.
    """
    if not isinstance(sensor, str) or sensor not in config.sensors:
        raise ConfigError(f"sensor: {sensor!r} is not in the configuration (allowed: {', '.join(config.sensors)})")


def faults_of(config: Config) -> Iterator[str]:
    """Yield what contradicts itself in a configuration, each with its place."""
    yield from _faults_of_sensors(config)
    children = [extrinsic.child for extrinsic in config.extrinsics]
    twice = sorted({child for child in children if children.count(child) > 1})
    if twice:
        yield f"extrinsics: frame {twice[0]!r} has two parents"
    elif circle := _circle(config.extrinsics):
        yield f"extrinsics: {' -> '.join(circle)} lead back to where they begin, and no frame can carry itself"
    elif config.sensors_of(ImuConfig):
        yield from _faults_of_mounts(config)
        yield from _faults_of_chassis(config)
        yield from _faults_of_frames(config)


def _circle(extrinsics: Iterable[Extrinsic]) -> list[str]:
    """Return frames of which each is the parent of the next, and the first is the last; empty if there are none."""
    parents = {extrinsic.child: extrinsic.parent for extrinsic in extrinsics}
    for child in parents:
        chain = [child]
        while (parent := parents.get(chain[0])) is not None and parent not in chain:
            chain.insert(0, parent)
        if parent is not None:
            return [parent, *chain[: chain.index(parent) + 1]]
    return []


def _faults_of_sensors(config: Config) -> Iterator[str]:
    for name in config.sensors:
        if not NAME.fullmatch(name) or name in RESERVED:
            must_be = f"a letter, then letters, digits and _; not {', '.join(RESERVED)}"
            yield f"sensors: {name!r} is no name for a sensor: {must_be}"
    imus = config.sensors_of(ImuConfig)
    primary = [name for name, imu in imus.items() if imu.primary]
    if not imus:
        yield "sensors: needs a sensor with `kind: imu`"
    elif len(primary) > 1 or (len(imus) > 1 and not primary):
        yield f"sensors: exactly one of the IMUs {', '.join(imus)} must have `primary: true`"
    for kind in (JointConfig, BaseImuConfig):
        several = config.sensors_of(kind)
        if len(several) > 1:
            yield f"sensors: there may be one sensor with `kind: {kind_of(kind)}`, not {' and '.join(several)}"
    if config.sensors_of(GnssConfig) and config.frames.datum is None:
        for name in (name for name, sensor in config.sensors.items() if sensor.is_in_world()):
            yield f"frames.datum: is needed, because {name} measures in W as GNSS does: give the origin of W"
    for name, heading in config.sensors_of(HeadingConfig).items():
        strange = [antenna for antenna in heading.baseline or () if antenna not in config.sensors_of(GnssConfig)]
        if strange:
            yield f"sensors.{name}.baseline: {strange[0]!r} is no sensor with `kind: gnss`"
        elif heading.baseline is not None and heading.baseline[0] == heading.baseline[1]:
            yield f"sensors.{name}.baseline: must be two antennas, not {heading.baseline[0]} twice"


def _faults_of_mounts(config: Config) -> Iterator[str]:
    antennas: dict[str, str] = {}
    for name, sensor in config.sensors.items():
        frame = config.frame_of(name)
        if not isinstance(sensor, MountedConfig) or isinstance(sensor, ImuConfig | BaseImuConfig):
            continue
        on_chassis = sensor.may_be_on_chassis and config.is_beyond_joint(frame)
        if not config.reaches(frame) and not on_chassis:
            yield f"sensors.{name}.frame: {config.unreachable(frame)}"
        if isinstance(sensor, GnssConfig):
            if frame in antennas:
                yield f"sensors.{name}.frame: is that of {antennas[frame]}: two antennas cannot share one frame"
            antennas.setdefault(frame, name)


def _faults_of_chassis(config: Config) -> Iterator[str]:
    base, joint = config.frames.base, config.turn_joint
    if joint is not None:
        if config.joint is None:
            yield "turn_joint: needs a sensor with `kind: joint`, the encoder that reads its angle"
        if config.reaches(base):
            yield f"turn_joint: extrinsics join {config.imu_frame!r} and {base!r} already, as if nothing turned"
        elif not config.reaches(joint.parent, base):
            yield f"turn_joint.parent: {config.unreachable(joint.parent, base)}"
        if not config.reaches(joint.child):
            yield f"turn_joint.child: {config.unreachable(joint.child)}"
    if config.base_imu is not None:
        name, _ = config.base_imu
        frame = config.frame_of(name)
        if not config.reaches(frame, base):
            yield f"sensors.{name}.frame: {config.unreachable(frame, base)}"


def _faults_of_frames(config: Config) -> Iterator[str]:
    """Yield names with which the published frames would be no tree; the base may well be the IMU's frame."""
    frames = config.frames
    names = {"world": frames.world, "odometry": frames.odometry, "base": frames.base}
    yield from (f"frames.{key}: must not be empty" for key, name in names.items() if not name.strip())
    if frames.world == frames.odometry:
        yield f"frames.odometry: {frames.odometry!r} is frames.world, too: must be another name"
        return
    for key in ("world", "odometry"):
        if config.reaches(names[key]) or config.reaches(names[key], frames.base):
            yield f"frames.{key}: {names[key]!r} is a frame of the machine: must be another name"
