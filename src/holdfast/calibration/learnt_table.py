"""What was learnt of the sensors beside what the configuration says, and which of its keys look wrong."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from math import degrees, exp, fmod, hypot, radians, sqrt
from typing import Any

import gtsam
import numpy as np

from holdfast.calibration.placing import moved, placed
from holdfast.config.document import path_text, yaml_text
from holdfast.config.model import Config
from holdfast.config.sensors import (
    DriftingConfig,
    GnssConfig,
    HeadingConfig,
    JointConfig,
    NonholonomicConfig,
    TwistConfig,
)
from holdfast.integrity.calibration import SLACK_RAD, SLACK_RATIO, SLACK_S
from holdfast.integrity.learnt_snapshot import (
    Factor,
    LearntNoiseScale,
    LearntOdometry,
    LearntSnapshot,
    accelerometer_factor,
    gyroscope_factor,
)
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.messages import Array
from holdfast.sensors.clock import DELAY, with_estimated_clock
from holdfast.sensors.constants import OBSERVED, LearntConstant, length_and_sigma, priors_of_imu
from holdfast.sensors.heading import IF_RIGHT_RAD, MOUNT, configured_yaw_deg
from holdfast.sensors.learnt_joint import LearntJoint
from holdfast.sensors.lever_arm import ARM
from holdfast.sensors.odometry_calibration import NOMINAL, mounted
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.scale import SCALE
from holdfast.sensors.sensor import Parameter, lever_arm

SEEN = 0.55  # sigma of a logarithm above which a factor is not known: half of the prior's
SIGMA = 3.0
FIRST, LAST = 0, -1  # key of a frame: rotation before translation
SLACK_M, SLACK_ZERO_RAD = 0.01, 1e-3
FACTOR = 2.0
SHOWN = 4  # lines at the end of a command
AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Row:
    """One number that was learnt.

    Attributes:
        sensor: by name.
        what: in words.
        key: in the configuration; empty where it has none.
        unit: of the numbers.
        configured: what the configuration says; None where it says nothing.
        learnt: beside that.
        sigma: of `learnt`, where there is one.
        looks_wrong: the key does.
        write: what the key should be, where that is known.
    """

    sensor: str
    what: str
    key: str
    unit: str
    configured: float | None
    learnt: float
    sigma: float | None
    looks_wrong: bool = False
    write: str = ""


def learnt_rows(learnt: LearntSnapshot, config: Config) -> list[Row]:
    """Return everything that is known of what was learnt."""
    rows: list[Row] = []
    for name, sensor in sensors_of(config).items():
        for prior in with_estimated_clock(sensor).parameters:
            constant = learnt.constants.get(prior.name(name))
            if constant is not None and prior.part != DELAY:  # it comes with the clock
                rows += _of_constant(name, config, prior, constant, learnt)
    for name, prior in priors_of_imu(config).items():
        if name in learnt.constants:
            rows += _of_imu(name, prior, learnt.constants[name])
    for name, odometry in learnt.odometries.items():
        section = config.sensors.get(name)
        if isinstance(section, DriftingConfig):
            rows += _of_odometry(name, section, odometry)
    of_imu = gyroscope_factor(learnt.odometries.values()), accelerometer_factor(learnt.accelerometer)
    rows += [row for factor in of_imu for row in _of_imu_noise(config, factor)]
    rows += _of_joint(config, learnt.joint)
    for name, really in learnt.names.antennas.items():
        if {name, really} <= config.sensors_of(GnssConfig).keys():
            apart = lever_arm(really, config) - lever_arm(name, config)
            rows += _of_arm(name, config, apart, np.full(3, SLACK_M))
    for name, noise in learnt.noise.items():
        rows += _of_noise(name, config, noise)
    return rows


def plain_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return rows as plain data, for summary.json."""
    return [asdict(row) for row in rows]


def wrong_lines(rows: Sequence[Row]) -> list[str]:
    """Return a few lines about keys that look wrong, one for each key."""
    told: dict[str, str] = {}
    for row in rows:
        if row.looks_wrong and row.key not in told:
            is_number = row.write.replace(".", "").replace("-", "").replace("e", "").isdigit()
            is_now = f", is {row.configured:.4g}" if is_number and row.configured is not None else ""
            told[row.key] = f"{row.key} looks wrong ({row.sensor}, {row.what}): {row.write or 'see the report'}{is_now}"
    lines = list(told.values())
    if len(lines) > SHOWN:
        lines[SHOWN:] = [f"and {len(lines) - SHOWN} keys more that look wrong"]
    return lines


def _of_odometry(name: str, section: DriftingConfig, learnt: LearntOdometry) -> list[Row]:
    rows = [
        _factor_row(name, key, float(getattr(section, key)), _unit(section, key), factor)
        for factor in learnt.factors()
        for key in factor.keys
        if factor.log_sigma <= SEEN
    ]
    # two factors may be on one key: the file should say the larger one
    most = {key: max(row.learnt for row in rows if row.key == key) for key in {row.key for row in rows}}
    return [row if not row.looks_wrong else replace(row, write=f"{most[row.key]:.3g}") for row in rows]


def _of_imu_noise(config: Config, factor: Factor | None) -> list[Row]:
    if factor is None or factor.log_sigma > SEEN:
        return []
    return [
        _factor_row(config.imu_name, key, float(getattr(config.imu, key)), _unit(config.imu, key), factor)
        for key in factor.keys
    ]


def _factor_row(name: str, key: str, configured: float, unit: str, factor: Factor) -> Row:
    value = configured * factor.value
    write = f"{value:.3g}" if factor.is_wrong else ""
    path = path_text(("sensors", name, key))
    return Row(name, factor.what, path, unit, configured, value, value * factor.log_sigma, factor.is_wrong, write)


def _of_noise(name: str, config: Config, learnt: LearntNoiseScale) -> list[Row]:
    section, ratio = config.sensors.get(name), NoiseScale(learnt).ratio
    floors = (GnssConfig, "min_sigma_m"), (HeadingConfig, "min_sigma_deg")
    floor = next((key for kind, key in floors if isinstance(section, kind)), "")
    key = path_text(("sensors", name, floor)) if floor else ""
    is_wrong = bool(key) and ratio > FACTOR
    write = "`holdfast calibrate` finds it" if is_wrong else ""
    rows = [Row(name, "noise, times what it claims", key, "1", 1.0, ratio, None, is_wrong, write)]
    if learnt.white_variance is not None:
        rows.append(Row(name, "white part of what it claims", "", "1", None, sqrt(learnt.white_variance), None))
    return rows


def _of_constant(
    name: str, config: Config, prior: Parameter, learnt: LearntConstant, of_all: LearntSnapshot
) -> Iterator[Row]:
    """Yield the rows of one of a sensor's constants, beside what was learnt of all sensors."""
    own = of_all.constants.get(name)
    section, mean, sigmas = config.sensors[name], np.array(learnt.mean), np.array(learnt.sigmas)
    if prior.part == ARM:
        is_told = learnt.is_off or prior.if_right is None
        if is_told and isinstance(section, DriftingConfig):
            yield from _of_odometry_arm(name, config, learnt, own)
        elif is_told:
            yield from _of_arm(name, config, mean, sigmas)
        return
    if prior.part == MOUNT:
        if learnt.is_off or sigmas[0] < OBSERVED * IF_RIGHT_RAD:
            yield _of_heading(name, config, float(mean[0]), float(sigmas[0]))
        return
    if prior.part == SCALE:
        if learnt.is_off and isinstance(section, DriftingConfig):
            yield _of_scale(name, section.scale, float(mean[0]), float(sigmas[0]))
        return
    if prior.has_clock and getattr(section, "time_offset_sigma_s", 0.0) > 0.0:
        yield _of_clock(name, section.time_offset_s, learnt, of_all)
    if isinstance(section, DriftingConfig) and section.mounting_sigma_deg > 0.0:
        yield from _of_mounting(name, config, mean[:3], sigmas[:3])
    elif isinstance(section, TwistConfig):
        yield Row(name, "scale factor", "", "1", 1.0, 1.0 + float(mean[0]), float(sigmas[0]))
    elif isinstance(section, NonholonomicConfig):
        for what, value, sigma in zip(("yaw", "pitch"), mean.tolist(), sigmas.tolist(), strict=True):
            yield Row(name, f"mounting, {what}", "", "deg", 0.0, degrees(value), degrees(sigma))


def _of_imu(name: str, prior: Parameter, learnt: LearntConstant) -> Iterator[Row]:
    """Yield the scale factors of the gyroscope about the axes that the machine has turned about."""
    for axis, ratio, sigma, before in zip(AXES, learnt.mean, learnt.sigmas, prior.sigmas.tolist(), strict=True):
        if sigma < OBSERVED * before:
            yield Row(name, f"scale factor of the gyroscope, {axis}", "", "1", 1.0, 1.0 + ratio, sigma)


def _of_clock(name: str, configured_s: float, clock: LearntConstant, of_all: LearntSnapshot) -> Row:
    """Return the row of a clock, and of the delay and of what is in the stamps already beside it."""
    early_s, parts = of_all.early_ns.get(name, 0) * 1e-9, [clock]
    if (delay := of_all.constants.get(f"{name} {DELAY}")) is not None and delay.is_off:
        parts.append(delay)
    offset_s, sigma_s = early_s + sum(one.mean[-1] for one in parts), hypot(*(one.sigmas[-1] for one in parts))
    is_off = early_s != 0.0 or any(one.is_off for one in parts)
    is_wrong = is_off and abs(offset_s) > SIGMA * sigma_s + SLACK_S
    value, key = configured_s + offset_s, path_text(("sensors", name, "time_offset_s"))
    write = f"{value:z.4f}" if is_wrong else ""
    return Row(name, "clock", key, "s", configured_s, value, sigma_s, is_wrong, write)


def _of_heading(name: str, config: Config, off_rad: float, sigma_rad: float) -> Row:
    is_wrong = abs(off_rad) > SIGMA * sigma_rad + SLACK_RAD
    configured_deg, key = configured_yaw_deg(name, config), path_text(("sensors", name, "mounting_yaw_deg"))
    value = configured_deg + degrees(off_rad)
    write = f"{fmod(value, 360.0):.2f}" if is_wrong else ""
    return Row(name, "mounting, yaw", key, "deg", configured_deg, value, degrees(sigma_rad), is_wrong, write)


def _of_scale(name: str, configured: float, log_factor: float, sigma: float) -> Row:
    is_wrong = abs(log_factor) > SIGMA * sigma + SLACK_RATIO
    value, key = configured * exp(log_factor), path_text(("sensors", name, "scale"))
    write = f"{value:.4f}" if is_wrong else ""
    return Row(name, "scale of its distances", key, "1", configured, value, value * sigma, is_wrong, write)


def _of_mounting(name: str, config: Config, rotation: Array, sigmas: Array) -> Iterator[Row]:
    """Yield the rows of a mounting that is rotated by a vector (3,) [rad] about its own axes."""
    correction = np.eye(4)
    correction[:3, :3] = gtsam.Rot3.Expmap(rotation).matrix()
    yield from _of_rotation(name, "mounting, about its", rotation, sigmas, _moved(name, config, correction))


def _of_rotation(name: str, what: str, rotation: Array, sigmas: Array, told: tuple[str, str]) -> Iterator[Row]:
    """Yield the rows of a rotation (n,) [rad] about the first axes, given its key and what to write there."""
    off, sigma = length_and_sigma(rotation, sigmas)
    is_wrong, (key, write) = off > SIGMA * sigma + SLACK_RAD, told
    for axis, value, of in zip(AXES, np.degrees(rotation).tolist(), np.degrees(sigmas).tolist(), strict=False):
        is_most = is_wrong and abs(radians(value)) >= off / 2.0
        yield Row(name, f"{what} {axis}", key, "deg", 0.0, value, of, is_most, write if is_most else "")


def _of_joint(config: Config, learnt: LearntJoint) -> Iterator[Row]:
    """Yield the rows of the encoder, and of cabin's and chassis' unit, each tilted about x and y of the joint."""
    if config.joint is None or config.base_imu is None or config.turn_joint is None:
        return
    base, base_imu = config.base_imu
    if learnt.zero is not None:
        sigma = hypot(learnt.zero.sigmas[0], radians(base_imu.mounting_sigma_deg))  # its yaw looks like a zero
        yield _of_zero(*config.joint, learnt.zero.mean[0], sigma)
    what, ratio = "mounting, about the joint's", config.imu.gyroscope_error_ratio
    if learnt.cabin_tilt is not None:
        tilt, R = _tilt(learnt.cabin_tilt)
        T = config.turn_joint.matrix()
        T[:3, :3] = R @ T[:3, :3]
        changes = placed(("turn_joint",), config.turn_joint, T)
        told = (path_text(changes[0].path), yaml_text(changes[0].value)) if changes else ("turn_joint", "")
        yield from _of_rotation(config.imu_name, what, tilt, np.hypot(learnt.cabin_tilt.sigmas, ratio), told)
    if learnt.base_tilt is not None:
        tilt, R = _tilt(learnt.base_tilt)
        correction, R_J_S = np.eye(4), config.T(config.turn_joint.parent, config.frame_of(base))[:3, :3]
        correction[:3, :3] = R_J_S.T @ R @ R_J_S
        told = _moved(base, config, correction)
        yield from _of_rotation(base, what, tilt, np.hypot(learnt.base_tilt.sigmas, ratio), told)


def _of_zero(name: str, section: JointConfig, off_rad: float, sigma_rad: float) -> Row:
    value, key = section.zero_offset_deg + degrees(off_rad), path_text(("sensors", name, "zero_offset_deg"))
    is_wrong = abs(off_rad) > SIGMA * sigma_rad + SLACK_ZERO_RAD
    write = f"{fmod(value, 360.0):.3f}" if is_wrong else ""
    return Row(name, "zero", key, "deg", section.zero_offset_deg, value, degrees(sigma_rad), is_wrong, write)


def _tilt(learnt: LearntConstant) -> tuple[Array, Array]:
    """Return a tilt (2,) [rad], and as a rotation matrix (3, 3)."""
    return np.array(learnt.mean), gtsam.Rot3.Expmap(np.array([*learnt.mean, 0.0])).matrix()


def _of_arm(name: str, config: Config, shift: Array, sigmas: Array) -> Iterator[Row]:
    """Yield the rows of a lever arm that is shifted (3,) [m] in the frame of the IMU."""
    T_I_P = config.T_I(config.frame_of(name))
    arm, correction = T_I_P[:3, 3] + shift, np.eye(4)
    correction[:3, 3] = T_I_P[:3, :3].T @ shift
    key, write = _moved(name, config, correction)
    for k, axis in enumerate(AXES):
        configured, value, sigma = float(T_I_P[k, 3]), float(arm[k]), float(sigmas[k])
        is_wrong = abs(value - configured) > SIGMA * sigma + SLACK_M
        yield Row(name, f"lever arm, {axis}", key, "m", configured, value, sigma, is_wrong, write if is_wrong else "")


def _of_odometry_arm(
    name: str, config: Config, learnt: LearntConstant, calibration: LearntConstant | None
) -> Iterator[Row]:
    """Yield the rows of the lever arm (3,) [m] of an odometry along its own axes; what is not told stays as it is."""
    are_wrong = [abs(off) > SIGMA * sigma + SLACK_M for off, sigma in zip(learnt.mean, learnt.sigmas, strict=True)]
    arm, turned = np.where(are_wrong, learnt.mean, 0.0), NOMINAL[:3] if calibration is None else calibration.mean[:3]
    key, write = _moved(name, config, mounted(np.concatenate([turned, arm])).matrix(), LAST)
    for axis, off, sigma, is_wrong in zip(AXES, learnt.mean, learnt.sigmas, are_wrong, strict=True):
        yield Row(name, f"lever arm, along its {axis}", key, "m", 0.0, off, sigma, is_wrong, write if is_wrong else "")


def _moved(name: str, config: Config, correction: Array, which: int = FIRST) -> tuple[str, str]:
    """Return a key of the frame of a sensor, the first or the last, and what it is if the frame is moved (4, 4)."""
    changes = moved(config, config.frame_of(name), correction)
    if isinstance(changes, str) or not changes:
        return "extrinsics", "" if not changes else str(changes)
    return path_text(changes[which].path), yaml_text(changes[which].value)


def _unit(section: Any, key: str) -> str:
    extra = type(section).model_fields[key].json_schema_extra
    return str(extra["unit"]) if isinstance(extra, dict) else ""
