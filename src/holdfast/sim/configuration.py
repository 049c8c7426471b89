"""The configuration that a machine's owner would write: what calibration and datasheets know, never the truth."""

from math import degrees, hypot, sqrt
from typing import Any

from holdfast.config.model import Config
from holdfast.sim.datasheets import SimulatedImu, SimulatedJoint, SimulatedSensor
from holdfast.sim.scenario import BASE, CABIN, Scenario


def configuration(scenario: Scenario) -> Config:
    """Return the configuration for recordings of a scenario."""
    sheets = scenario.sensors
    sensors: dict[str, Any] = {"imu": _imu(sheets.imu)}
    if sheets.base_imu is not None:
        sensors["base_imu"] = _imu(sheets.base_imu)
    for name in ("gnss", "gnss_right", "lidar"):
        sheet = getattr(sheets, name)
        if sheet is not None:
            sensors[name] = {**_any(sheet), "frame": sheet.frame}
    if sheets.heading is not None and sheets.gnss is not None and sheets.gnss_right is not None:
        sensors["heading"] = _any(sheets.heading)  # its axis is the baseline between the antennas
    if sheets.joint is not None:
        sensors["joint"] = _joint(sheets.joint)
    turn_joint = None
    mounts = {extrinsic.child: extrinsic.parent for extrinsic in scenario.extrinsics}
    in_cabin = mounts.get(sheets.imu.frame, sheets.imu.frame) == CABIN
    if scenario.turn_joint is not None and sheets.joint is not None and in_cabin:
        turn_joint = {"parent": BASE, "child": CABIN, "translation_m": scenario.turn_joint.position_m}
    return Config.model_validate(
        {
            "sensors": sensors,
            "extrinsics": scenario.extrinsics,
            "turn_joint": turn_joint,
            "frames": {"base": BASE, "datum": scenario.datum},
        }
    )


def configuration_data(scenario: Scenario) -> dict[str, Any]:
    """Return the same as plain data, without what nobody set, so that other defaults can be put below it."""
    return configuration(scenario).model_dump(mode="json", exclude_unset=True)


def _any(sheet: SimulatedSensor) -> dict[str, Any]:
    """Return topic and, where the clock is known to be off, the correction."""
    known = sheet.clock.calibrated and sheet.clock.offset_s != 0.0
    return {"topic": sheet.topic} | ({"time_offset_s": -sheet.clock.offset_s} if known else {})


def _joint(sheet: SimulatedJoint) -> dict[str, Any]:
    """Return what the owner knows of the encoder: its noise and step, how well it was mounted, not its true zero."""
    noise_rad = hypot(sheet.noise_rad, sheet.resolution_rad / sqrt(12.0))
    known = {"noise_deg": degrees(noise_rad), "zero_offset_sigma_deg": degrees(sheet.bias_sigma_rad)}
    given = {key: value for key, value in known.items() if value > 0.0}
    return {**_any(sheet), "joint_name": sheet.joint_name, **given}


def _imu(sheet: SimulatedImu) -> dict[str, Any]:
    names = (
        "accelerometer_noise_density",
        "gyroscope_noise_density",
        "accelerometer_random_walk",
        "gyroscope_random_walk",
        "accelerometer_bias_sigma",
        "gyroscope_bias_sigma",
        "accelerometer_range",
        "gyroscope_range",
    )
    return {**_any(sheet), "frame": sheet.frame, **{name: getattr(sheet, name) for name in names}}
