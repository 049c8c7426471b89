"""The gyroscope of the recording: how the lidar turned during a sweep."""

from collections import deque

import numpy as np

from holdfast.config.model import Config
from holdfast.errors import ConfigError
from holdfast.lidar_odometry.deskew import Rates
from holdfast.lidar_odometry.sweep import Sweep
from holdfast.messages import ImuSample
from holdfast.recording.decode import imu_decoder
from holdfast.recording.raw import RawBag
from holdfast.recording.source import Subscription, find_topic

MEMORY_NS = 2_000_000_000
UNCOVERED_S = 0.03  # the last rate holds so long: a sample or two of 100 Hz that have not arrived yet


class Gyroscope:
    """The IMU of a configuration as a gyroscope of the lidar: its rates, turned into L, on the lidar's clock.

    Raises:
        ConfigError: the configuration has no lidar, or no extrinsics lead to it.
        RecordingError: the recording has no such topic.
    """

    def __init__(self, config: Config, bag: RawBag) -> None:
        imu, lidar = config.sensors.imu, config.sensors.lidar
        if lidar is None:
            raise ConfigError("sensors.lidar: is missing; its frame tells how the lidar is mounted on the IMU")
        try:
            self._R_I_L = config.T_I(lidar.frame)[:3, :3]
        except ValueError as error:
            raise ConfigError(f"extrinsics: {error}") from None
        self.topic = find_topic(bag.recording, imu.topic).topic
        self._offset_ns = round((imu.time_offset_s - lidar.time_offset_s) * 1e9)
        self._decode = imu_decoder(Subscription(imu.topic, "imu", "imu"))
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
        if times_s[0] > offsets_s.min() + UNCOVERED_S or times_s[-1] < offsets_s.max() - UNCOVERED_S:
            return None
        angular = np.array([sample.angular_velocity for sample in self._samples])
        return Rates(times_s, angular @ self._R_I_L)
