"""What the baselines take in: messages are checked as the estimator checks them, and become measurements in W."""

from collections import Counter
from copy import copy
from typing import Any, NamedTuple, cast

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.events import Event, EventKind, Outcome
from holdfast.geometry.world import World
from holdfast.messages import Array, Message
from holdfast.sensors.heading import AxisYaw, HeadingModel
from holdfast.sensors.odometry import OdometryModel, TrackPose
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position, PositionSensor, Role, Sensor
from holdfast.sensors.stamp_filter import StampFilter


class PositionFix(NamedTuple):
    """A position in W, of the antenna or prism at `p_I_P` (3,) [m] in the IMU's frame."""

    position: Position
    p_I_P: Array


class Measurement(NamedTuple):
    """A checked measurement; sorted by time, and where times are equal by sensor, never by arrival."""

    stamp_ns: int
    sensor: str
    content: PositionFix | TrackPose


class Intake:
    """Checks messages, converts them, and counts their outcomes: of all positions, one odometry and one heading.

    Raises:
        ConfigError: no sensor measures a position, which every baseline needs to know where it starts.
    """

    def __init__(self, config: Config) -> None:
        sensors = sensors_of(config)
        self.positions = {
            name: cast("PositionSensor", sensor) for name, sensor in sensors.items() if sensor.role is Role.POSITION
        }
        self.odometry = next((one for one in sensors.values() if isinstance(one, OdometryModel)), None)
        self.heading = next((one for one in sensors.values() if isinstance(one, HeadingModel)), None)
        if not self.positions:
            raise ConfigError("sensors: none measures a position (gnss, prism), by which the baselines start")
        self.counts: Counter[tuple[str, Outcome]] = Counter()
        self.events: list[Event] = []
        self.world = World()
        self._gravity = config.frames.gravity
        self._stamps = StampFilter()
        if config.frames.datum is not None:
            self.world.place(config.frames.datum.point)

    @property
    def gravity(self) -> float:
        """The configured gravity, or else that of the datum [m/s^2]."""
        return self._gravity or self.world.gravity

    def position(self, message: Message) -> Measurement | None:
        """Return a position in W, or None with its outcome counted; a first fix is the datum if none is configured."""
        sensor = self.positions[message.sensor]
        position: Position | None = self._convert(sensor, message)
        self.world.settle()
        if position is None:
            return None
        return Measurement(position.stamp_ns, position.sensor, PositionFix(position, sensor.p_I_P))

    def track_pose(self, message: Message) -> Measurement | None:
        """Return a pose on the odometry's track, or None with its outcome counted."""
        pose: TrackPose | None = None if self.odometry is None else self._convert(self.odometry, message)
        return None if pose is None else Measurement(pose.stamp_ns, pose.sensor, pose)

    def axis_yaw(self, message: Message) -> AxisYaw | None:
        """Return a heading, or None with its outcome counted."""
        yaw: AxisYaw | None = None if self.heading is None else self._convert(self.heading, message)
        return yaw

    def ignore(self, message: Message) -> None:
        """Count a message that is not used."""
        self.counts[message.sensor, Outcome.IGNORED] += 1

    def forget_stamps(self) -> None:
        """Take the stamps that come for new ones: the clock has gone back."""
        self._stamps = StampFilter()

    def report(self, kind: EventKind, stamp_ns: int, sensor: str, reason: str) -> None:
        """Note an event."""
        self.events.append(Event(stamp_ns, kind, sensor, reason))

    def _convert(self, sensor: Sensor, message: Message) -> Any:
        in_world = copy(self.world)
        measured = sensor.convert(message, in_world)
        stamp_ns, arrival_ns = message.stamp_ns + sensor.offset_ns, message.arrival_ns
        outcome = measured if isinstance(measured, Outcome) else Outcome.USED
        if outcome is Outcome.USED:
            # the clock is checked against the arrival: what becomes of the IMU is up to each system
            outcome = self._stamps.check(sensor.name, stamp_ns, arrival_ns, arrival_ns, arrival_ns)
        if outcome is Outcome.USED:
            self.world = in_world
            return measured
        self.counts[message.sensor, outcome] += 1
        self.report(EventKind.REJECTED, stamp_ns, message.sensor, outcome)
        return None
