"""A sensor that exists only in this file is configured, simulated, recorded, replayed, and fused by both engines.

The sensor is a Doppler radar: it looks along the x axis of its frame and measures the speed over ground in that
direction. A package of yours has everything above the test, and calls `register_radar()` when it is imported.
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np

import holdfast.config.kinds
import holdfast.recording.kinds
import holdfast.sensors.sensor
import holdfast.sim.sensors
from holdfast.config.load import load_config
from holdfast.config.model import Config, register_kind
from holdfast.config.section import Topic, quantity
from holdfast.config.sensors import JudgedConfig, MountedConfig
from holdfast.estimator.estimator import Estimator
from holdfast.events import Outcome
from holdfast.geometry.world import World
from holdfast.messages import Message
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.recording.decode import Decoder, stamp_ns
from holdfast.recording.source import Subscription, open_recording
from holdfast.recording.subscriptions import subscriptions
from holdfast.replay.published import PublishedRecorder
from holdfast.sensors.mount import Mount
from holdfast.sensors.sensor import Innovation, Role, State, StateSensor
from holdfast.sim.datasheets import SimulatedSensor
from holdfast.sim.readings import Readings
from holdfast.sim.ros import Encode, RosMessages
from holdfast.sim.scenario import Scenario, load_scenario
from holdfast.sim.scene import Sampling
from holdfast.sim.sensors import AnySheet, SensorKind
from holdfast.trial.run import CONFIG, RECORDING, write_simulation

# --- 1. the message: what the sensor measures, as a row of numbers ----------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class GroundSpeed:
    """Speed over ground along the x axis of the radar [m/s]."""

    stamp_ns: int
    arrival_ns: int
    sensor: str
    speed_m_s: float
    WIDTH: ClassVar[int] = 1

    def values(self) -> tuple[float, ...]:
        """Return the speed."""
        return (self.speed_m_s,)

    @classmethod
    def of(cls, stamp_ns: int, arrival_ns: int, sensor: str, values: Sequence[float]) -> Self:
        """Return the message that has a row."""
        return cls(stamp_ns, arrival_ns, sensor, values[0])


# --- 2. the section of the configuration, with `kind: radar` ----------------------------------------------------------


class RadarConfig(JudgedConfig, MountedConfig):
    """A Doppler radar that measures the speed over ground along the x axis of its frame."""

    kind: Literal["radar"]
    topic: Topic
    sigma_m_s: float = quantity("m/s", 0.05, gt=0, le=10, doc="noise of a measurement")


# --- 3. the model: from a message to a measurement, and how that compares with a state --------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpeed:
    """A checked speed, time offset applied."""

    stamp_ns: int
    sensor: str
    speed_m_s: float


class RadarModel(StateSensor):
    """z = e_x . v_S, with the velocity v_S of the radar in its own axes."""

    role: ClassVar[Role] = Role.STATE
    message: ClassVar[type[Message] | None] = GroundSpeed

    def __init__(self, name: str, config: RadarConfig, mount: Mount) -> None:
        self.name = name
        self.offset_ns = round(config.time_offset_s * 1e9)
        self.settings = config
        self._mount = mount
        self._R = np.array([[config.sigma_m_s**2]])

    def convert(self, message: GroundSpeed, world: World) -> MeasuredSpeed | Outcome:  # noqa: ARG002 (it needs no W)
        """Return the speed, or what is wrong with it."""
        if not np.isfinite(message.speed_m_s):
            return Outcome.NOT_FINITE
        return MeasuredSpeed(message.stamp_ns + self.offset_ns, self.name, message.speed_m_s)

    def innovation(self, measured: MeasuredSpeed, state: State) -> Innovation | Outcome:
        """Compare with a state: y = z - h(x), and H = dh/dx."""
        velocity, H = self._mount.velocity(state)
        return Innovation(np.array([measured.speed_m_s - velocity[0]]), H[:1], self._R, np.zeros((1, 0)))


def make_radar(name: str, section: RadarConfig, config: Config) -> RadarModel:
    """Return the model of a sensor of the configuration."""
    return RadarModel(name, section, Mount(config, config.frame_of(name)))


# --- 4. recordings and live topics: the ROS messages that hold it -----------------------------------------------------


def radar_decoder(subscription: Subscription) -> Decoder:
    """Decode geometry_msgs/Vector3Stamped, whose x is the speed."""
    return lambda ros, arrival_ns: GroundSpeed(stamp_ns(ros), arrival_ns, subscription.sensor, ros.vector.x)


VECTOR = "geometry_msgs/msg/Vector3Stamped"
RADAR_MESSAGES = holdfast.recording.kinds.Kind("radar", GroundSpeed, {VECTOR: radar_decoder})


# --- 5. the simulation: its datasheet, and what it measures -----------------------------------------------------------


class SimulatedRadar(SimulatedSensor):
    """A Doppler radar."""

    kind: Literal["radar"]
    noise_m_s: float = quantity("m/s", 0.03, ge=0, doc="sigma of a measurement")


def simulate_radar(at: Sampling) -> Readings:
    """Return the column `speed_m_s` (N,)."""
    speed = np.einsum("nij,ni->nj", at.moving.R_W_F, at.moving.v_W)[:, 0]
    return Readings(at.times_s, {"speed_m_s": speed + at.sheet.noise_m_s * at.rng.standard_normal(len(speed))})


def encode_radar(ros: RosMessages, sheet: SimulatedSensor, readings: Readings) -> Encode:
    """Return what makes the message of a row and a stamp."""
    speeds = readings.values["speed_m_s"].tolist()
    return lambda row, stamp_ns: ros.make(
        VECTOR, header=ros.header(stamp_ns, sheet.frame), vector=ros.vector((speeds[row], 0.0, 0.0))
    )


def known_of_radar(sheet: SimulatedRadar) -> dict[str, Any]:
    """Return what the owner writes into the configuration."""
    return {"sigma_m_s": sheet.noise_m_s}


# --- 6. registration --------------------------------------------------------------------------------------------------


def register_radar() -> None:
    """Let configurations, recordings, scenarios and both engines know the kind."""
    register_kind(RadarConfig)
    holdfast.sensors.sensor.register(RadarConfig, make_radar)
    holdfast.recording.kinds.register(RADAR_MESSAGES)
    holdfast.sim.sensors.register(SensorKind(SimulatedRadar, simulate_radar, VECTOR, encode_radar, known_of_radar))


if "pytest" not in sys.modules:  # the optimiser's process, which imports this file to read the configuration
    register_radar()


# --- the test ---------------------------------------------------------------------------------------------------------


@contextmanager
def registered() -> Iterator[None]:
    """Register the kind, and take it away again: other tests list the kinds that Holdfast comes with."""
    register_radar()
    try:
        yield
    finally:
        del holdfast.sensors.sensor.MAKERS[RadarConfig]
        rows = holdfast.config.kinds.KINDS, holdfast.recording.kinds.KINDS, holdfast.sim.sensors.KINDS, AnySheet.kinds
        for kinds in rows:
            del kinds["radar"]
        for model in (Config, Scenario):
            model.model_rebuild(force=True)


RADAR = {"kind": "radar", "topic": "/radar", "frame": "lidar", "rate_hz": 10, "clock": {"offset_s": 0.02}}
SECONDS = 10.0


def test_a_sensor_defined_in_this_file_runs_in_both_engines(tmp_path: Path):
    with registered():
        write_simulation(load_scenario("quick", {"duration_s": SECONDS, "sensors": {"doppler": RADAR}}), 1, tmp_path)
        config = load_config(tmp_path / CONFIG)
        section = config.sensors["doppler"]
        assert isinstance(section, RadarConfig)
        assert (section.sigma_m_s, section.time_offset_s) == (0.03, -0.02)

        with open_recording(tmp_path / RECORDING) as recording:
            messages = list(recording.read(subscriptions(config)))
        assert sum(isinstance(message, GroundSpeed) for message in messages) == SECONDS * 10

        replayed = PublishedRecorder(config, Estimator(config))
        replayed.run(messages)
        with RealtimeEstimator(config, in_step=True) as engine:
            realtime = PublishedRecorder(config, engine)
            realtime.run(messages)

    # it starts after a second; the last measurements wait for the IMU
    assert replayed.outcomes()["doppler"]["used"] >= SECONDS * 10 - 20
    assert set(replayed.outcomes()["doppler"]) <= {"used", "before_start", "unreached"}
    assert not [event for event in replayed.events if event.sensor == "doppler"]
    assert realtime.outcomes() == replayed.outcomes()
    ours, others = replayed.published().world, realtime.published().world
    np.testing.assert_array_equal(ours.poses.positions, others.poses.positions)
    np.testing.assert_array_equal(ours.velocities, others.velocities)
    assert len(ours.velocities) > 800


def test_the_radar_of_this_file_is_lost_by_name_where_it_is_wrong(tmp_path: Path):
    """From 5 s on it measures half a metre per second too much; what is published hardly changes."""
    with registered():
        write_simulation(load_scenario("quick", {"duration_s": SECONDS, "sensors": {"doppler": RADAR}}), 1, tmp_path)
        config = load_config(tmp_path / CONFIG)
        with open_recording(tmp_path / RECORDING) as recording:
            messages = list(recording.read(subscriptions(config)))
        first_ns = messages[0].arrival_ns
        faulty = [
            GroundSpeed.of(m.stamp_ns, m.arrival_ns, m.sensor, [m.speed_m_s + 0.5])
            if isinstance(m, GroundSpeed) and m.arrival_ns - first_ns > 5e9
            else m
            for m in messages
        ]
        right, wrong = PublishedRecorder(config), PublishedRecorder(config)
        right.run(messages)
        wrong.run(faulty)
    lost = [(event.kind, event.sensor) for event in wrong.events if event.kind == "sensor_lost"]
    assert lost == [("sensor_lost", "doppler")]
    apart_m = right.published().world.poses.positions - wrong.published().world.poses.positions
    assert np.linalg.norm(apart_m, axis=1).max() < 0.02
