"""What a map is made of: the output folder of a replay, and the scans of its recording."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.config.sensors import DriftingConfig
from holdfast.errors import ConfigError
from holdfast.geometry.earth import Geodetic
from holdfast.lidar_odometry.reader import SweepReader
from holdfast.lidar_odometry.runner import Options, choose_topic
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.mapping.claims import PoseCovariances, read_pose_covariances
from holdfast.messages import Array
from holdfast.recording.raw import RawBag
from holdfast.recording.tum import read_tum
from holdfast.replay.summary_file import datum_in, read_summary
from holdfast.state import Trajectory

TRACK = "imu_in_world.tum"


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a replay or a batch smoother wrote.

    Attributes:
        trajectory: of I in W, at the rate of the IMU.
        covariances: of its poses, if they were written.
        config: that of the run.
        datum: of W; None where W is nowhere on the earth.
    """

    folder: Path
    trajectory: Trajectory
    covariances: PoseCovariances | None
    config: Config
    datum: Geodetic | None

    def mount(self, frame: str, topic: str) -> tuple[Array, int]:
        """Return T_I_L (4, 4) of a lidar, and what is added to its stamps [ns]: the time offset of its odometry.

        Raises:
            ConfigError: nothing joins the frame to that of the IMU.
        """
        if not self.config.reaches(frame):
            fault = self.config.unreachable(frame)
            raise ConfigError(f"{self.folder}: {fault}; it is the frame of {topic}: give another with --frame")
        odometries = self.config.sensors_of(DriftingConfig)
        offsets_s = [one.time_offset_s for name, one in odometries.items() if self.config.frame_of(name) == frame]
        return self.config.T_I(frame), round(offsets_s[0] * 1e9) if offsets_s else 0


def read_run(folder: Path) -> Run:
    """Read the output folder of `holdfast replay` or `holdfast smooth`.

    Raises:
        ConfigError: it is none.
        RecordingError: a file in it cannot be read.
    """
    summary = read_summary(folder)
    trajectory = read_tum(folder / TRACK)
    return Run(
        folder,
        trajectory,
        read_pose_covariances(folder, trajectory),
        config_of(summary["config"], f"{folder}/summary.json"),
        datum_in(summary),
    )


class Scans:
    """The scans of a bag, in order.

    Args:
        bag: the recording.
        topic: of the clouds; None takes the only one.
        min_range_m: nearer points are those of the machine itself.

    Raises:
        RecordingError: there are no clouds.
        ConfigError: there are several topics of them, and none is asked for.
    """

    def __init__(self, bag: RawBag, topic: str | None, min_range_m: float) -> None:
        self._bag = bag
        self.topic = choose_topic(bag, Options(topic=topic, replace=True))
        self._reader = SweepReader(bag, self.topic, min_range_m)

    def read(self, progress: Callable[[int], None] | None = None) -> Iterator[Sweep]:
        """Yield those that can be used; `progress` is called with the arrival [ns] of each.

        Raises:
            RecordingError: the bag is damaged.
        """
        for arrival_ns, channel, raw in self._bag.messages():
            sweep = self._reader.take(arrival_ns, channel, raw)
            if sweep is not None:
                yield sweep
                if progress is not None:
                    progress(arrival_ns)

    def warnings(self) -> list[str]:
        """Return what was skipped, a line each."""
        return [*self._bag.recording.warnings, *self._reader.skipped.lines(str(self._bag.recording.path))]
