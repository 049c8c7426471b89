"""Every kind of sensor has one row; one that is defined in this file is simulated, struck, written and configured."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from holdfast.config import kinds as configured
from holdfast.config.load import parse_config, resolved_yaml
from holdfast.config.model import Config, register_kind
from holdfast.config.section import Topic, quantity
from holdfast.config.sensors import MountedConfig
from holdfast.errors import ConfigError
from holdfast.sim.configuration import configuration
from holdfast.sim.datasheets import Sheet, SimulatedSensor
from holdfast.sim.effects import freezing
from holdfast.sim.faults import affected_kinds
from holdfast.sim.readings import Readings
from holdfast.sim.recorder import write_recording, write_truth
from holdfast.sim.ros import Encode, RosMessages
from holdfast.sim.scenario import Scenario, load_scenario
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import KINDS, AnySheet, SensorKind, register
from holdfast.sim.simulation import simulate


class SimulatedClinometer(SimulatedSensor):
    """A level: how steep its frame's x axis points upwards."""

    kind: Literal["clinometer"]
    noise_rad: float = quantity("rad", 1e-3, ge=0, doc="sigma")


class ClinometerConfig(MountedConfig):
    """A level."""

    kind: Literal["clinometer"]
    topic: Topic
    sigma_rad: float = quantity("rad", gt=0, doc="sigma")


def measure(at: Sampling) -> Readings:
    """Return the column `steepness_rad` (N,)."""
    noise = at.sheet.noise_rad * at.rng.standard_normal(len(at.times_s))
    return Readings(at.times_s, {"steepness_rad": np.arcsin(at.moving.R_W_F[:, 2, 0]) + noise}, {"noise": 1.0})


def encode(ros: RosMessages, sheet: SimulatedSensor, readings: Readings) -> Encode:
    """Return what makes a sensor_msgs/Range."""
    angles = readings.values["steepness_rad"].astype(np.float32)
    return lambda row, stamp_ns: ros.make(
        "sensor_msgs/msg/Range",
        header=ros.header(stamp_ns, sheet.frame),
        radiation_type=0,
        field_of_view=0.0,
        min_range=-2.0,
        max_range=2.0,
        range=angles[row],
    )


def entry(sheet: SimulatedClinometer) -> dict[str, Any]:
    """Return what the owner knows."""
    return {"sigma_rad": sheet.noise_rad}


def mistakes(name: str, sheet: SimulatedClinometer, _sheets: Mapping[str, Sheet]) -> Iterator[str]:
    """Yield what no clinometer can be."""
    if sheet.frame == "imu":
        yield f"sensors.{name}.frame: there is no room in the imu"


@pytest.fixture
def clinometer() -> Iterator[dict[str, Any]]:
    """Register the kind, and take it away again."""
    register_kind(ClinometerConfig)
    faults = {"freeze": freezing("steepness_rad")}
    register(
        SensorKind(SimulatedClinometer, measure, "sensor_msgs/msg/Range", encode, entry, faults, mistakes=mistakes)
    )
    yield {"kind": "clinometer", "topic": "/level", "frame": "lidar", "rate_hz": 10, "clock": {"offset_s": 0.02}}
    for registry in (KINDS, AnySheet.kinds, configured.KINDS):
        del registry["clinometer"]
    for model in (Config, Scenario):
        model.model_rebuild(force=True)


def test_a_sensor_defined_in_this_file_is_simulated_written_and_configured(tmp_path: Path, clinometer: dict[str, Any]):
    silence = {"kind": "silence", "sensors": ["level"], "start_s": 4.0, "end_s": 6.0}
    scenario = load_scenario("quick", {"duration_s": 10, "sensors": {"level": clinometer}, "faults": [silence]})
    simulation = simulate(scenario, 1)
    delivered = simulation.delivered["level"].readings
    steepness_rad = np.arcsin(simulation.motion.frame("lidar", delivered.times_s).R_W_F[:, 2, 0])
    np.testing.assert_allclose(delivered.values["steepness_rad"], steepness_rad, atol=5e-3)
    assert not ((delivered.times_s > 4.0) & (delivered.times_s < 6.0)).any()

    counts = write_recording(simulation, tmp_path / "recording.mcap", False, None)
    with AnyReader([tmp_path / "recording.mcap"]) as bag:
        ranges = [bag.deserialize(raw, c.msgtype).range for c, _, raw in bag.messages() if c.topic == "/level"]
    assert len(ranges) == counts["/level"] == len(delivered.times_s)
    np.testing.assert_allclose(sorted(ranges), sorted(delivered.values["steepness_rad"]), atol=1e-6)

    write_truth(simulation, tmp_path / "truth")
    assert "level,noise,1" in (tmp_path / "truth/constants.csv").read_text().splitlines()

    config = parse_config(resolved_yaml(configuration(scenario), given_only=True))
    level = config.sensors["level"]
    assert isinstance(level, ClinometerConfig)
    assert (level.topic, level.frame, level.sigma_rad, level.time_offset_s) == ("/level", "lidar", 1e-3, -0.02)


def test_a_sensor_defined_in_this_file_suffers_its_own_faults_and_no_other(clinometer: dict[str, Any]):
    def scenario(kind: str) -> Scenario:
        fault = {"kind": kind, "sensors": ["level"], "start_s": 4.0, "end_s": 6.0}
        return load_scenario("quick", {"duration_s": 10, "sensors": {"level": clinometer}, "faults": [fault]})

    level = simulate(scenario("freeze"), 1).delivered["level"].readings
    frozen = (level.times_s >= 4.0) & (level.times_s <= 6.0)
    assert len(np.unique(level.values["steepness_rad"][frozen])) == 1 < len(np.unique(level.values["steepness_rad"]))
    assert "clinometer" in affected_kinds("freeze")
    with pytest.raises(ConfigError, match=r"slip of entry 1 cannot happen to level \(kinds: twist\)"):
        scenario("slip")


def test_a_sensor_defined_in_this_file_finds_its_own_mistakes(clinometer: dict[str, Any]):
    with pytest.raises(ConfigError, match=r"sensors.level.frame: there is no room in the imu"):
        load_scenario("quick", {"sensors": {"level": clinometer | {"frame": "imu"}}})


def test_a_kind_that_nobody_registered_is_refused():
    with pytest.raises(Exception, match="must be one of gnss, gnss_velocity, heading"):
        load_scenario("quick", {"sensors": {"level": {"kind": "clinometer"}}})


def test_every_kind_of_datasheet_has_a_row_and_all_but_a_scanner_can_be_configured():
    assert KINDS.keys() == AnySheet.kinds.keys()
    assert KINDS.keys() - configured.KINDS.keys() == {"scanner"}
    for kind, row in KINDS.items():
        assert (row.encode is not None) == bool(row.message_type), kind


def test_the_messages_of_the_new_kinds_are_standard_ones(tmp_path: Path):
    simulation = simulate(load_scenario("new-sensors", {"duration_s": 15, "faults": []}), 1)
    write_recording(simulation, tmp_path / "recording.mcap", False, None)
    topics = {
        simulation.scenario.sensors[name].topic: name for name in ("wheels", "doppler", "markers", "prism", "mast")
    }
    messages: dict[str, list[Any]] = {name: [] for name in topics.values()}
    with AnyReader([tmp_path / "recording.mcap"]) as bag:
        types = {topics[c.topic]: c.msgtype for c in bag.connections if c.topic in topics}
        for connection, _, raw in bag.messages():
            if connection.topic in topics:
                messages[topics[connection.topic]].append(bag.deserialize(raw, connection.msgtype))
    assert types == {
        "wheels": "geometry_msgs/msg/TwistWithCovarianceStamped",
        "doppler": "geometry_msgs/msg/TwistWithCovarianceStamped",
        "markers": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "prism": "geometry_msgs/msg/PointStamped",
        "mast": "geometry_msgs/msg/PointStamped",
    }
    readings = {name: simulation.delivered[name].readings.values for name in messages}
    for name, found in messages.items():
        found.sort(key=lambda message: (message.header.stamp.sec, message.header.stamp.nanosec))
        assert len(found) == len(simulation.delivered[name].stamps_ns)
    wheels, marker = messages["wheels"][-1].twist, messages["markers"][50].pose
    assert wheels.twist.linear.x == readings["wheels"]["linear"][-1, 0] > 0.1
    assert wheels.twist.angular.z == readings["wheels"]["angular"][-1, 2]
    np.testing.assert_array_equal(wheels.covariance.reshape(6, 6), np.diag(readings["wheels"]["covariance"][-1]))
    doppler = messages["doppler"][-1].twist
    assert doppler.twist.linear.y == readings["doppler"]["velocity"][-1, 1] != 0.0
    claimed = np.diag([*readings["doppler"]["sigma"][-1] ** 2, -1.0, -1.0, -1.0])
    np.testing.assert_array_equal(doppler.covariance.reshape(6, 6), claimed)
    assert marker.pose.position.y == readings["markers"]["position"][50, 1]
    assert marker.pose.orientation.z == readings["markers"]["quaternion"][50, 2]
    np.testing.assert_array_equal(marker.covariance.reshape(6, 6), np.diag(readings["markers"]["covariance"][50]))
    assert messages["prism"][100].point.x == pytest.approx(readings["prism"]["position"][100, 0], abs=1e-9)
    assert messages["mast"][100].point.z == readings["mast"]["height_m"][100]
