"""The gyroscope of the recording: the rotation of the lidar during a sweep."""

from collections import deque

import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import OdometryConfig
from holdfast.errors import ConfigError
from holdfast.lidar_odometry.deskew import Rates
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.messages import ImuSample
from holdfast.recording.kinds.imu import imu_decoder
from holdfast.recording.raw import RawBag
from holdfast.recording.source import Subscription, find_topic

MEMORY_NS = 2_000_000_000
MAX_EXTRAPOLATION_S = 0.03  # a sample or two of 100 Hz that have not arrived yet


class Gyroscope:
    """The IMU of a configuration as a gyroscope of the lidar: its rates, expressed in L, on the lidar's clock.

    Args:
        config: names the IMU and the odometry that the lidar makes.
        bag: the recording.
        topic: of the odometry; a configuration with one odometry needs none.

    Raises:
        ConfigError: the configuration has no such odometry.
        RecordingError: the recording has no topic of the IMU.
    """

    def __init__(self, config: Config, bag: RawBag, topic: str) -> None:
        imu, lidar = config.imu, _odometry_of(config, topic)
        self._R_I_L = config.T_I(config.frame_of(lidar))[:3, :3]
        self.topic = find_topic(bag.recording, imu.topic).topic
        self._offset_ns = round((imu.time_offset_s - config.sensors[lidar].time_offset_s) * 1e9)
        self._decode = imu_decoder(Subscription(imu.topic, config.imu_name, imu.kind))
        self._samples: deque[ImuSample] = deque()

    def add(self, message: object, arrival_ns: int) -> None:
        """Take one sensor_msgs/Imu; a stamp that does not increase and a rate that is not finite are passed over."""
        sample = self._decode(message, arrival_ns)
        assert isinstance(sample, ImuSample)
        newest_ns = self._samples[-1].stamp_ns if self._samples else -1
        if sample.stamp_ns > newest_ns and np.isfinite(sample.angular_velocity).all():
            self._samples.append(sample)
            while self._samples[0].stamp_ns < sample.stamp_ns - MEMORY_NS:
                self._samples.popleft()

    def rates(self, sweep: Sweep) -> Rates | None:
        """Return what it measured around a sweep, or None if it did not measure the whole sweep."""
        if not self._samples:
            return None
        stamps_ns = np.array([sample.stamp_ns for sample in self._samples])
        times_s = (stamps_ns + self._offset_ns - sweep.stamp_ns) * 1e-9
        offsets_s = np.zeros(1) if sweep.offsets_s is None else sweep.offsets_s
        if times_s[0] > offsets_s.min() + MAX_EXTRAPOLATION_S or times_s[-1] < offsets_s.max() - MAX_EXTRAPOLATION_S:
            return None
        angular = np.array([sample.angular_velocity for sample in self._samples])
        return Rates(times_s, angular @ self._R_I_L)


def _odometry_of(config: Config, topic: str) -> str:
    """Return the name of the odometry with a topic, or of the only one."""
    odometries = config.sensors_of(OdometryConfig)
    found = [name for name, odometry in odometries.items() if odometry.topic == topic] or list(odometries)
    if len(found) != 1:
        names = ", ".join(odometries) or "none"
        raise ConfigError(
            f"sensors: one with `kind: odometry` and the topic {topic} is needed for the mounting of the lidar "
            f"(there is {names})"
        )
    return found[0]
