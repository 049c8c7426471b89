"""The messages of a recording with the poses of its scans in the place of the scans: what a replay reads."""

from collections.abc import Iterable, Iterator
from typing import Self

import gtsam
import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import ScansConfig
from holdfast.lidar_odometry.in_step import Due, InStep
from holdfast.lidar_odometry.process import ScanProcess
from holdfast.lidar_odometry.registration import Registered, check_installed
from holdfast.lidar_odometry.scan_odometry import settings_of
from holdfast.messages import Array, ImuSample, Message, SensorPose
from holdfast.point_cloud import PointCloud
from holdfast.recording.source import Closing
from holdfast.sensors.odometry import UNMEASURED_M, UNMEASURED_RAD

NOT_MEASURED = np.diag(np.repeat([UNMEASURED_RAD**2, UNMEASURED_M**2], 3))


class ReplayedScans(Closing):
    """Makes the odometries of the sensors with `kind: scans`, each in a process of its own; a context manager.

    A configuration without such sensors costs nothing.

    Args:
        config: names the sensors.
        messages: of the recording, in the order of arrival.

    Raises:
        ConfigError: the library that registers scans is not installed.
    """

    def __init__(self, config: Config, messages: Iterable[Message]) -> None:
        self._imu, self._messages = config.imu_name, messages
        sections = config.sensors_of(ScansConfig)
        for section in sections.values():
            check_installed(section.method)
        self.odometries: dict[str, InStep] = {}
        for name, section in sections.items():
            self.odometries[name] = InStep(settings_of(config, name), section.latency_s, make=ScanProcess)

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages in the order of arrival, poses among them.

        Raises:
            EstimatorError: the process of an odometry ends again and again.
        """
        if not self.odometries:
            yield from self._messages
            return
        for message in self._messages:
            yield from self._due(message.arrival_ns)
            if isinstance(message, PointCloud):
                self.odometries[message.sensor].add_scan(message)
                continue
            if isinstance(message, ImuSample) and message.sensor == self._imu:
                for odometry in self.odometries.values():
                    odometry.add_sample(message)
            yield message
        yield from self._due(None)

    def warnings(self) -> list[str]:
        """Return what was wrong with scans, one line each."""
        found = []
        for name, odometry in self.odometries.items():
            account = odometry.account
            if account.refused:
                found.append(f"{name}: {account.refused} scans could not be used, the last because {account.refusal}")
            if account.lost:
                found.append(f"{name}: {account.lost} scans were lost, {account.fault}; it was started again")
            if account.new_maps:
                found.append(f"{name}: {account.new_maps} new maps begun, after a gap or where a scan did not fit")
            if account.unguided and odometry.is_guided:
                found.append(
                    f"{name}: {account.unguided} of {account.poses} scans were deskewed without the IMU, which "
                    "did not measure all of them: check its topic and time_offset_s"
                )
        return found

    def close(self) -> None:
        """End the processes."""
        for odometry in self.odometries.values():
            odometry.close()

    def __enter__(self) -> Self:
        """Return the stream itself."""
        return self

    def _due(self, until_ns: int | None) -> Iterator[Message]:
        """Yield the poses that arrive up to a time, in the order of their arrival."""
        poses = [(due, name) for name, odometry in self.odometries.items() for due in odometry.due(until_ns)]
        for due, name in sorted(poses, key=lambda pair: pair[0].arrival_ns):
            yield pose_message(name, due)


def pose_message(name: str, due: Due) -> SensorPose:
    """Return a pose as the estimator takes it from any odometry: its covariance along the axes of L0, as in ROS."""
    registered = due.registered
    turned = np.kron(np.eye(2), registered.T_L0_L[:3, :3])
    covariance = None if registered.covariance is None else turned @ registered.covariance @ turned.T
    return SensorPose(
        registered.stamp_ns,
        due.arrival_ns,
        name,
        registered.T_L0_L[:3, 3].copy(),
        quaternion_xyzw(registered),
        NOT_MEASURED if registered.restarted else covariance,
    )


def quaternion_xyzw(registered: Registered) -> Array:
    """Return the attitude (4,) of a pose as a quaternion x, y, z, w."""
    found: Array = gtsam.Rot3(registered.T_L0_L[:3, :3]).toQuaternion().coeffs()  # type: ignore[attr-defined]
    return found
