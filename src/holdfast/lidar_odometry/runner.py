"""A recording with point clouds in, the same recording with poses in their place out."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import gtsam
import numpy as np

from holdfast.errors import ConfigError, RecordingError
from holdfast.lidar_odometry.gyroscope import Gyroscope
from holdfast.lidar_odometry.masked import Masking
from holdfast.lidar_odometry.reader import SweepReader
from holdfast.lidar_odometry.registration import DEFAULT_METHOD, Registered
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.lidar_odometry.worker import RegistrationProcess
from holdfast.messages import Array
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.raw import RawBag, RawCopier
from holdfast.recording.source import find_topic
from holdfast.ros.cdr import OdometryEncoder

ODOMETRY = "nav_msgs/msg/Odometry"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
FRAME = "lidar_odom"
UNKNOWN = np.zeros(36)


@dataclass(frozen=True, slots=True)
class Options:
    """The options of a run.

    Attributes:
        topic: of the clouds; None takes the only one.
        output_topic: of the poses.
        latency_s: a pose arrives so long after its cloud.
        min_range_m: nearer points are those of the machine itself.
        replace: the recording's own messages on `output_topic` are dropped.
        masking: of points on the machine itself.
    """

    topic: str | None = None
    output_topic: str = "/lidar/odometry"
    method: str = DEFAULT_METHOD
    threads: int = 1
    latency_s: float = 0.08
    min_range_m: float = 1.0
    keep_scans: bool = False
    replace: bool = False
    masking: Masking = field(default_factory=Masking)


@dataclass(slots=True)
class Summary:
    """Counts and warnings of a run.

    Attributes:
        unheld: poses with directions that the scan did not hold.
        cut: sum over the poses of the fraction of points that lay on the machine.
    """

    poses: int = 0
    unheld: int = 0
    cut: float = 0.0
    warnings: list[str] = field(default_factory=list)


def choose_topic(bag: RawBag, options: Options) -> str:
    """Return the topic of the clouds.

    Raises:
        RecordingError: there is none, or the one that is asked for is no PointCloud2.
        ConfigError: there are several and none is asked for, or the topic of the poses is taken.
    """
    clouds = [info.topic for info in bag.recording.topics if info.type == POINT_CLOUD]
    path = bag.recording.path
    if options.topic is None:
        if not clouds:
            there = ", ".join(f"{info.topic} ({info.type})" for info in bag.recording.topics)
            raise RecordingError(f"{path}: has no topic of {POINT_CLOUD}; it has {there}")
        if len(clouds) > 1:
            raise ConfigError(f"{path}: has several point clouds: give --topic one of {', '.join(clouds)}")
        topic = clouds[0]
    else:
        info = find_topic(bag.recording, options.topic)
        if info.type != POINT_CLOUD:
            raise RecordingError(f"{path}: topic {info.topic!r} is {info.type} (allowed: {POINT_CLOUD})")
        topic = info.topic
    taken = any(channel.topic == options.output_topic for channel in bag.channels)
    if options.output_topic == topic or (taken and not options.replace):
        remedy = "give another --output-topic" + (" or --replace" if options.output_topic != topic else "")
        raise ConfigError(f"{path}: has a topic {options.output_topic!r} already: {remedy}")
    return topic


def run(  # noqa: PLR0917 (all but the last two are needed)
    bag: RawBag,
    topic: str,
    writer: McapWriter,
    options: Options,
    gyroscope: Gyroscope | None = None,
    progress: Callable[[int], None] | None = None,
) -> Summary:
    """Copy a bag without its clouds, in order of arrival, and write a pose for each cloud that can be registered.

    Args:
        bag: what is read.
        topic: of the clouds, from `choose_topic`.
        writer: takes the copy and the poses.
        options: of the run.
        gyroscope: deskews better than the motion between the sweeps.
        progress: called with the arrival [ns] of each cloud.

    Raises:
        RecordingError: the bag is damaged, or none of its clouds can be used.
        EstimatorError: the registration failed.
    """
    summary = Summary()
    dropped = {options.output_topic} if options.keep_scans else {options.output_topic, topic}
    copier = RawCopier(writer, [channel for channel in bag.channels if channel.topic not in dropped])
    reader = SweepReader(bag, topic, options.min_range_m, gyroscope)
    with RegistrationProcess(options.method, options.threads, options.masking) as process:
        poses = _Poses(process, writer, options, summary)
        try:
            for arrival_ns, channel, raw in bag.messages():
                poses.write(until_ns=arrival_ns)
                copier.copy(arrival_ns, channel, raw)
                sweep = reader.take(arrival_ns, channel, raw)
                if sweep is None:
                    continue
                poses.submit(sweep, arrival_ns)
                if progress is not None:
                    progress(arrival_ns)
        except RecordingError:
            poses.write()  # what came before the damage is good
            raise
        poses.write()
    _warn(summary, bag, reader, copier, topic)
    return summary


def _warn(summary: Summary, bag: RawBag, reader: SweepReader, copier: RawCopier, topic: str) -> None:
    """Complete the warnings of a run.

    Raises:
        RecordingError: no cloud was used.
    """
    path = str(bag.recording.path)
    skipped = reader.skipped.lines(path)
    if not summary.poses:
        raise RecordingError(skipped[0] if skipped else f"{path}: holds no cloud on {topic}")
    left_out = [f"{path}: left out {text}" for text in copier.left_out]
    if reader.without_gyroscope:
        skipped.append(
            f"{path}: {reader.without_gyroscope} of {summary.poses} sweeps were deskewed without the gyroscope, which "
            "did not measure all of them: check its topic and time_offset_s"
        )
    summary.warnings = [*bag.recording.warnings, *skipped, *left_out, *summary.warnings]


class _Poses:
    """The pending poses, in order."""

    def __init__(self, process: RegistrationProcess, writer: McapWriter, options: Options, summary: Summary) -> None:
        self._process = process
        self._writer = writer
        self._options = options
        self._summary = summary
        self._latency_ns = round(options.latency_s * 1e9)
        self._due_ns: deque[int] = deque()
        self._encoder: OdometryEncoder | None = None

    def submit(self, sweep: Sweep, arrival_ns: int) -> None:
        """Submit a sweep; its pose arrives `latency_s` after it."""
        self._encoder = self._encoder or OdometryEncoder(FRAME, sweep.frame_id)
        self._process.submit(sweep)
        self._due_ns.append(arrival_ns + self._latency_ns)

    def write(self, until_ns: int | None = None) -> None:
        """Write all poses that arrive up to a time, or all."""
        while self._encoder and self._due_ns and (until_ns is None or self._due_ns[0] <= until_ns):
            registered = self._process.result()
            self._summary.poses += 1
            self._summary.unheld += registered.unheld > 0
            self._summary.cut += registered.cut
            if registered.restarted:
                self._summary.warnings.append(
                    f"at {registered.stamp_ns} ns a new map begins, after a gap or because the sweep does not fit: the "
                    "motion since the pose before it is not measured"
                )
            message = encode(registered, self._encoder)
            self._writer.write(self._options.output_topic, message, ODOMETRY, self._due_ns.popleft())


def encode(registered: Registered, encoder: OdometryEncoder) -> bytes:
    """Return a pose as nav_msgs/Odometry; the twist is left zero, and so is a covariance that is unknown.

    The covariance goes from the axes of L, rotation first, to those of the frame, translation first: (26) in
    docs/math.md.
    """
    R = registered.T_L0_L[:3, :3]
    covariance = UNKNOWN
    if registered.covariance is not None:
        M = np.zeros((6, 6))
        M[:3, 3:] = M[3:, :3] = R
        covariance = (M @ registered.covariance @ M.T).ravel()
    quaternion: Array = gtsam.Rot3(R).toQuaternion().coeffs()  # type: ignore[attr-defined]  # absent from the stubs
    zero = np.zeros(3)
    position = registered.T_L0_L[:3, 3]
    return encoder.encode([registered.stamp_ns], position, quaternion, covariance, zero, zero, UNKNOWN)[0]
