"""What the baselines take in: messages are checked as the estimator checks them, and become measurements in W."""

from collections import Counter, deque
from typing import NamedTuple

import gtsam

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.geometry.earth import Geodetic, LocalFrame, gravity
from holdfast.messages import Array, GnssFix, Heading, LidarPose
from holdfast.sensors.gnss import AntennaPosition
from holdfast.sensors.heading import AxisYaw
from holdfast.sensors.suite import suite_of
from holdfast.state import Event, EventKind, Outcome

RECENT = 64  # stamps per sensor among which a duplicate is looked for
MAX_AHEAD_NS = 1_000_000_000  # further ahead of its arrival no clock is


class AntennaFix(NamedTuple):
    """A fix in W, of the antenna at `p_I_G` (3,) [m] in the IMU's frame."""

    position: AntennaPosition
    p_I_G: Array


class TrackPose(NamedTuple):
    """A pose of the IMU on the lidar odometry's track: T_I0_I, in the frame V where the IMU was at its start."""

    stamp_ns: int
    T_V_I: gtsam.Pose3


class Measurement(NamedTuple):
    """A checked measurement; sorted by time, and where times are equal by sensor, never by arrival."""

    stamp_ns: int
    sensor: str
    content: AntennaFix | TrackPose


class Intake:
    """Checks messages, converts them, and counts what became of them.

    Raises:
        ConfigError: there is no GNSS, which every baseline needs to know where it starts.
    """

    def __init__(self, config: Config) -> None:
        if not config.sensors.antennas():
            raise ConfigError("sensors.gnss: the baselines need GNSS to know where they start")
        self.counts: Counter[tuple[str, Outcome]] = Counter()
        self.events: list[Event] = []
        self.antennas, self.heading, self.lidar = suite_of(config)
        self.world: LocalFrame | None = None
        self.gravity = 0.0
        self._configured_gravity = config.frames.gravity
        self._recent: dict[str, deque[int]] = {}
        datum = config.frames.datum
        if datum is not None:
            self._set_datum(Geodetic(datum.latitude_deg, datum.longitude_deg, datum.altitude_m))

    def fix(self, message: GnssFix) -> Measurement | None:
        """Return a fix in W, or None with its outcome counted; the first one is the datum if none is configured."""
        model = self.antennas[message.sensor]
        stamp = message.stamp_ns + model.offset_ns
        if not self._passes(message, stamp, model.check(message)):
            return None
        point = Geodetic(message.latitude_deg, message.longitude_deg, message.altitude_m)
        if self.world is None:
            self._set_datum(point)
        assert self.world is not None
        position = AntennaPosition(stamp, message.sensor, self.world.to_enu(point), model.covariance(message))
        return Measurement(stamp, message.sensor, AntennaFix(position, model.p_I_G))

    def track_pose(self, message: LidarPose) -> Measurement | None:
        """Return a pose on the lidar's track, or None with its outcome counted."""
        assert self.lidar is not None
        stamp = message.stamp_ns + self.lidar.offset_ns
        if not self._passes(message, stamp, self.lidar.check(message)):
            return None
        return Measurement(stamp, message.sensor, TrackPose(stamp, self.lidar.T_I0_I(message)))

    def axis_yaw(self, message: Heading) -> AxisYaw | None:
        """Return a heading, or None with its outcome counted."""
        assert self.heading is not None
        stamp = message.stamp_ns + self.heading.offset_ns
        if not self._passes(message, stamp, self.heading.check(message)):
            return None
        return self.heading.measured(message)

    def forget(self) -> None:
        """Forget the stamps that were seen: the clock has gone back."""
        self._recent.clear()

    def tell(self, kind: EventKind, stamp_ns: int, sensor: str, reason: str) -> None:
        """Note an event."""
        self.events.append(Event(stamp_ns, kind, sensor, reason))

    def _passes(self, message: GnssFix | LidarPose | Heading, stamp_ns: int, outcome: Outcome) -> bool:
        recent = self._recent.setdefault(message.sensor, deque(maxlen=RECENT))
        if outcome is Outcome.USED and stamp_ns in recent:
            outcome = Outcome.DUPLICATE
        elif outcome is Outcome.USED and stamp_ns - message.arrival_ns > MAX_AHEAD_NS:
            outcome = Outcome.CLOCK_JUMP
        if outcome is Outcome.USED:
            recent.append(stamp_ns)
            return True
        self.counts[message.sensor, outcome] += 1
        self.tell(EventKind.REJECTED, stamp_ns, message.sensor, outcome)
        return False

    def _set_datum(self, datum: Geodetic) -> None:
        self.world = LocalFrame(datum)
        self.gravity = self._configured_gravity or gravity(datum.latitude_deg, datum.altitude_m)
