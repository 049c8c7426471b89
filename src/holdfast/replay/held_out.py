"""Fixes that are held back from the estimator, to judge it without a ground truth.

What is held back never reaches the estimator. Each held-out fix is compared with the track at its own time, through the
antenna's lever arm; the causal track is what was published at IMU rate, and where the IMU was silent the newest
optimised states.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.messages import Array, GnssFix, Message
from holdfast.sensors.gnss import GnssModel
from holdfast.state import Estimate, OptimisedState, Outcome

KEPT_NS = 20_000_000_000  # of the track: later fixes than this are not judged


@dataclass(frozen=True, slots=True)
class HoldOut:
    """What to hold back: every n-th usable message of a sensor, or all of them in [start, end) of the recording."""

    sensor: str
    every: int | None = None
    start_s: float = 0.0
    end_s: float = 0.0

    @classmethod
    def parse_every(cls, text: str) -> "HoldOut":
        """Parse `gnss=2`.

        Raises:
            ConfigError: the text has another form.
        """
        sensor, _, every = text.partition("=")
        if not sensor or not every.isdecimal() or int(every) < 2:
            raise ConfigError(f"--hold-out {text}: must be SENSOR=N with N >= 2, such as gnss=2")
        return cls(sensor, int(every))

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
        if not start < end:
            raise ConfigError(f"--outage {text}: must end after it starts")
        return cls(sensor, None, start, end)


def check_sensors(rules: Iterable[HoldOut], config: Config) -> None:
    """Refuse rules for sensors that the configuration has not.

    Raises:
        ConfigError: names the sensor and those that are allowed.
    """
    known = [name for name in type(config.sensors).model_fields if getattr(config.sensors, name) is not None]
    for rule in rules:
        if rule.sensor not in known:
            raise ConfigError(f"sensor {rule.sensor!r} is not configured (allowed: {', '.join(known)})")


class HoldOutFilter:
    """Splits a stream of messages into what the estimator sees and what judges it."""

    def __init__(self, rules: Iterable[HoldOut], config: Config) -> None:
        self._rules = list(rules)
        check_sensors(self._rules, config)
        self._models = {name: GnssModel(gnss, np.zeros(3)) for name, gnss in config.sensors.antennas().items()}
        self.first_ns: int | None = None
        self._seen: dict[str, int] = {}
        self._lost: set[str] = set()  # sensors in an outage, which lasts until the estimator gets a message again
        self.held: deque[tuple[Message, bool]] = deque()

    def split(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield what is not held back; the rest goes to `held`, with whether it fell into an outage."""
        for message in messages:
            if self.first_ns is None:
                self.first_ns = message.stamp_ns
            at_s = (message.stamp_ns - self.first_ns) * 1e-9
            rules = [rule for rule in self._rules if rule.sensor == message.sensor and self._is_usable(message)]
            if any(rule.every is None and rule.start_s <= at_s < rule.end_s for rule in rules):
                self._lost.add(message.sensor)
                self.held.append((message, True))
            elif self._is_nth(message, rules):
                self.held.append((message, message.sensor in self._lost))
            else:
                if rules:
                    self._lost.discard(message.sensor)
                yield message

    def _is_usable(self, message: Message) -> bool:
        return not isinstance(message, GnssFix) or self._models[message.sensor].check(message) is Outcome.USED

    def _is_nth(self, message: Message, rules: list[HoldOut]) -> bool:
        every = next((rule.every for rule in rules if rule.every is not None), None)
        if every is None:
            return False
        self._seen[message.sensor] = self._seen.get(message.sensor, 0) + 1
        return self._seen[message.sensor] % every == 0


class TrackPoint(NamedTuple):
    """A point of a track: stamp, pose, the covariance (9, 9) of its state if known, and whether the IMU was heard."""

    stamp_ns: int
    pose: gtsam.Pose3
    covariance: Array | None
    from_imu: bool


class Judgement(NamedTuple):
    """One held-out fix against the track: error (3,) east, north, up [m]; NEES is NaN without a covariance.

    `imu_silent`: the fix fell into a drop-out of the IMU. Where one logger recorded both, such a fix may be no
    measurement either, but a line that the logger drew.
    """

    stamp_ns: int
    sensor: str
    in_outage: bool
    error: Array
    nees: float
    position: Array
    imu_silent: bool


class HeldOutJudge:
    """Compares held-out fixes with one track as both stream by."""

    def __init__(self, config: Config) -> None:
        self._offsets: dict[str, int] = {}
        self._arms: dict[str, Array] = {}
        for name, gnss in config.sensors.antennas().items():
            self._offsets[name] = round(gnss.time_offset_s * 1e9)
            self._arms[name] = config.T_I(gnss.frame)[:3, 3]
        self._track: deque[TrackPoint] = deque()
        self._waiting: deque[tuple[GnssFix, bool]] = deque()
        self.judgements: list[Judgement] = []

    def add_fix(self, fix: GnssFix, in_outage: bool) -> None:
        """Take in a held-out fix."""
        self._waiting.append((fix, in_outage))

    def add_estimate(self, estimate: Estimate, world: LocalFrame) -> None:
        """Take in what was published at an IMU sample, and judge the fixes that it has passed."""
        self._append(TrackPoint(estimate.stamp_ns, estimate.nav.pose(), estimate.covariance, estimate.from_imu), world)

    def add_optimised(self, state: OptimisedState, world: LocalFrame) -> None:
        """Take in a newest node; it extends the track only where the IMU is silent."""
        self._append(TrackPoint(state.stamp_ns, state.nav.pose(), state.covariance[:9, :9], False), world)

    def add_smoothed(self, stamp_ns: int, nav: gtsam.NavState, world: LocalFrame) -> None:
        """Take in a node that will not change any more."""
        self._append(TrackPoint(stamp_ns, nav.pose(), None, True), world)

    def _append(self, point: TrackPoint, world: LocalFrame) -> None:
        if self._track and point.stamp_ns <= self._track[-1].stamp_ns:
            return
        self._track.append(point)
        while point.stamp_ns - self._track[0].stamp_ns > KEPT_NS:
            self._track.popleft()
        while self._waiting and self._stamp(self._waiting[0][0]) <= point.stamp_ns:
            fix, in_outage = self._waiting.popleft()
            self._judge(fix, in_outage, world)

    def _stamp(self, fix: GnssFix) -> int:
        return fix.stamp_ns + self._offsets[fix.sensor]

    def _judge(self, fix: GnssFix, in_outage: bool, world: LocalFrame) -> None:
        stamp = self._stamp(fix)
        k = len(self._track) - 1
        while k > 0 and self._track[k - 1].stamp_ns >= stamp:
            k -= 1
        if k == 0 or self._track[k].stamp_ns < stamp:
            return  # before the track began
        before, after = self._track[k - 1], self._track[k]
        share = (stamp - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
        pose = before.pose.slerp(share, after.pose)
        point = Geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        measured = world.to_enu(point)
        estimated: Array = pose.transformFrom(self._arms[fix.sensor])
        error = estimated - measured
        nees = float("nan")
        if after.covariance is not None and fix.covariance is not None:
            R, (x, y, z) = pose.rotation().matrix(), self._arms[fix.sensor]
            arm_cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            H = np.hstack([-R @ arm_cross, R])  # of the antenna's position by the rotation and position of the body
            total = H @ after.covariance[:6, :6] @ H.T + fix.covariance
            nees = float(error @ np.linalg.solve(total, error))
        silent = not (before.from_imu and after.from_imu)
        self.judgements.append(Judgement(stamp, fix.sensor, in_outage, error, nees, measured, silent))
