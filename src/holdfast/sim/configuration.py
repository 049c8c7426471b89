"""The configuration that a machine's owner would write: what calibration and datasheets know, never the truth."""

from typing import Any

from holdfast.config.model import Config
from holdfast.sim.datasheets import SimulatedImu, SimulatedSensor
from holdfast.sim.scenario import BASE, Scenario


def configuration(scenario: Scenario) -> Config:
    """Return the configuration for recordings of a scenario."""
    sheets = scenario.sensors
    sensors: dict[str, Any] = {"imu": _imu(sheets.imu)}
    for name in ("gnss", "gnss_right", "lidar"):
        sheet = getattr(sheets, name)
        if sheet is not None:
            sensors[name] = {**_any(sheet), "frame": sheet.frame}
    if sheets.heading is not None:
        sensors["heading"] = _any(sheets.heading)  # its axis is the baseline between the antennas
    if sheets.joint is not None:
        sensors["joint"] = {**_any(sheets.joint), "joint_name": sheets.joint.joint_name}
    return Config.model_validate(
        {
            "sensors": sensors,
            "extrinsics": scenario.extrinsics,
            "frames": {"base": BASE, "datum": scenario.datum},
        }
    )


def _any(sheet: SimulatedSensor) -> dict[str, Any]:
    """Return topic and, where the clock is known to be off, the correction."""
    known = sheet.clock.calibrated and sheet.clock.offset_s != 0.0
    return {"topic": sheet.topic} | ({"time_offset_s": -sheet.clock.offset_s} if known else {})


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
