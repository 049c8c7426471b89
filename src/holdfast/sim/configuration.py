"""The configuration that a machine's owner would write: what calibration and datasheets know, never the truth.

Where the scenario says so, the owner is mistaken.
"""

from math import atan2, degrees
from typing import Any

from holdfast.config.kinds import KINDS as CONFIGURED
from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.sim.datasheets import Sheet, SimulatedSensor
from holdfast.sim.readings import generator
from holdfast.sim.scenario import BASE, CABIN, Scenario, merged
from holdfast.sim.sensors import KINDS
from holdfast.sim.sensors.imu import SimulatedImu
from holdfast.sim.sensors.joint import SimulatedJoint

HEADING_SIGMA_DEG = 2.0  # of an owner who reads the heading from a site plan


def configuration(scenario: Scenario, seed: int = 0) -> Config:
    """Return the configuration for recordings of a scenario.

    Args:
        scenario: whose machine it is.
        seed: of the error of the initial heading, which is only there where no sensor gives one.

    Raises:
        ConfigError: the sensors of the scenario do not make a configuration, such as one beyond an unknown joint.
    """
    return config_of(configuration_data(scenario, seed), "configuration of the scenario")


def configuration_data(scenario: Scenario, seed: int = 0) -> dict[str, Any]:
    """Return the same as plain data, without what nobody set, so that other defaults can be put below it."""
    sensors = {
        name: _entry(name, sheet, scenario) for name, sheet in scenario.sensors.items() if sheet.kind in CONFIGURED
    }
    data: dict[str, Any] = {
        "sensors": sensors,
        "extrinsics": [extrinsic.model_dump(mode="json", exclude_unset=True) for extrinsic in scenario.extrinsics],
        "frames": {"base": BASE, "datum": scenario.datum.model_dump()},
    }
    if scenario.turn_joint is not None and scenario.sensors_of(SimulatedJoint) and _imu_parent(scenario) == CABIN:
        position_m = list(scenario.turn_joint.position_m)
        data["turn_joint"] = {"parent": BASE, "child": CABIN, "translation_m": position_m}
    if not any(KINDS[sheet.kind].gives_heading for sheet in scenario.sensors.values()):
        error_deg = HEADING_SIGMA_DEG * float(generator(seed, "initial heading").standard_normal())
        heading_deg = round(_true_heading_deg(scenario) + error_deg, 2)
        data["initialisation"] = {"heading_deg": heading_deg, "heading_sigma_deg": HEADING_SIGMA_DEG}
    written: dict[str, Any] = merged(data, scenario.written)
    return written


def _entry(name: str, sheet: Sheet, scenario: Scenario) -> dict[str, Any]:
    """Return the section of a sensor: with its topic and, where the clock is known to be off, the correction."""
    entry: dict[str, Any] = {"kind": sheet.kind}
    if isinstance(sheet, SimulatedSensor):
        entry["topic"] = sheet.topic
        if sheet.clock.calibrated and sheet.clock.offset_s != 0.0:
            entry["time_offset_s"] = -sheet.clock.offset_s
    if "frame" in CONFIGURED[sheet.kind].model_fields:
        entry["frame"] = sheet.frame
    if name == scenario.imu_name and len(scenario.sensors_of(SimulatedImu)) > 1:
        entry["primary"] = True
    return entry | KINDS[sheet.kind].entry(sheet)


def _imu_parent(scenario: Scenario) -> str:
    mounts = {extrinsic.child: extrinsic.parent for extrinsic in scenario.extrinsics}
    return mounts.get(scenario.imu.frame, scenario.imu.frame)


def _true_heading_deg(scenario: Scenario) -> float:
    """Return the yaw of the IMU's x axis at the start, on level ground."""
    mounts = {extrinsic.child: extrinsic.matrix() for extrinsic in scenario.extrinsics}
    x_axis = mounts[scenario.imu.frame][:3, 0] if scenario.imu.frame in mounts else (1.0, 0.0, 0.0)
    return scenario.start.heading_deg + scenario.start.cabin_deg + degrees(atan2(x_axis[1], x_axis[0]))
