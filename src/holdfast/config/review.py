"""What a valid configuration comes to, and what is legal in it but suspicious."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from pydantic import BaseModel

from holdfast.config.model import Config
from holdfast.config.schema import Place
from holdfast.config.sensors import (
    BaseImuConfig,
    GnssConfig,
    ImuConfig,
    InertialConfig,
    JointConfig,
    MountedConfig,
)
from holdfast.errors import ConfigError

MAX_USUAL_OFFSET_S = 0.5
MIN_BASELINE_M = 0.05  # antennas are wider

# field -> (low, high): between a laboratory's best and a phone's worst, in the field's unit
USUAL_RANGES = {
    "gyroscope_noise_density": (1e-6, 1e-2),
    "accelerometer_noise_density": (1e-5, 1e-1),
}


@dataclass(frozen=True)
class SensorRow:
    """One sensor as it is resolved; `lever_arm_m` is the distance from the IMU, None without a fixed one."""

    sensor: str
    topic: str
    frame: str | None
    lever_arm_m: float | None


def sensor_rows(config: Config) -> list[SensorRow]:
    """Return topic, frame and lever arm of every sensor."""
    rows = []
    for name, section in config.sensors.items():
        frame, lever_arm_m = _frame(config, name), None
        if frame is not None and config.reaches(frame):  # not beyond the turn joint
            lever_arm_m = float(np.linalg.norm(config.T_I(frame)[:3, 3]))
        rows.append(SensorRow(name, section.topic or "", frame, lever_arm_m))
    return rows


def impossibilities(config: Config) -> list[str]:
    """Return what a machine cannot be like, one line each; a file that was only begun may say so."""
    places = {name: config.T_I(config.frame_of(name))[:3, 3] for name in config.sensors_of(GnssConfig)}
    found = []
    if not _can_start(config):
        found.append(
            "sensors: nothing beside the IMU can start the estimate: add a sensor of positions or poses, such as "
            "`kind: gnss`, `kind: pose` or `kind: odometry`"
        )
    for (one, at), (other, there) in combinations(places.items(), 2):
        apart_m = float(np.linalg.norm(at - there))
        if apart_m < MIN_BASELINE_M:
            frames = f"{config.frame_of(one)} and {config.frame_of(other)}"
            found.append(
                f"extrinsics: the antennas of {one} and {other} are {apart_m:.3f} m apart, must be >= "
                f"{MIN_BASELINE_M:g} m: measure the translation_m of {frames}"
            )
    return found


def _can_start(config: Config) -> bool:
    """Whether messages come by which a start is attempted; those of IMUs and of the encoder are none."""
    return any(one.topic and not isinstance(one, InertialConfig | JointConfig) for one in config.sensors.values())


def check_possible(config: Config, name: str) -> Config:
    """Return a configuration with which something is to be estimated; `name` stands for its file in the message.

    Raises:
        ConfigError: no machine is like that, one line per impossibility.
    """
    if impossible := impossibilities(config):
        raise ConfigError("\n".join(f"{name}: {line}" for line in impossible))
    return config


def warnings(config: Config) -> list[str]:
    """Return what is legal but rarely meant, one line each."""
    found = []
    for name, section in config.sensors.items():
        found += [f"sensors.{name}.{text}" for text in _unusual_values(section)]
        found += [f"sensors.{name}: {text}" for text in (*_unusual_mounting(config, name), *_unused(config, name))]
    return [*found, *_shared_frames(config), *_shared_topics(config)]


def _frame(config: Config, name: str) -> str | None:
    """Return the frame of a sensor whose position on the machine matters, or None."""
    return config.frame_of(name) if isinstance(config.sensors[name], MountedConfig) else None


def _unused(config: Config, name: str) -> Iterator[str]:
    """Yield why a sensor that is configured has no effect."""
    section = config.sensors[name]
    if isinstance(section, JointConfig | BaseImuConfig) and config.turn_joint is None:
        yield "is not used, because there is no turn_joint"
    if isinstance(section, ImuConfig) and name != config.imu_name:
        yield f"is not used, because {config.imu_name} is the primary IMU"


def _shared_frames(config: Config) -> Iterator[str]:
    """Yield the sensors that name the frame of an earlier one; velocities may well be those of one frame."""
    first: dict[str, str] = {}
    for name, section in config.sensors.items():
        frame = _frame(config, name)
        if frame is None or frame == config.imu_frame or getattr(section, "may_be_on_chassis", False):
            continue
        if frame in first:
            yield f"sensors.{name}: is in the same frame {frame!r} as sensors.{first[frame]}: are they one device?"
        first.setdefault(frame, name)


def _shared_topics(config: Config) -> Iterator[str]:
    """Yield the sensors that read the topic of an earlier one of their kind."""
    first: dict[tuple[str, type[BaseModel]], str] = {}
    for name, section in config.sensors.items():
        key = section.topic or "", type(section)
        if section.topic and key in first:
            yield f"sensors.{name}: reads the same topic {section.topic!r} as sensors.{first[key]}: it counts twice"
        first.setdefault(key, name)


def _unusual_values(section: BaseModel) -> Iterator[str]:
    for field, (low, high) in USUAL_RANGES.items():
        value = getattr(section, field, None)
        if value is not None and not low <= value <= high:
            unit = Place(type(section), None).child(field)
            yield f"{field} = {value:g}: outside {low:g} to {high:g} [{unit.unit if unit else ''}], is the unit right?"
    offset_s = getattr(section, "time_offset_s", 0.0)
    if abs(offset_s) > MAX_USUAL_OFFSET_S:
        yield f"time_offset_s = {offset_s:g}: more than {MAX_USUAL_OFFSET_S} s between two clocks, is it measured?"


def _unusual_mounting(config: Config, name: str) -> Iterator[str]:
    section, frame, origin = config.sensors[name], _frame(config, name), config.imu_frame
    if frame is None or isinstance(section, InertialConfig) or getattr(section, "may_be_on_chassis", False):
        return  # nobody measures these by a tape
    if frame == origin:
        yield f"its frame is the IMU's ({frame!r}), so its lever arm is exactly zero"
    elif not config.T_I(frame)[:3, 3].any():
        yield f"the lever arm from {origin!r} to {frame!r} is exactly zero: is it measured?"
