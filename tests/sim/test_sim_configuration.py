"""The configuration beside a recording knows what calibration and datasheets know, of the chassis as well."""

import numpy as np
import pytest

from holdfast.sim.configuration import configuration
from holdfast.sim.scenario import load_scenario, shipped

CHASSIS_IMU = {"parent": "base_link", "child": "imu", "translation_m": [0.4, 0.2, 0.75]}


def test_a_turn_joint_becomes_a_turn_joint_with_encoder_and_base_imu() -> None:
    scenario = load_scenario("quick")
    config = configuration(scenario)
    assert config.turn_joint is not None
    assert config.turn_joint.translation_m == scenario.turn_joint.position_m
    np.testing.assert_array_equal(config.turn_joint.matrix()[:3, :3], np.eye(3))
    sheet, base_imu = scenario.sensors.base_imu, config.sensors.base_imu
    assert (base_imu.topic, base_imu.frame) == (sheet.topic, sheet.frame)
    assert base_imu.gyroscope_noise_density == sheet.gyroscope_noise_density


def test_the_owner_knows_noise_and_mounting_of_the_encoder_but_not_its_zero() -> None:
    scenario = load_scenario("quick")
    sheet, joint = scenario.sensors.joint, configuration(scenario).sensors.joint
    assert joint.zero_offset_deg == 0.0
    assert np.radians(joint.zero_offset_sigma_deg) == pytest.approx(sheet.bias_sigma_rad)
    assert np.radians(joint.noise_deg) == pytest.approx(np.hypot(sheet.noise_rad, sheet.resolution_rad / 12**0.5))


def test_an_imu_on_the_chassis_needs_no_turn_joint() -> None:
    mounts = [mount.model_dump(exclude_unset=True) for mount in load_scenario("quick").extrinsics]
    mounts = [CHASSIS_IMU if mount["child"] == "imu" else {**mount, "parent": "base_link"} for mount in mounts]
    config = configuration(load_scenario("quick", {"extrinsics": mounts}))
    assert config.turn_joint is None
    assert config.has_base()


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_every_shipped_machine_has_a_chassis(name: str) -> None:
    assert configuration(load_scenario(name)).has_base()
