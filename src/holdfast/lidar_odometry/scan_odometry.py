"""A lidar odometry as one value machine: scans and samples of an IMU in, poses out, the same every time.

It knows no estimator and no GNSS. `holdfast lidar-odometry`, a replay and `holdfast live` all run this one, so that the
same scans with the same rates give the same poses.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from holdfast.config.model import Config
from holdfast.config.sensors import MAP_VOXEL_M, SCAN_VOXEL_M, DriftingConfig, ScansConfig
from holdfast.errors import ConfigError
from holdfast.lidar_odometry.inertial_guide import NO_SAMPLES, ImuMount, ImuSamples, InertialGuide, imu_mount
from holdfast.lidar_odometry.masked import Masked, Masking, boxes_of
from holdfast.lidar_odometry.registration import DEFAULT_METHOD, Registered, make_registration
from holdfast.lidar_odometry.sweep import Sweep, sweep_of
from holdfast.messages import Array
from holdfast.point_cloud import PointCloud
from holdfast.recording.decode import UndecodableError

MIN_POINTS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """What an odometry must know; ranges and voxels in metres.

    Attributes:
        imu: how the guide sits to the lidar; None does without.
        T_L0_L: (4, 4) where the first pose is; None is the origin. With it the first pose is no beginning but goes on
            after a predecessor, `restarted`.
        masking: of points on the machine itself.
    """

    method: str = DEFAULT_METHOD
    threads: int = 1
    min_range_m: float = 1.0
    max_range_m: float = 120.0
    map_voxel_m: float = MAP_VOXEL_M
    scan_voxel_m: float = SCAN_VOXEL_M
    imu: ImuMount | None = None
    T_L0_L: Array | None = None
    masking: Masking = field(default_factory=Masking)


class ScanOdometry:
    """The odometry of one lidar."""

    def __init__(self, settings: Settings) -> None:
        voxels = {"map_voxel_m": settings.map_voxel_m, "scan_voxel_m": settings.scan_voxel_m}
        registration = make_registration(
            settings.method, settings.threads, **(voxels if settings.method == DEFAULT_METHOD else {})
        )
        self._registration = Masked(registration, settings.masking)
        self._settings = settings
        self._guide = None if settings.imu is None else InertialGuide(settings.imu)
        self._sweep: Sweep | None = None
        self._registered: Registered | None = None

    @property
    def gyroscope_bias(self) -> Array:
        """The bias (3,) of the gyroscope in the axes of L as it is known so far [rad/s]."""
        return np.zeros(3) if self._guide is None else self._guide.bias

    def register(self, scan: PointCloud, samples: ImuSamples = NO_SAMPLES) -> Registered:
        """Return where the lidar was in a scan.

        Args:
            scan: the next one, in the order of stamps.
            samples: of the IMU, that have come since the scan before.

        Raises:
            UndecodableError: the scan cannot be used; the odometry goes on with the next one.
        """
        if self._guide is not None:
            self._guide.add(samples)
        sweep = self._accepted(sweep_of(scan, keep_intensities=False))
        rates = None if self._guide is None else self._guide.rates(sweep)
        sweep = replace(sweep, rates=rates)
        registered = self._continued(self._registration.register(sweep))
        before, self._registered = self._registered, registered
        if self._guide is not None and rates is not None and before is not None and not registered.restarted:
            self._guide.learn(before, registered, sweep, rates)
        return replace(registered, is_guided=rates is not None)

    def finish(self) -> None:
        """Do what the next scan needs and the pose of the last one does not; `register` does it where nobody has."""
        self._registration.finish()

    def _accepted(self, sweep: Sweep) -> Sweep:
        last, near_m = self._sweep, self._settings.min_range_m
        if last is not None and sweep.frame_id != last.frame_id:
            raise UndecodableError(f"frame_id is {sweep.frame_id!r}, before it was {last.frame_id!r}: another lidar")
        if last is not None and sweep.stamp_ns <= last.stamp_ns:
            raise UndecodableError("its stamp is not later than the one before")
        seen = sweep.beyond(near_m, self._settings.max_range_m)
        if len(seen.points) < MIN_POINTS:
            raise UndecodableError(f"{len(seen.points)} points lie beyond {near_m:g} m (allowed: {MIN_POINTS} or more)")
        self._sweep = replace(seen, points=seen.points[:0], offsets_s=None)
        return seen

    def _continued(self, registered: Registered) -> Registered:
        """Put a pose where a predecessor has ended."""
        T = self._settings.T_L0_L
        if T is None:
            return registered
        has_begun = self._registered is not None
        return replace(registered, T_L0_L=T @ registered.T_L0_L, restarted=registered.restarted or not has_begun)


def settings_of(config: Config, name: str) -> Settings:
    """Return the settings of a sensor with `kind: scans`."""
    section = config.sensors[name]
    assert isinstance(section, ScansConfig)
    return Settings(
        section.method,
        section.threads,
        section.min_range_m,
        section.max_range_m,
        section.map_voxel_m,
        section.scan_voxel_m,
        imu_mount(config, name) if section.use_gyroscope and section.method == DEFAULT_METHOD else None,
        masking=Masking(boxes_of(section.machine_boxes_m), section.learn_machine),
    )


def lidar_of(config: Config, topic: str) -> str:
    """Return the name of the odometry with a topic, of its poses or of its scans, or of the only one.

    Raises:
        ConfigError: the configuration has no such odometry.
    """
    odometries = config.sensors_of(DriftingConfig)
    found = [name for name, odometry in odometries.items() if odometry.topic == topic] or list(odometries)
    if len(found) != 1:
        names = ", ".join(odometries) or "none"
        raise ConfigError(
            f"sensors: one with `kind: odometry` or `kind: scans` and the topic {topic} is needed for the mounting of "
            f"the lidar (there is {names})"
        )
    return found[0]
