"""What was learnt of the sensors, in a file from one run to the next.

The file says by which numbers of the configuration each thing was learnt. Where the configuration says otherwise now,
it is the firmer word: what was learnt against the old number is dropped, and told.
"""

import json
from collections.abc import Collection, Mapping, Set
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from holdfast.config.document import MAX_CHARACTERS, read_document
from holdfast.config.load import validate
from holdfast.config.model import Config
from holdfast.config.section import Section
from holdfast.config.sensors import MountedConfig, SensorConfig
from holdfast.errors import ConfigError
from holdfast.integrity.learnt_snapshot import (
    NAMES_ARE_RIGHT,
    NOTHING_LEARNT,
    LearntOdometry,
    LearntSnapshot,
)
from holdfast.output_folder import check_output_file
from holdfast.sensors.clock import CLOCK, DELAY, with_estimated_clock
from holdfast.sensors.constants import priors_of_imu
from holdfast.sensors.heading import MOUNT
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT
from holdfast.sensors.lever_arm import ARM
from holdfast.sensors.mount import Mount
from holdfast.sensors.registry import sensors_of
from holdfast.whole_file import write_whole

ALLOWED = "a file that --learnt has written"
POSE = "pose"  # of the frame in that of the IMU, from `extrinsics`
CLOCK_KEYS = {"time_offset_s", "time_offset_sigma_s"}
MOUNT_KEYS = {POSE, "mounting_sigma_deg", "mounting_yaw_deg", "baseline", "lever_arm_sigma_m", "scale", "scale_sigma"}
JOINT_KEYS = {"zero_offset_deg", "zero_offset_sigma_deg", "mounting_sigma_deg"}
NOISE_WORDS = "sigma", "drift", "density", "ratio", "correlation", "constant"
NO_NOISE = {"gate_sigma", "jump_sigma"}  # thresholds, in sigmas
POSE_DIGITS = 9


class LearntFile(Section):
    """The content of the file."""

    schema_version: Literal[1] = Field(1, description="of this layout")
    written_by: str = Field(description="version of Holdfast")
    configured: dict[str, dict[str, Any]] = Field(description="the numbers by which it was learnt, by sensor")
    learnt: LearntSnapshot = Field(description="what was learnt")


class Loaded(NamedTuple):
    """What a file holds for a configuration, and what is to be told of the rest."""

    learnt: LearntSnapshot
    warnings: list[str]


def load_learnt(path: str | Path, config: Config) -> Loaded:
    """Read a file; one that is not there holds nothing.

    Raises:
        ConfigError: it cannot be read, or is none; one line with the file, the key and what is allowed.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        if not file.absolute().parent.is_dir():
            raise ConfigError(f"{file}: cannot be written (its folder does not exist)") from None
        return Loaded(NOTHING_LEARNT, [])
    except (OSError, UnicodeDecodeError) as error:
        reason = (getattr(error, "strerror", None) or "is no UTF-8 text").lower()
        raise ConfigError(f"{file}: cannot be read: {reason} (allowed: {ALLOWED})") from None
    try:
        found = validate(read_document(text[: MAX_CHARACTERS + 1], str(file)), LearntFile)
    except ConfigError as error:
        first, *rest = str(error).splitlines()
        more = f", and {len(rest)} mistakes more" if rest else ""
        raise ConfigError(f"{first}{more} (allowed: {ALLOWED})") from None
    return _fitting(found, config)


def save_learnt(path: str | Path, learnt: LearntSnapshot, config: Config) -> None:
    """Write a file, whole or not at all.

    Raises:
        ConfigError: it cannot be written.
    """
    content = LearntFile(written_by=version("holdfast"), configured=_configured(config), learnt=learnt)
    write_whole(path, json.dumps(content.model_dump(mode="json", exclude_none=True), indent=1) + "\n")


def check_learnt_file(path: str | Path, folder: str | Path, reads: Collection[str]) -> None:
    """Refuse a file in the folder of the results or in a recording, one that is read, or one that cannot be written.

    Raises:
        ConfigError: names both.
    """
    if Path(folder).resolve() in Path(path).resolve().parents:
        raise ConfigError(f"{path}: is in {folder}, which is replaced by each run: give a file outside of it")
    check_output_file(path, reads)


def _configured(config: Config) -> dict[str, dict[str, Any]]:
    """Return the numbers by which things are learnt, by sensor."""
    found = {name: _numbers(config, name, config.sensors[name]) for name in (config.imu_name, *sensors_of(config))}
    return found | _numbers_of_joint(config)


def _numbers_of_joint(config: Config) -> dict[str, dict[str, Any]]:
    """Return those of the encoder and the base IMU, where both are: how each unit sits on the joint among them."""
    if config.turn_joint is None or config.joint is None or config.base_imu is None or not config.has_base():
        return {}
    (encoder, joint), (base, imu) = config.joint, config.base_imu
    mount, found = Mount(config, config.frame_of(base)), {}
    for name, section, T in ((encoder, joint, mount.T_I_A), (base, imu, mount.T_J_S)):
        data = section.model_dump(mode="json", include=JOINT_KEYS)
        found[name] = {"kind": section.kind, **data, POSE: T.matrix()[:3].round(POSE_DIGITS).ravel().tolist()}
    return found


def _numbers(config: Config, name: str, section: SensorConfig) -> dict[str, Any]:
    data: dict[str, Any] = section.model_dump(mode="json")
    kept = {key: value for key, value in data.items() if key in CLOCK_KEYS | MOUNT_KEYS or _is_noise(key)}
    frame = config.frame_of(name) if isinstance(section, MountedConfig) else ""
    if frame and config.reaches(frame) and not config.is_beyond_joint(frame):
        kept[POSE] = config.T_I(frame)[:3].round(POSE_DIGITS).ravel().tolist()
    return {"kind": section.kind, **{key: value for key, value in kept.items() if value is not None}}


def _is_noise(key: str) -> bool:
    return key not in NO_NOISE and any(word in key for word in NOISE_WORDS)


def _fitting(file: LearntFile, config: Config) -> Loaded:
    """Return what holds for a configuration: of sensors that it has, by numbers that it still has."""
    warnings: list[str] = []
    changed: dict[str, dict[str, str]] = {}
    now = _configured(config)
    for name, before in file.configured.items():
        if name not in config.sensors:
            warnings.append(f"{name}: is not configured: what was learnt of it is ignored")
        if name not in now:
            continue
        differences = _differences(before, now[name])
        changed[name] = differences
        if differences:
            listed = ", ".join(f"{key} {text}" for key, text in differences.items())
            warnings.append(f"{name}: changed since it was learnt ({listed}): learnt anew")
    noisy = {name for name, keys in changed.items() if keys.keys() - CLOCK_KEYS - MOUNT_KEYS}
    known = changed.keys() - noisy
    odometries = {name: one for name, one in file.learnt.odometries.items() if name in known}
    accelerometer = file.learnt.accelerometer
    if config.imu_name not in known:
        odometries, accelerometer = {name: _without_yaw(one) for name, one in odometries.items()}, None
    owners = _owners(config)
    constants = {
        constant: one
        for constant, one in file.learnt.constants.items()
        if constant in owners and all(_holds(changed.get(name), keys) for name, keys in owners[constant])
    }
    noise = {name: one for name, one in file.learnt.noise.items() if name in known}
    at_joint = [changed.get(one[0]) for one in (config.joint, config.base_imu) if one is not None]
    joint = file.learnt.joint if at_joint == [{}, {}] else NOTHING_OF_JOINT
    names = file.learnt.names
    are_mounted_so = all(_holds(changed.get(name), MOUNT_KEYS) for name in (*names.antennas, *names.reversed))
    learnt = LearntSnapshot(
        odometries=odometries,
        noise=noise,
        constants=constants,
        accelerometer=accelerometer,
        joint=joint,
        names=names if are_mounted_so else NAMES_ARE_RIGHT,
        early_ns={one: by for one, by in file.learnt.early_ns.items() if _holds(changed.get(one), CLOCK_KEYS)},
    )
    return Loaded(learnt, warnings)


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, str]:
    """Return the keys that differ, with both values in words."""
    found: dict[str, str] = {}
    for key in {**before, **now}:
        was, is_now = before.get(key), now.get(key)
        if was != is_now:
            found[key] = "of its frame" if key == POSE else f"{was} -> {is_now}"
    return found


def _holds(changed: Mapping[str, str] | None, keys: Set[str]) -> bool:
    """Whether a constant of a sensor, which depends on some keys, is still as it was learnt."""
    return changed is not None and changed.keys().isdisjoint(keys | {"kind"})


def _owners(config: Config) -> dict[str, list[tuple[str, Set[str]]]]:
    """Return the sensors that have each constant, with the keys that it depends on, by its name in the graph."""
    found: dict[str, list[tuple[str, Set[str]]]] = {name: [(name, MOUNT_KEYS)] for name in priors_of_imu(config)}
    keys_of_part = {ARM: MOUNT_KEYS, MOUNT: MOUNT_KEYS, CLOCK: CLOCK_KEYS, DELAY: CLOCK_KEYS}
    for name, sensor in sensors_of(config).items():
        for prior in with_estimated_clock(sensor).parameters:
            keys = keys_of_part.get(prior.part, CLOCK_KEYS | MOUNT_KEYS)
            of_axis = getattr(sensor, "antennas", ()) if prior.part == MOUNT else ()
            found.setdefault(prior.name(name), []).extend((one, keys) for one in (name, *of_axis))
    return found


def _without_yaw(learnt: LearntOdometry) -> LearntOdometry:
    return learnt.model_copy(update={"yaw": None})
