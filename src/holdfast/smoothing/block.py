"""What a stretch of a recording became: the smoothed track, biases, parameters of sensors, and refused measurements."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from holdfast.covariances import Covariances
from holdfast.events import Outcome
from holdfast.messages import Array
from holdfast.sensors.constants import Constant


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The smoothed motion of the IMU in W at N times, its own nodes between the samples left out.

    Attributes:
        times_ns: (N,) strictly increasing.
        positions: (N, 3) p_W_I [m].
        quaternions: (N, 4) of R_W_I: x, y, z, w.
        velocities: (N, 3) v_W [m/s].
        from_imu: (N,) False in a drop-out of the IMU.
    """

    times_ns: NDArray[np.int64]
    positions: Array
    quaternions: Array
    velocities: Array
    from_imu: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """Biases (B, 6) of accelerometer [m/s^2] and gyroscope [rad/s] with their sigmas (B, 6), from the times (B,) on."""

    times_ns: NDArray[np.int64]
    values: Array
    sigmas: Array


@dataclass(frozen=True, slots=True, eq=False)
class Mounted:
    """Where the chassis B was on the IMU, at those samples (M,) at which the causal estimator knew it.

    Attributes:
        rows: (M,) of the track.
        positions: (M, 3) p_I_B [m].
        rotations: (M, 3, 3) R_I_B.
    """

    rows: NDArray[np.int64]
    positions: Array
    rotations: Array


class Refused(NamedTuple):
    """A measurement that weighs less than it claims, in the end.

    Attributes:
        weight: 0 where it has no part in the estimate, below 1 where it has less than the others.
        nis: its squared residual over its covariance, NaN where it cannot be compared.
        reason: in a word.
    """

    stamp_ns: int
    sensor: str
    weight: float
    nis: float
    reason: Outcome


class Work(NamedTuple):
    """What the optimum cost: nodes and factors of the stretch, cost at the start and in the end, and iterations."""

    start_ns: int
    end_ns: int
    nodes: int
    factors: int
    cost_before: float
    cost_after: float
    iterations: int
    rounds: int


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """A stretch that is done.

    Attributes:
        covariances: at nodes that are at most half a second apart.
        counts: of measurements by sensor and outcome; one that weighs less than half is not used.
        constants: of sensors, by the name of the sensor, or of what several share.
        closures: of loops, by what became of them.
    """

    track: Track
    base: Mounted
    covariances: Covariances
    biases: Biases
    counts: Counter[tuple[str, Outcome]]
    refused: Sequence[Refused]
    constants: Mapping[str, Constant]
    work: Work
    closures: Counter[str]

    def stamped(self, stamp: Callable[[int], int]) -> "Block":
        """Return it with the stamps that the IMU's clock showed, which `stamp` tells at a time."""

        def of(times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
            return np.array([stamp(time_ns) for time_ns in times_ns.tolist()], dtype=np.int64)

        return replace(
            self,
            track=replace(self.track, times_ns=of(self.track.times_ns)),
            covariances=replace(self.covariances, times_ns=of(self.covariances.times_ns)),
            biases=replace(self.biases, times_ns=of(self.biases.times_ns)),
            refused=[one._replace(stamp_ns=stamp(one.stamp_ns)) for one in self.refused],
            work=self.work._replace(start_ns=stamp(self.work.start_ns), end_ns=stamp(self.work.end_ns)),
        )
