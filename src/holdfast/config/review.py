"""What a valid configuration comes to, and what is legal in it but suspicious."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel

from holdfast.config.model import Config
from holdfast.config.schema import Place

MAX_USUAL_OFFSET_S = 0.5

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


def configured_sensors(config: Config) -> Iterator[tuple[str, BaseModel]]:
    """Yield the sensors that the configuration has: field name and section."""
    for name in type(config.sensors).model_fields:
        section = getattr(config.sensors, name)
        if isinstance(section, BaseModel):
            yield name, section


def sensor_rows(config: Config) -> list[SensorRow]:
    """Return topic, frame and lever arm of every sensor."""
    rows = []
    for name, section in configured_sensors(config):
        frame = getattr(section, "frame", None)
        lever_arm_m = None
        if frame is not None and config.reaches(frame):  # not beyond the turn joint
            lever_arm_m = float(np.linalg.norm(config.T_I(frame)[:3, 3]))
        rows.append(SensorRow(name, getattr(section, "topic", ""), frame, lever_arm_m))
    return rows


def warnings(config: Config) -> list[str]:
    """Return what is legal but rarely meant, one line each."""
    found = []
    for name, section in configured_sensors(config):
        found += [f"sensors.{name}.{text}" for text in _unusual_values(section)]
        frame = getattr(section, "frame", None)
        if name not in ("imu", "base_imu") and frame is not None:
            found += [f"sensors.{name}: {text}" for text in _unusual_mounting(config, frame)]
        if name in ("joint", "base_imu") and config.turn_joint is None:
            found.append(f"sensors.{name}: is not used, because there is no turn_joint")
    return found + list(_shared_frames(config))


def _shared_frames(config: Config) -> Iterator[str]:
    """Yield the sensors that name the frame of an earlier one; the default frame of both antennas is the same."""
    first: dict[str, str] = {}
    for name, section in configured_sensors(config):
        frame = getattr(section, "frame", None)
        if frame is None:
            continue
        if frame in first and first[frame] != "imu":
            yield f"sensors.{name}: is in the same frame {frame!r} as sensors.{first[frame]}: are they one device?"
        first.setdefault(frame, name)


def _unusual_values(section: BaseModel) -> Iterator[str]:
    for field, (low, high) in USUAL_RANGES.items():
        value = getattr(section, field, None)
        if value is not None and not low <= value <= high:
            unit = Place(type(section), None).child(field)
            yield f"{field} = {value:g}: outside {low:g} to {high:g} [{unit.unit if unit else ''}], is the unit right?"
    offset_s = getattr(section, "time_offset_s", 0.0)
    if abs(offset_s) > MAX_USUAL_OFFSET_S:
        yield f"time_offset_s = {offset_s:g}: more than {MAX_USUAL_OFFSET_S} s between two clocks, is it measured?"


def _unusual_mounting(config: Config, frame: str) -> Iterator[str]:
    imu_frame = config.sensors.imu.frame
    T_I_frame = config.T_I(frame)
    if frame == imu_frame:
        yield f"its frame is the IMU's ({frame!r}), so its lever arm is exactly zero"
    elif not T_I_frame[:3, 3].any():
        yield f"the lever arm from {imu_frame!r} to {frame!r} is exactly zero: is it measured?"
