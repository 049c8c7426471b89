"""What one run of the estimator over one recording tells: track, constants of sensors, readings, held-out errors."""

from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.config.model import Config
from holdfast.errors import EstimatorError
from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind, Health
from holdfast.geometry.world import World
from holdfast.lidar_odometry.replayed import ReplayedScans
from holdfast.messages import Array, ImuSample, JointAngle, Message
from holdfast.recording.source import Recording, open_recording
from holdfast.recording.subscriptions import available
from holdfast.replay.held_out import HoldOut, Judgement
from holdfast.replay.never_started import never_started
from holdfast.replay.runner import Replay
from holdfast.sensors.clock import measured_later
from holdfast.sensors.constants import Constant
from holdfast.sensors.heading import AxisYaw
from holdfast.sensors.odometry import OdometryModel, TrackPose
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position, Role
from holdfast.state import Output

CONSTANTS_EVERY = 20  # optimisations, after which what is known of the constants is read again
LOST = Health.INITIALISING, Health.OPTIMISER_RESET, Health.FALLBACK, Health.RECOVERING
Progress = Callable[[int], None] | None


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Readings (N, m) of a sensor at increasing times (N,), its offset applied."""

    times_ns: NDArray[np.int64]
    values: Array

    @property
    def times_s(self) -> Array:
        """Times (N,) since 1970 [s]; differences hold to 0.3 us."""
        return np.asarray(self.times_ns * 1e-9, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """States that have left the window, at N times.

    Attributes:
        times_ns: (N,) increasing.
        positions: (N, 3) p_W_I [m].
        rotations: (N, 3, 3) R_W_I.
    """

    times_ns: NDArray[np.int64]
    positions: Array
    rotations: Array


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """The newest state of each optimisation, at N times.

    Attributes:
        times_ns: (N,) increasing.
        gyroscope_bias: (N, 3) [rad/s].
        sigmas: (N, 3) of a component of attitude [rad], of position [m] and of the gyroscope's bias [rad/s].
        is_lost: (N,) GNSS was not trusted.
    """

    times_ns: NDArray[np.int64]
    gyroscope_bias: Array
    sigmas: Array
    is_lost: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a run tells.

    Attributes:
        name: of the recording.
        config: under which the estimator ran.
        duration_s: of it.
        constants: of sensors, one entry for each start of the estimator.
        early_s: what is added to stamps of sensors whose clocks are far off, beside `constants`.
        readings: of `imu` and `base_imu` (N, 6) angular velocity and specific force, of the encoder (N, 1) the angle.
        tracks: poses of odometries, by name.
        fixes: positions and headings that the sensors claim, by name and stamp.
        judged: held-out positions against the causal track.
        smoothed: the same against the nodes.
    """

    name: str
    config: Config
    duration_s: float
    constants: Sequence[Mapping[str, Constant]]
    early_s: Mapping[str, float]
    nodes: Nodes
    states: States
    readings: Mapping[str, Readings]
    tracks: Mapping[str, Sequence[TrackPose]]
    fixes: Mapping[str, Mapping[int, Position | AxisYaw]]
    judged: Sequence[Judgement]
    smoothed: Sequence[Judgement]


@dataclass(slots=True)
class _Kept:
    """What is collected while the estimator runs."""

    nodes: dict[int, gtsam.NavState] = field(default_factory=dict)
    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    rows: "array[float]" = field(default_factory=lambda: array("d"))
    constants: list[Mapping[str, Constant]] = field(default_factory=list)


class _Collector:
    """Takes the outputs of an estimator."""

    def __init__(self) -> None:
        self.estimator: Estimator | None = None
        self.kept = _Kept()
        self._starts = self._count = 0

    def __call__(self, output: Output) -> None:
        estimator, kept, state = self.estimator, self.kept, output.optimised
        kept.nodes.update(output.smoothed)
        if state is None or estimator is None:
            return
        if not kept.stamps or state.stamp_ns > kept.stamps[-1]:
            variances = state.covariance.diagonal()
            sigmas = [float(np.sqrt(variances[k : k + 3].mean())) for k in (0, 3, 12)]
            kept.stamps.append(state.stamp_ns)
            kept.rows.extend([*state.bias.gyroscope().tolist(), *sigmas, float(estimator.health in LOST)])
        self._count += 1
        starts = estimator.event_counts[EventKind.INITIALISED] + estimator.event_counts[EventKind.BEGUN_ANEW]
        if starts != self._starts:
            self._starts = starts
            kept.constants.append({})
        if self._count % CONSTANTS_EVERY == 0:
            self.read()

    def read(self) -> None:
        """Read what is known of the constants now."""
        if self.estimator is not None and self.kept.constants:
            self.kept.constants[-1] = {**self.kept.constants[-1], **self.estimator.constants()}


class _Readings:
    """Keeps the readings of the sensors that no filter is asked about."""

    def __init__(self, config: Config, ignored: Collection[str]) -> None:
        self._ignored = ignored
        names = [config.imu_name, *(one[0] for one in (config.base_imu, config.joint) if one is not None)]
        self._stamps = {name: array("q") for name in names}
        self._values = {name: array("d") for name in names}
        self._offsets = {name: round(config.sensors[name].time_offset_s * 1e9) for name in names}
        self._sensors = {
            name: sensor
            for name, sensor in sensors_of(config).items()
            if sensor.role in (Role.POSITION, Role.HEADING, Role.ODOMETRY)
        }
        self.estimator: Estimator | None = None  # which places W
        self._world = World()
        self.tracks: dict[str, list[TrackPose]] = {
            name: [] for name, sensor in self._sensors.items() if isinstance(sensor, OdometryModel)
        }
        self.fixes: dict[str, dict[int, Position | AxisYaw]] = {
            name: {} for name in self._sensors if name not in self.tracks
        }

    def of(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield messages, and keep what they say."""
        for message in messages:
            name = message.sensor
            if name not in self._ignored:
                yield message
            if name in self._stamps and isinstance(message, ImuSample | JointAngle):
                self._stamps[name].append(message.stamp_ns + self._offsets[name])
                self._values[name].extend(message.values())
            elif name in self._sensors:
                early_ns = 0 if self.estimator is None else self.estimator.early_ns.get(name, 0)
                self._take(self._sensors[name], measured_later(message, early_ns))

    def _take(self, sensor: Any, message: Message) -> None:
        frame = None if self.estimator is None else self.estimator.world
        if frame is not self._world.frame:
            self._world = World(frame)
            self.fixes = {name: {} for name in self.fixes}  # those of another W
        if sensor.role is Role.POSITION and frame is None:
            return  # before W is placed
        measurement = sensor.convert(message, self._world)
        if isinstance(measurement, TrackPose):
            track = self.tracks[sensor.name]
            if not track or measurement.stamp_ns > track[-1].stamp_ns:
                track.append(measurement)
        elif isinstance(measurement, Position | AxisYaw):
            self.fixes[sensor.name][measurement.stamp_ns] = measurement

    def readings(self) -> dict[str, Readings]:
        """Return what was read, in the order of time."""
        found = {}
        for name, stamps in self._stamps.items():
            if not stamps:
                continue
            times, first = np.unique(np.frombuffer(stamps, dtype=np.int64), return_index=True)
            values = np.frombuffer(self._values[name], dtype=np.float64).reshape(len(stamps), -1)[first]
            usable = np.isfinite(values).all(axis=1)
            found[name] = Readings(times[usable], values[usable])
        return found


def gather(
    path: str,
    config: Config,
    rules: Sequence[HoldOut],
    *,
    ignored: Collection[str] = (),
    watch: Callable[[Recording], AbstractContextManager[Progress]] = lambda _: nullcontext(),
) -> Evidence:
    """Run the estimator over a recording.

    Args:
        path: of the recording.
        config: under which it runs.
        rules: what is held back from it.
        ignored: sensors that the estimator does not know; what they measure is collected all the same.
        watch: shows how far the recording has been read.

    Raises:
        RecordingError: it cannot be read, or lacks what the estimator needs.
        EstimatorError: the estimator never started; says why.
    """
    with open_recording(path) as recording, watch(recording) as progress:
        wanted, _ = available(recording, config)
        with ReplayedScans(config, recording.read(wanted)) as messages:
            return collected(path, config, messages, rules, ignored=ignored, progress=progress)


def collected(
    path: str,
    config: Config,
    messages: Iterable[Message],
    rules: Sequence[HoldOut] = (),
    *,
    ignored: Collection[str] = (),
    progress: Progress = None,
) -> Evidence:
    """Run the estimator over messages, in the order of arrival, as `gather` does over those of a recording.

    Raises:
        EstimatorError: the estimator never started; says why.
    """
    collector, kept = _Collector(), _Readings(config, ignored)
    known = {name: sensor for name, sensor in config.sensors.items() if name not in ignored}
    run = Replay(config.model_copy(update={"sensors": known}), None, rules, on_output=collector)
    assert isinstance(run.estimator, Estimator)
    collector.estimator = kept.estimator = run.estimator
    run.run(kept.of(messages), None, progress)
    if not run.has_started:
        why = never_started(run.estimator.waiting_for, run.estimator.counts, config)
        raise EstimatorError(f"{path}: the estimator never started: {why}")
    collector.read()
    found, early_s = collector.kept, {name: by_ns * 1e-9 for name, by_ns in run.estimator.early_ns.items()}
    return Evidence(
        Path(path).name, config, run.timing.recorded_s, found.constants, early_s, _nodes(found.nodes), _states(found),
        kept.readings(), kept.tracks, kept.fixes, run.causal.judgements, run.smoothed.judgements,
    )  # fmt: skip


def _nodes(found: Mapping[int, gtsam.NavState]) -> Nodes:
    times = sorted(found)
    poses = [found[time_ns].pose() for time_ns in times]
    return Nodes(
        np.array(times, dtype=np.int64),
        np.array([pose.translation() for pose in poses]).reshape(-1, 3),
        np.array([pose.rotation().matrix() for pose in poses]).reshape(-1, 3, 3),
    )


def _states(found: _Kept) -> States:
    rows = np.frombuffer(found.rows, dtype=np.float64).reshape(len(found.stamps), 7)
    times = np.frombuffer(found.stamps, dtype=np.int64)
    return States(times, rows[:, :3], rows[:, 3:6], rows[:, 6] > 0.5)
