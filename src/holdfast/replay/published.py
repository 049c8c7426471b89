"""Runs an estimator over messages and keeps everything that it publishes, to be judged by the truth of a simulation."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import accumulate, pairwise
from time import perf_counter, perf_counter_ns
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.evaluation.evidence import Chassis, Published
from holdfast.evaluation.smoothness import Inertial
from holdfast.evaluation.states import States
from holdfast.events import Event, EventKind, Outcome
from holdfast.geometry.earth import Geodetic, gravity_at
from holdfast.geometry.rotations import quaternions_xyzw
from holdfast.messages import Array, ImuSample, Message
from holdfast.replay.runner import Timing
from holdfast.ros.rows import table, turned
from holdfast.state import BaseState, Estimate, OptimisedState, Trajectory

PROGRESS_MESSAGES = 1000
TRUST = {
    EventKind.INITIALISED: True,
    EventKind.GNSS_LOST: False,
    EventKind.GNSS_REGAINED: True,
    EventKind.ESTIMATE_SUSPECT: True,  # fixes that were not trusted are accepted after all
}


class LocaliserOutput(Protocol):
    """The output of one message."""

    @property
    def estimate(self) -> Estimate | None:
        """The published state."""
        ...

    @property
    def optimised(self) -> OptimisedState | None:
        """The newest state after measurements were taken in."""
        ...

    @property
    def base(self) -> BaseState | None:
        """The chassis at the estimate."""
        ...


class Localiser(Protocol):
    """What can be replayed and judged: the estimator, or a baseline."""

    @property
    def config(self) -> Config:
        """Of the machine."""
        ...

    @property
    def counts(self) -> Counter[tuple[str, Outcome]]:
        """Number of measurements by sensor and outcome."""
        ...

    @property
    def events(self) -> list[Event]:
        """The events since `take_events`."""
        ...

    @property
    def datum(self) -> Geodetic | None:
        """Origin of W."""
        ...

    @property
    def waiting_for(self) -> str:
        """What keeps it from starting."""
        ...

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        ...

    def process(self, message: Message) -> LocaliserOutput:
        """Take in one message, in the order of arrival."""
        ...


class PublishedRecorder:
    """Feeds an estimator and keeps what comes out; `run` once, then ask for `published`.

    Args:
        config: of the machine.
        estimator: to be fed; by default the estimator under this configuration.
    """

    def __init__(self, config: Config, estimator: Localiser | None = None) -> None:
        self.estimator: Localiser = estimator or Estimator(config)
        self.timing = Timing()
        self.optimised: list[OptimisedState] = []
        self.events: list[Event] = []
        self._imu_name = config.imu_name
        self._max_gap_ns = round(config.imu.max_gap_s * 1e9)
        self._is_trusted = False
        self._trusted: list[bool] = []
        self._begun: list[int] = []  # rows at which the estimator started, or started over, or its clock stepped
        self._estimates: list[Estimate] = []
        self._force: Array = np.zeros(3)
        self._forces: list[Array] = []
        self._bases: list[BaseState | None] = []

    def run(self, messages: Iterable[Message], progress: Callable[[int], None] | None = None) -> None:
        """Process all messages, in the order of arrival."""
        began, first_ns, last_ns = perf_counter(), 0, 0
        for count, message in enumerate(messages):
            last_ns = message.arrival_ns
            first_ns = first_ns or last_ns
            began_ns = perf_counter_ns()
            output = self.estimator.process(message)
            took_ns = perf_counter_ns() - began_ns
            self._keep(message, output, took_ns)
            if progress is not None and count % PROGRESS_MESSAGES == 0:
                progress(last_ns)
        if isinstance(self.estimator, Estimator):
            self.estimator.close()
        self.timing.wall_s = perf_counter() - began
        self.timing.recorded_s = (last_ns - first_ns) * 1e-9

    def _keep(self, message: Message, output: LocaliserOutput, took_ns: int) -> None:
        if isinstance(message, ImuSample) and message.sensor == self._imu_name:
            self._force = message.specific_force
        if output.optimised is not None:
            self.timing.update_ns.append(took_ns)
            self.optimised.append(output.optimised)
        elif isinstance(message, ImuSample) and message.sensor == self._imu_name:
            self.timing.imu_ns.append(took_ns)
        if output.estimate is not None:
            self._estimates.append(output.estimate)
            self._forces.append(self._force)
            self._bases.append(output.base)
            self._trusted.append(self._is_trusted)
        if self.estimator.events:
            events = self.estimator.take_events()
            self.events += events
            for event in events:
                self._is_trusted = TRUST.get(event.kind, self._is_trusted)
                if event.kind is EventKind.INITIALISED:
                    self._begun.append(len(self._estimates))
                elif event.kind is EventKind.CLOCK_STEP and event.sensor == self._imu_name:
                    self._begun.append(len(self._estimates) - (output.estimate is not None))

    def outcomes(self) -> dict[str, dict[str, int]]:
        """Return the number of each sensor's measurements by outcome."""
        return by_sensor(self.estimator.counts)

    def event_rows(self, start_ns: int) -> tuple[tuple[float, str, str, str], ...]:
        """Return seconds since a start, kind, sensor and reason of the events, without single measurements."""
        events = [event for event in self.events if event.kind not in (EventKind.REJECTED, EventKind.LATE)]
        return tuple(((e.stamp_ns - start_ns) * 1e-9, str(e.kind), e.sensor, e.reason) for e in events)

    def lives(self) -> list[Published]:
        """Return what was published from each start of the estimator, or step of its clock, to the next."""
        edges = [*self._begun, len(self._estimates)]
        return [self._published(range(begin, end)) for begin, end in pairwise(edges) if begin < end]

    def published(self) -> Published:
        """Return everything that was published for a time later than all before."""
        stamps = [estimate.stamp_ns for estimate in self._estimates]
        newest = accumulate([-1, *stamps], max)
        later = [stamp > latest for stamp, latest in zip(stamps, newest, strict=False)]
        return self._published([row for row, is_later in enumerate(later) if is_later])

    def _published(self, rows: Sequence[int]) -> Published:
        kept = [self._estimates[row] for row in rows]
        stamps = np.array([estimate.stamp_ns for estimate in kept], dtype=np.int64)
        columns = table(kept)["estimate"]
        nav, T_W_O = columns["nav"], columns["T_W_O"]
        R_O_W = T_W_O["R"].transpose(0, 2, 1)
        world = Trajectory(stamps, nav["p"].copy(), quaternions_xyzw(nav["R"]))
        moved = turned(R_O_W, nav["p"] - T_W_O["p"])
        odometry = Trajectory(stamps, moved, quaternions_xyzw(R_O_W @ nav["R"]))
        return Published(
            world=States(world, nav["v"].copy()),
            odometry=States(odometry, turned(R_O_W, nav["v"])),
            covariances=columns["covariance"].copy(),
            inertial=self._inertial(rows, kept, columns),
            trusted=np.array([self._trusted[row] for row in rows], dtype=np.bool_),
            chassis=self._chassis(rows, stamps, nav),
        )

    def _inertial(self, rows: Sequence[int], kept: list[Estimate], columns: Any) -> Inertial:
        down = np.array([0.0, 0.0, -(self.estimator.config.frames.gravity or gravity_at(self.estimator.datum))])
        forces = np.array([self._forces[row] for row in rows]).reshape(-1, 3)
        in_world = turned(columns["nav"]["R"], forces - columns["bias_accel"]) + down
        return Inertial(
            angular_velocity=columns["angular_velocity"].copy(),
            acceleration=turned(columns["T_W_O"]["R"].transpose(0, 2, 1), in_world),
            received=self._received(rows, kept),
            gyroscope_bias=columns["bias_gyro"].copy(),
        )

    def _chassis(self, rows: Sequence[int], stamps: NDArray[np.int64], nav: Any) -> Chassis | None:
        bases = [self._bases[row] for row in rows]
        known = np.array([base is not None for base in bases], dtype=np.bool_)
        if not known.any():
            return None
        columns = table([base for base in bases if base is not None])["chassis"]
        R_I_W, T_W_B = nav["R"][known].transpose(0, 2, 1), columns["T_W_B"]
        poses, rates = np.full((len(rows), 7), np.nan), np.full(len(rows), np.nan)
        poses[known, :3] = turned(R_I_W, T_W_B["p"] - nav["p"][known])
        poses[known, 3:] = quaternions_xyzw(R_I_W @ T_W_B["R"])
        rates[known] = columns["angular_velocity"][:, 2]
        return Chassis(Trajectory(stamps, poses[:, :3], poses[:, 3:]), rates)

    def _received(self, rows: Sequence[int], kept: list[Estimate]) -> NDArray[np.bool_]:
        """Return where the IMU had no drop-out at an estimate and since the one before, within one life."""
        begun = set(self._begun)
        from_imu = np.array([e.from_imu for e in kept], dtype=np.bool_)
        within = np.array([row not in begun for row in rows], dtype=np.bool_)
        near = np.diff([e.stamp_ns for e in kept], prepend=0) <= self._max_gap_ns
        received: NDArray[np.bool_] = from_imu & np.concatenate([[False], from_imu[:-1]]) & within & near
        return received


def by_sensor(counts: Mapping[tuple[str, Outcome], int]) -> dict[str, dict[str, int]]:
    """Return counts by sensor and outcome as plain data, sorted, without zeros."""
    found: dict[str, dict[str, int]] = {}
    for (sensor, outcome), count in sorted(counts.items()):
        if count:
            found.setdefault(sensor, {})[str(outcome)] = count
    return found
