"""The evidence about a simulated run: what was published, and what is true."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation.smoothness import Inertial
from holdfast.evaluation.states import States
from holdfast.messages import Array
from holdfast.state import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Chassis:
    """The chassis B at N stamps; NaN where its state is not known.

    Attributes:
        in_imu: T_I_B, whose error is what the chassis adds to the error of T_O_I.
        yaw_rate: (N,) of B about its z axis [rad/s].
    """

    in_imu: Trajectory
    yaw_rate: Array


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """What the estimator published at N stamps.

    Attributes:
        world: I in W.
        odometry: I in O.
        covariances: (N, 9, 9) in the order of `holdfast.state`.
        trusted: (N,) GNSS was being used.
        chassis: None where the chassis is not estimated.
    """

    world: States
    odometry: States
    covariances: Array
    inertial: Inertial
    trusted: NDArray[np.bool_]
    chassis: Chassis | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """The fixes of one antenna, by true time.

    Attributes:
        positions: (M, 3) in W [m].
        errors: (M, 3) position minus truth [m].
        good: (M,) ambiguities fixed, and not faulty.
        faulty: (M,) off by more than their covariance explains.
        lever_arm: (3,) of the antenna in I [m].
    """

    stamps_ns: NDArray[np.int64]
    positions: Array
    errors: Array
    good: NDArray[np.bool_]
    faulty: NDArray[np.bool_]
    lever_arm: Array


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is true.

    Attributes:
        start_ns: from which seconds are counted.
        states: I in W at the stamps that were published.
        odometry: poses of I by an odometry alone, in the frame in which it began; None without one.
        at_odometry: I in W at the stamps of these.
        chassis: at the stamps that were published.
        slewing: (N,) the cabin slews on the chassis fast.
    """

    start_ns: int
    states: States
    antennas: Sequence[Fixes]
    odometry: Trajectory | None
    at_odometry: Trajectory | None
    chassis: Chassis
    slewing: NDArray[np.bool_]

    def seconds(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Return stamps (N,) in seconds since the start."""
        since: Array = (stamps_ns - self.start_ns) * np.float64(1e-9)
        return since
