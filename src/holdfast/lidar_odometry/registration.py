"""What a registration library must do for us, and which there are."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

from holdfast.errors import ConfigError
from holdfast.extras import how_to_install
from holdfast.messages import Array

if TYPE_CHECKING:
    from holdfast.lidar_odometry.sweep import Sweep

# name -> (package to import, our adapter, the class in it)
METHODS = {
    "small-gicp": ("small_gicp", "holdfast.lidar_odometry.small_gicp", "SmallGicp"),
    "genz-icp": ("genz_icp", "holdfast.lidar_odometry.genz_icp", "GenzIcp"),
    "kiss-icp": ("kiss_icp", "holdfast.lidar_odometry.kiss_icp", "KissIcp"),
}
DEFAULT_METHOD = "small-gicp"


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """Where the lidar was at one instant of a sweep.

    Attributes:
        stamp_ns: the instant.
        T_L0_L: (4, 4) pose of the lidar in the frame where it was in its first sweep.
        covariance: (6, 6) of this registration against the map, rotation [rad] then translation [m], expressed in L
            (GTSAM's order); or None where the library reports none. In directions that the scan does not hold it is
            that of the motion since the pose before, which was guessed. The drift of the map is not in it.
        unheld: number of directions that the scan does not hold.
        cut: fraction of the points that lay on the machine and were not used.
        restarted: the sweep could not be joined to the map; a new one begins, and the motion since the last pose is
            not measured.
        is_guided: an IMU measured the whole sweep.
    """

    stamp_ns: int
    T_L0_L: Array
    covariance: Array | None = None
    restarted: bool = False
    is_guided: bool = False
    unheld: int = 0
    cut: float = 0.0


class Registration(ABC):
    """A lidar odometry: sweeps in, poses out, in order; deterministic with one thread."""

    @abstractmethod
    def register(self, sweep: "Sweep") -> Registered:
        """Return where the lidar was in the next sweep."""

    def finish(self) -> None:  # noqa: B027 (a library that does all at once has nothing to do)
        """Do what the next sweep needs and the pose of the last one does not; `register` does it where nobody has."""


def check_installed(method: str) -> None:
    """Refuse a method whose library is not there, without importing it.

    Raises:
        ConfigError: one line with the remedy.
    """
    package, _, _ = METHODS[method]
    if find_spec(package) is None:
        remedy = how_to_install("lidar") if method == DEFAULT_METHOD else f"pip install {method}"
        raise ConfigError(f"lidar odometry by {method} needs {package}: {remedy}")


def make_registration(method: str, threads: int, **settings: float) -> Registration:
    """Return a fresh odometry; `settings` are those of small-gicp."""
    _, module, name = METHODS[method]
    registration: Registration = getattr(import_module(module), name)(threads, **settings)
    return registration
