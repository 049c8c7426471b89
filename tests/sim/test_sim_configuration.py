"""The configuration beside a recording knows what calibration and datasheets know, of the chassis as well."""

import numpy as np
import pytest

from holdfast.errors import ConfigError
from holdfast.sim.configuration import configuration
from holdfast.sim.motion import Motion
from holdfast.sim.scenario import Scenario, load_scenario, shipped
from holdfast.sim.terrain import Terrain

CHASSIS_IMU = {"parent": "base_link", "child": "imu", "translation_m": [0.4, 0.2, 0.75]}


def test_a_turn_joint_becomes_a_turn_joint_with_encoder_and_base_imu() -> None:
    scenario = load_scenario("quick")
    config = configuration(scenario)
    assert config.turn_joint is not None
    assert config.turn_joint.translation_m == scenario.turn_joint.position_m
    np.testing.assert_array_equal(config.turn_joint.matrix()[:3, :3], np.eye(3))
    sheet, base_imu = scenario.sensors["base_imu"], config.sensors["base_imu"]
    assert (base_imu.topic, base_imu.frame) == (sheet.topic, sheet.frame)
    assert base_imu.gyroscope_noise_density == sheet.gyroscope_noise_density


def test_the_owner_knows_noise_and_mounting_of_the_encoder_but_not_its_zero() -> None:
    scenario = load_scenario("quick")
    sheet, joint = scenario.sensors["joint"], configuration(scenario).sensors["joint"]
    assert joint.zero_offset_deg == 0.0
    assert np.radians(joint.zero_offset_sigma_deg) == pytest.approx(sheet.bias_sigma_rad)
    assert np.radians(joint.noise_deg) == pytest.approx(np.hypot(sheet.noise_rad, sheet.resolution_rad / 12**0.5))


def test_an_imu_on_the_chassis_needs_no_turn_joint() -> None:
    mounts = [mount.model_dump(exclude_unset=True) for mount in load_scenario("quick").extrinsics]
    mounts = [CHASSIS_IMU if mount["child"] == "imu" else {**mount, "parent": "base_link"} for mount in mounts]
    config = configuration(load_scenario("quick", {"extrinsics": mounts}))
    assert config.turn_joint is None
    assert config.has_base()


def test_sensors_stand_in_the_order_of_the_datasheets_with_their_kinds_and_the_scanner_has_none() -> None:
    scenario = load_scenario("new-sensors")
    written = {name: sensor.kind for name, sensor in configuration(scenario).sensors.items()}
    assert list(written.items()) == [
        (n, sheet.kind) for n, sheet in scenario.sensors.items() if sheet.kind != "scanner"
    ]


def test_the_owner_knows_the_datasheets_of_the_new_sensors_but_neither_scale_nor_offset() -> None:
    off = {"offset_m": [3.0, 4.0, 0.0], "offset_yaw_deg": -5.0}
    scenario = load_scenario("new-sensors")
    data = scenario.model_dump()
    data["sensors"]["markers"] |= off
    sensors = configuration(Scenario.model_validate(data)).sensors
    wheels, doppler, markers, mast = (sensors[name] for name in ("wheels", "doppler", "markers", "mast"))
    assert (wheels.axes, wheels.slip_ratio, wheels.scale_sigma) == (("x",), 0.01, 0.02)
    assert wheels.sigma_m_s == pytest.approx(0.01, rel=0.01)
    assert (doppler.sigma_m_s, doppler.correlation_s) == pytest.approx((np.hypot(0.035, 0.035), 1.0))
    assert (markers.offset_sigma_m, markers.offset_sigma_deg) == (5.0, 5.0)
    assert markers.position_sigma_m == pytest.approx(np.hypot(0.02, 0.02))
    assert markers.correlation_s == pytest.approx(10.0)  # half of the variance, over both sides of 10 s
    assert mast.sigma_m == pytest.approx(np.hypot(5e-3, 3e-3))
    assert mast.offset_sigma_m == 0.0


def test_the_owner_knows_the_grid_and_the_latency_of_the_station() -> None:
    scenario = load_scenario("prism")
    prism, sheet = configuration(scenario).sensors["prism"], scenario.sensors["prism"]
    assert (prism.grid_position_m, prism.grid_yaw_deg) == (sheet.grid_position_m, sheet.grid_yaw_deg)
    assert (prism.latency_s, prism.sigma_m) == (sheet.latency_s, sheet.range_noise_m)


def test_without_a_source_of_heading_the_owner_writes_one_that_errs_by_its_sigma() -> None:
    scenario = load_scenario("prism")
    R_W_I = Motion(scenario, Terrain(scenario.ground, scenario.objects), 1).frame("imu", np.zeros(1)).R_W_F[0]
    true_deg = np.degrees(np.arctan2(R_W_I[1, 0], R_W_I[0, 0]))
    initial = [configuration(scenario, seed).initialisation for seed in range(60)]
    errors_deg = [one.heading_deg - true_deg for one in initial]
    assert np.std(errors_deg) == pytest.approx(initial[0].heading_sigma_deg, rel=0.25)
    assert abs(np.mean(errors_deg)) < 0.8
    assert configuration(load_scenario("quick")).initialisation.heading_deg is None


def test_the_first_of_two_imus_is_the_primary_one() -> None:
    spare = {"spare": {"kind": "imu", "topic": "/spare", "frame": "lidar", "rate_hz": 50}}
    config = configuration(load_scenario("quick", {"sensors": spare}))
    assert (config.imu_name, config.sensors["spare"].primary) == ("imu", False)


def test_sensors_that_make_no_configuration_are_refused_in_plain_words() -> None:
    wheels = {"joint": None, "wheels": {"kind": "twist", "topic": "/t", "frame": "base_link", "rate_hz": 20}}
    with pytest.raises(ConfigError, match=r"sensors.wheels.frame: no transforms lead from 'imu' to 'base_link'"):
        configuration(load_scenario("quick", {"sensors": wheels}))


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_every_shipped_machine_has_a_chassis(name: str) -> None:
    assert configuration(load_scenario(name)).has_base()


def test_an_owner_may_be_mistaken_about_the_zero_of_the_encoder_and_about_nothing_else():
    right, wrong = (configuration(load_scenario(name)).model_dump() for name in ("rounds", "wrong-encoder"))
    assert wrong["sensors"]["joint"].pop("zero_offset_deg") == 2.0
    assert right["sensors"]["joint"].pop("zero_offset_deg") == 0.0
    assert wrong == right
    # what the datasheet says of the axes of the base IMU, 0.5 mrad, is all that looks like a zero
    assert right["sensors"]["base_imu"]["mounting_sigma_deg"] == pytest.approx(np.degrees(5e-4))


def test_an_owner_may_be_mistaken_about_a_mounting_and_about_nothing_else():
    right, wrong = configuration(load_scenario("rounds")), configuration(load_scenario("wrong-mount"))
    turned = np.linalg.inv(right.T_I("lidar")) @ wrong.T_I("lidar")
    assert np.degrees(np.arccos((np.trace(turned[:3, :3]) - 1.0) / 2.0)) == pytest.approx(2.7, abs=0.1)
    np.testing.assert_allclose(turned[:3, 3], 0.0, atol=1e-12)
    np.testing.assert_array_equal(right.T_I("gnss_left"), wrong.T_I("gnss_left"))
