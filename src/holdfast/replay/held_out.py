"""Positions that are held back from the estimator, to judge it without a ground truth.

What is held back never reaches the estimator. Each held-out position, of an antenna or a prism, is compared with the
track at its own time, through the lever arm; the causal track is what was published at IMU rate, and where the IMU was
silent the newest optimised states. Clock and lever arm are those that the estimator has found from what it was given:
a track that is right at the stamps of the IMU is not wrong because the receiver's are late, nor because they jitter.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol, cast

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.event_log import EventLog
from holdfast.events import Outcome
from holdfast.geometry.earth import LocalFrame
from holdfast.geometry.world import World
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot
from holdfast.messages import Array, Message
from holdfast.sensors.clock import has_estimated_clock, measured_later, with_estimated_clock
from holdfast.sensors.even_stamps import EvenStamps
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position, PositionSensor, Role, State
from holdfast.smoothing.block import Block
from holdfast.state import Estimate, OptimisedState

MAX_DELAY_NS = 20_000_000_000  # positions that arrive later than this are not judged
UNKNOWN = np.full((9, 9), np.nan)


@dataclass(frozen=True, slots=True)
class HoldOut:
    """What to hold back: every n-th usable message of a sensor, or all of them in [start, end) of the recording.

    `given` is the option or the argument that asked for it, for errors.
    """

    sensor: str
    every: int | None = None
    start_s: float = 0.0
    end_s: float = 0.0
    given: str = field(default="hold-out", compare=False)

    @classmethod
    def parse_every(cls, text: str) -> "HoldOut":
        """Parse `gnss=2`.

        Raises:
            ConfigError: the text has another form.
        """
        sensor, _, every = text.partition("=")
        if not sensor or not every.isdecimal() or int(every) < 2:
            raise ConfigError(f"--hold-out {text}: must be SENSOR=N with N >= 2, such as gnss=2")
        return cls(sensor, int(every), given=f"--hold-out {text}")

    @classmethod
    def parse_outage(cls, text: str) -> "HoldOut":
        """Parse `gnss=120:180`, seconds since the first message.

        Raises:
            ConfigError: the text has another form.
        """
        try:
            sensor, span = text.split("=")
            start, end = (float(part) for part in span.split(":"))
        except ValueError:
            raise ConfigError(f"--outage {text}: must be SENSOR=START:END in seconds, such as gnss=120:180") from None
        if not 0.0 <= start < end:
            raise ConfigError(f"--outage {text}: must start at 0 s or later, and end after it starts")
        return cls(sensor, None, start, end, f"--outage {text}")

    def told(self) -> str:
        """Return which messages are held back, in words."""
        if self.every is not None:
            return f"by every {self.every}: there are fewer usable messages"
        return f"from {self.start_s:g} to {self.end_s:g} s: there is no usable message then"


def check_sensors(rules: Iterable[HoldOut], config: Config) -> None:
    """Refuse rules for sensors that the configuration has not, and two that hold back every n-th message of one.

    Every n-th is held back to judge by it: of a sensor of positions.

    Raises:
        ConfigError: names the option, the sensor and those that are allowed.
    """
    parted: set[str] = set()
    judges = list(_position_sensors(config))
    for rule in rules:
        if rule.sensor not in config.sensors:
            allowed = ", ".join(config.sensors)
            raise ConfigError(f"{rule.given}: sensor {rule.sensor!r} is not configured (allowed: {allowed})")
        if rule.every is not None and rule.sensor not in judges:
            reason = f"{rule.sensor} gives no positions, by which an estimate is judged"
            raise ConfigError(f"{rule.given}: {reason} (allowed: {', '.join(judges) or 'none'})")
        if rule.every is not None and rule.sensor in parted:
            raise ConfigError(f"{rule.given}: {rule.sensor} is given twice")
        if rule.every is not None:
            parted.add(rule.sensor)


def _position_sensors(config: Config) -> dict[str, PositionSensor]:
    sensors = sensors_of(config).items()
    return {name: cast("PositionSensor", sensor) for name, sensor in sensors if sensor.role is Role.POSITION}


class HoldOutFilter:
    """Splits a stream of messages into what the estimator receives and what judges it."""

    def __init__(self, rules: Iterable[HoldOut], config: Config) -> None:
        self._rules = list(rules)
        check_sensors(self._rules, config)
        self._sensors = _position_sensors(config)
        self.first_ns: int | None = None
        self._even = EvenStamps(EventLog(config.imu_name))
        self._seen: dict[str, int] = {}
        self._idle = set(self._rules)  # those that have held back nothing yet
        self._lost: set[str] = set()  # sensors in an outage, which lasts until the estimator gets a message again
        self.held: deque[tuple[Message, bool]] = deque()

    def __bool__(self) -> bool:
        """Whether anything is to be held back."""
        return bool(self._rules)

    def split(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield what is not held back; the rest goes to `held`, with whether it is in an outage."""
        for message in messages:
            if self.first_ns is None:
                self.first_ns = message.stamp_ns
            if not self._rules:
                yield message
                continue
            even = self._even.read(message)  # what jitters in a stamp is no error of the estimate
            at_s = (message.stamp_ns - self.first_ns) * 1e-9
            rules = [rule for rule in self._rules if rule.sensor == message.sensor and self.is_usable(message)]
            outages = [rule for rule in rules if rule.every is None and rule.start_s <= at_s < rule.end_s]
            if outages:
                self._idle.difference_update(outages)
                self._lost.add(message.sensor)
                self.held.append((even, True))
            elif self._is_nth(message, rules):
                self.held.append((even, message.sensor in self._lost))
            else:
                if rules:
                    self._lost.discard(message.sensor)
                yield message

    def warnings(self) -> list[str]:
        """Return a line for each rule by which nothing was held back."""
        idle = [rule for rule in self._rules if rule in self._idle]
        return [f"{rule.sensor}: nothing was held back {rule.told()}" for rule in idle]

    def is_usable(self, message: Message) -> bool:
        """Return whether a message is one that can be used, as far as it tells itself; only such are counted."""
        sensor = self._sensors.get(message.sensor)
        return sensor is None or not isinstance(sensor.convert(message, World()), Outcome)

    def _is_nth(self, message: Message, rules: list[HoldOut]) -> bool:
        rule = next((rule for rule in rules if rule.every is not None), None)
        if rule is None or rule.every is None:
            return False
        self._seen[message.sensor] = self._seen.get(message.sensor, 0) + 1
        is_nth = self._seen[message.sensor] % rule.every == 0
        if is_nth:
            self._idle.discard(rule)
        return is_nth


class TrackPoint(NamedTuple):
    """A point of a track; `covariance` (9, 9) is NaN where it is not known.

    `from_imu` is False in an IMU drop-out, and for the nodes of the start, before the first estimate.
    """

    stamp_ns: int
    pose: gtsam.Pose3
    covariance: Array
    from_imu: bool


class Judgement(NamedTuple):
    """One held-out position against the track: error (3,) east, north, up [m]; NEES is NaN without a covariance.

    `imu_silent`: the position is within a drop-out of the IMU. Where one logger recorded both, such a fix may be no
    measurement either, but a line that the logger drew.
    """

    stamp_ns: int
    sensor: str
    in_outage: bool
    error: Array
    nees: float
    position: Array
    imu_silent: bool


class _Due(NamedTuple):
    """A held-out position, when it was measured by the clock of the IMU, and what is known of its sensor (p,)."""

    position: Position
    in_outage: bool
    time_ns: int
    parameter: Array


class Learning(Protocol):
    """An estimator that learns its sensors."""

    def noise(self, sensor: str) -> float:
        """Return how many times larger the noise of a sensor is than it claims."""

    def learnt(self) -> LearntSnapshot:
        """Return what was learnt until now."""


class HeldOutJudge:
    """Compares held-out positions with one track as both stream by.

    Args:
        config: of the estimator.
        estimator: whose track it is, if it learns noise, clocks and lever arms of its sensors.
    """

    def __init__(self, config: Config, estimator: Learning | None = None) -> None:
        self._estimator = estimator
        self._sensors = _position_sensors(config)
        self._track: deque[TrackPoint] = deque()
        self._first_imu_ns: int | None = None  # the first point that comes from the IMU
        self._waiting: deque[tuple[Message, bool]] = deque()
        self._early_ns: dict[str, int] = {}  # by which clocks are far behind, as of the newest message
        self._due: deque[_Due] = deque()
        self.judgements: list[Judgement] = []

    def add_message(self, message: Message, in_outage: bool) -> None:
        """Take in a held-out message; those that measure no position are passed over."""
        if message.sensor in self._sensors:
            self._early_ns = self._learnt().early_ns
            self._waiting.append((message, in_outage))

    def add_estimate(self, estimate: Estimate, frame: LocalFrame | None) -> None:
        """Take in what was published at an IMU sample, and judge the positions that it has passed."""
        self._append(TrackPoint(estimate.stamp_ns, estimate.nav.pose(), estimate.covariance, estimate.from_imu), frame)

    def add_optimised(self, state: OptimisedState, frame: LocalFrame | None) -> None:
        """Take in a newest node; it extends the track only where the IMU is silent."""
        self._append(TrackPoint(state.stamp_ns, state.nav.pose(), state.covariance[:9, :9], False), frame)

    def add_smoothed(self, stamp_ns: int, nav: gtsam.NavState, frame: LocalFrame | None) -> None:
        """Take in a node that will not change any more."""
        self._append(TrackPoint(stamp_ns, nav.pose(), UNKNOWN, True), frame)

    def add_block(self, block: Block, frame: LocalFrame | None) -> None:
        """Take in a stretch of the optimum over the recording, with its covariance."""
        track = block.track
        covariances = block.covariances.at(track.times_ns)
        rows = zip(
            track.times_ns.tolist(), track.positions, track.quaternions, covariances, track.from_imu, strict=True
        )
        for stamp_ns, position, (x, y, z, w), covariance, from_imu in rows:
            pose = gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), position)
            self._append(TrackPoint(stamp_ns, pose, covariance, bool(from_imu)), frame)

    def _append(self, point: TrackPoint, frame: LocalFrame | None) -> None:
        if self._track and point.stamp_ns <= self._track[-1].stamp_ns:
            return
        self._track.append(point)
        if point.from_imu and self._first_imu_ns is None:
            self._first_imu_ns = point.stamp_ns
        while point.stamp_ns - self._track[0].stamp_ns > MAX_DELAY_NS:
            self._track.popleft()
        while self._waiting and self._stamp_ns(self._waiting[0][0]) <= point.stamp_ns:
            message, in_outage = self._waiting.popleft()
            world, early_ns = World(frame), self._early_ns.get(message.sensor, 0)
            position = self._sensors[message.sensor].convert(measured_later(message, early_ns), world)
            if not isinstance(position, Outcome) and world.frame is frame:  # it has not set a datum itself
                self._due.append(self._calibrated(position, in_outage))
        while self._due and self._due[0].time_ns <= point.stamp_ns:
            self._judge(self._due.popleft())

    def _stamp_ns(self, message: Message) -> int:
        early_ns = self._early_ns.get(message.sensor, 0)
        return message.stamp_ns + self._sensors[message.sensor].offset_ns + early_ns

    def _learnt(self) -> LearntSnapshot:
        return NOTHING_LEARNT if self._estimator is None else self._estimator.learnt()

    def _calibrated(self, position: Position, in_outage: bool) -> _Due:
        """Return a position with what has been learnt of its receiver until now."""
        learnt_now = self._learnt()
        known, name = learnt_now.constants, position.sensor
        position = replace(position, sensor=learnt_now.names.antennas.get(name, name))
        sensor = with_estimated_clock(self._sensors[position.sensor])
        value = np.zeros(0)
        for prior in sensor.parameters:
            learnt = known.get(prior.name(position.sensor))
            is_told = learnt is not None and (learnt.is_off or prior.if_right is None)
            value = np.append(value, learnt.mean if learnt is not None and is_told else prior.mean)
        shift, offset_s = (value[:-1], float(value[-1])) if has_estimated_clock(sensor) else (value, 0.0)
        return _Due(position, in_outage, position.stamp_ns + round(offset_s * 1e9), shift)

    def _judge(self, due: _Due) -> None:
        position, in_outage, time_ns, parameter = due
        k = len(self._track) - 1
        while k > 0 and self._track[k - 1].stamp_ns >= time_ns:
            k -= 1
        if k == 0 or self._track[k].stamp_ns < time_ns:
            return  # before the track began
        before, after = self._track[k - 1], self._track[k]
        fraction = (time_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
        nav = gtsam.NavState(before.pose.slerp(fraction, after.pose), np.zeros(3))
        state = State(
            nav, after.covariance, parameter=parameter, parameter_covariance=np.zeros((len(parameter), len(parameter)))
        )
        innovation = self._sensors[position.sensor].innovation(position, state)
        ratio = 1.0 if self._estimator is None else self._estimator.noise(position.sensor)
        nees = innovation._replace(R=innovation.R * ratio**2).nis(state)
        silent = self._is_gap(before, after)
        self.judgements.append(
            Judgement(position.stamp_ns, position.sensor, in_outage, -innovation.y, nees, position.p_W_P, silent)
        )

    def _is_gap(self, before: TrackPoint, after: TrackPoint) -> bool:
        """Whether the IMU is silent between two points: there is no gap before it has spoken."""
        has_begun = self._first_imu_ns is not None and self._first_imu_ns <= before.stamp_ns
        return has_begun and not (before.from_imu and after.from_imu)
