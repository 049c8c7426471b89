"""What a machine measures beside its inertia: the models of its antennas, its heading and its lidar."""

from typing import NamedTuple

import gtsam

from holdfast.config.model import Config
from holdfast.sensors.gnss import GnssModel
from holdfast.sensors.heading import HeadingModel
from holdfast.sensors.lidar import LidarModel


class Suite(NamedTuple):
    """One model per sensor; antennas by name, the left one first."""

    antennas: dict[str, GnssModel]
    heading: HeadingModel | None
    lidar: LidarModel | None


def suite_of(config: Config) -> Suite:
    """Return the models of the sensors that are configured, where the extrinsics say that they sit."""
    sensors = config.sensors
    antennas = {name: GnssModel(gnss, config.T_I(gnss.frame)[:3, 3]) for name, gnss in sensors.antennas().items()}
    arms = [model.p_I_G for model in antennas.values()]
    baseline = arms[1] - arms[0] if len(arms) == 2 else None
    heading = None if sensors.heading is None else HeadingModel(sensors.heading, baseline)
    lidar = None if sensors.lidar is None else LidarModel(sensors.lidar, gtsam.Pose3(config.T_I(sensors.lidar.frame)))
    return Suite(antennas, heading, lidar)
