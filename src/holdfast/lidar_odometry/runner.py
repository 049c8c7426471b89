"""A recording with point clouds in, the same recording with poses in their place out."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import ScansConfig
from holdfast.errors import ConfigError, RecordingError
from holdfast.lidar_odometry.in_step import InStep
from holdfast.lidar_odometry.inertial_guide import imu_mount
from holdfast.lidar_odometry.masked import Masking
from holdfast.lidar_odometry.process import ScanProcess
from holdfast.lidar_odometry.registration import DEFAULT_METHOD, Registered
from holdfast.lidar_odometry.scan_odometry import Settings, lidar_of, settings_of
from holdfast.messages import Array, ImuSample
from holdfast.point_cloud import PointCloud
from holdfast.recording.decode import Decoder, UndecodableError, stamp_ns
from holdfast.recording.kinds.imu import imu_decoder
from holdfast.recording.kinds.scans import POINT_CLOUD, point_cloud
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.merge import SkippedMessages
from holdfast.recording.raw import RawBag, RawCopier
from holdfast.recording.source import Subscription, find_topic
from holdfast.ros.cdr import OdometryEncoder

ODOMETRY = "nav_msgs/msg/Odometry"
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


class Guide(NamedTuple):
    """The IMU of a recording: its topic, what decodes it, and the settings of the odometry that it guides."""

    imu_topic: str
    decode: Decoder
    settings: Settings


def settings_of_options(options: Options) -> Settings:
    """Return the settings of a run without a configuration."""
    return Settings(options.method, options.threads, options.min_range_m, masking=options.masking)


def guide_of(config: Config, bag: RawBag, options: Options) -> Guide:
    """Return how the IMU of a configuration guides the odometry that is made.

    A sensor with `kind: scans` brings its settings along, one with `kind: odometry` its mounting alone.

    Raises:
        ConfigError: the configuration has no such odometry.
        RecordingError: the recording has no topic of the IMU.
    """
    name = lidar_of(config, options.output_topic)
    topic, kind = find_topic(bag.recording, config.imu.topic).topic, config.imu.kind
    decode = imu_decoder(Subscription(topic, config.imu_name, kind, factors=config.imu.factors))
    if isinstance(config.sensors[name], ScansConfig):
        return Guide(topic, decode, settings_of(config, name))
    return Guide(topic, decode, replace(settings_of_options(options), imu=imu_mount(config, name)))


def run(  # noqa: PLR0917 (all but the last two are needed)
    bag: RawBag,
    topic: str,
    writer: McapWriter,
    options: Options,
    guide: Guide | None = None,
    progress: Callable[[int], None] | None = None,
) -> Summary:
    """Copy a bag without its clouds, in order of arrival, and write a pose for each cloud that can be registered.

    Args:
        bag: what is read.
        topic: of the clouds, from `choose_topic`.
        writer: takes the copy and the poses.
        options: of the run.
        guide: an IMU predicts and deskews better than the motion between the sweeps.
        progress: called with the arrival [ns] of each cloud.

    Raises:
        RecordingError: the bag is damaged, or none of its clouds can be used.
        EstimatorError: the registration failed.
    """
    summary, skipped = Summary(), SkippedMessages()
    dropped = {options.output_topic} if options.keep_scans else {options.output_topic, topic}
    copier = RawCopier(writer, [channel for channel in bag.channels if channel.topic not in dropped])
    settings = settings_of_options(options) if guide is None else guide.settings
    wanted = {topic} if guide is None else {topic, guide.imu_topic}
    codecs = {channel: channel.codec() for channel in bag.channels if channel.topic in wanted}

    def refuse(arrival_ns: int, reason: str) -> None:
        skipped.add(topic, arrival_ns, UndecodableError(reason))

    with closing(InStep(settings, options.latency_s, restarts=False, make=ScanProcess, on_refusal=refuse)) as odometry:
        poses = _Poses(odometry, writer, options, summary)
        try:
            for arrival_ns, channel, raw in bag.messages():
                poses.write(until_ns=arrival_ns)
                copier.copy(arrival_ns, channel, raw)
                if channel not in codecs:
                    continue
                try:
                    message = _decoded(codecs[channel].deserialize(raw), arrival_ns, channel.topic == topic, guide)
                except Exception as error:  # damaged bytes raise anything; one message must not end the run
                    skipped.add(channel.topic, arrival_ns, error)
                    continue
                if isinstance(message, ImuSample):
                    odometry.add_sample(message)
                    continue
                odometry.add_scan(message)
                if progress is not None:
                    progress(arrival_ns)
        except RecordingError:
            poses.write()  # what came before the damage is good
            raise
        poses.write()
    _warn(summary, bag, odometry, copier, topic, skipped)
    return summary


def _decoded(message: Any, arrival_ns: int, is_cloud: bool, guide: Guide | None) -> PointCloud | ImuSample:
    if is_cloud or guide is None:
        return point_cloud(stamp_ns(message), arrival_ns, "", message)
    sample = guide.decode(message, arrival_ns)
    assert isinstance(sample, ImuSample)
    return sample


def _warn(  # noqa: PLR0917
    summary: Summary, bag: RawBag, odometry: InStep, copier: RawCopier, topic: str, skips: SkippedMessages
) -> None:
    """Complete the warnings of a run.

    Raises:
        RecordingError: no cloud was used.
    """
    path, account = str(bag.recording.path), odometry.account
    skipped = skips.lines(path)
    if not summary.poses:
        raise RecordingError(skipped[0] if skipped else f"{path}: holds no cloud on {topic}")
    left_out = [f"{path}: left out {text}" for text in copier.left_out]
    if odometry.is_guided and account.unguided:
        skipped.append(
            f"{path}: {account.unguided} of {summary.poses} sweeps were deskewed without the IMU, which "
            "did not measure all of them: check its topic and time_offset_s"
        )
    summary.warnings = [*bag.recording.warnings, *skipped, *left_out, *summary.warnings]


class _Poses:
    """Writes the poses, in order."""

    def __init__(self, odometry: InStep, writer: McapWriter, options: Options, summary: Summary) -> None:
        self._odometry = odometry
        self._writer = writer
        self._options = options
        self._summary = summary
        self._encoder: OdometryEncoder | None = None

    def write(self, until_ns: int | None = None) -> None:
        """Write all poses that arrive up to a time, or all."""
        for registered, arrival_ns, frame_id in self._odometry.due(until_ns):
            self._encoder = self._encoder or OdometryEncoder(FRAME, frame_id)
            self._summary.poses += 1
            self._summary.unheld += registered.unheld > 0
            self._summary.cut += registered.cut
            if registered.restarted:
                self._summary.warnings.append(
                    f"at {registered.stamp_ns} ns a new map begins, after a gap or because the sweep does not fit: the "
                    "motion since the pose before it is not measured"
                )
            self._writer.write(self._options.output_topic, encode(registered, self._encoder), ODOMETRY, arrival_ns)


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
