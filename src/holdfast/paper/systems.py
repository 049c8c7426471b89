"""The systems that are compared: ours, ours by the rules of the paper, and the baselines, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from holdfast.baselines.msf import make_msf
from holdfast.baselines.odometry_alone import make_odometry_alone
from holdfast.baselines.tsif import make_tsif
from holdfast.config.load import config_of
from holdfast.config.model import Config
from holdfast.estimator.estimator import Estimator
from holdfast.replay.published import Localiser


@dataclass(frozen=True, slots=True)
class System:
    """One system under comparison.

    Attributes:
        title: in tables.
        fuses: the sensors that it uses.
        make: makes it for a configuration.
        preset: whose defaults its configuration has.
    """

    title: str
    fuses: str
    make: Callable[[Config], Localiser]
    preset: str = "holdfast"


SYSTEMS = {
    "holdfast": System("Holdfast", "IMU, GNSS, heading, lidar", Estimator),
    "paper": System("Holdfast, paper's rules", "IMU, GNSS, heading, lidar", Estimator, preset="paper"),
    "msf": System("MSF", "IMU, GNSS, lidar", make_msf),
    "tsif": System("TSIF", "IMU, GNSS", make_tsif),
    "lidar": System("Lidar odometry alone", "lidar", make_odometry_alone),
}

ENGINE = "realtime"
TITLES = {name: system.title for name, system in SYSTEMS.items()} | {ENGINE: "Holdfast, optimiser in its own process"}
"""Of all rows of a table; the engine publishes the same estimates as the estimator, so it is only timed."""


def configured(name: str, given: dict[str, Any]) -> Config:
    """Return the configuration of a system from that of the machine, as plain data.

    Raises:
        ConfigError: the data is not a configuration.
    """
    data = {"preset": SYSTEMS[name].preset} | given
    return config_of(data, f"configuration of {name}")
