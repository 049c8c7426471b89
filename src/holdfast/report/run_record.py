"""The results of one replay as arrays: the material of its report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.config.legacy import modernised
from holdfast.messages import Array

Event = Mapping[str, Any]
FIRST_UTC_NS, LAST_UTC_NS = 10**18, 4 * 10**18  # 2001 to 2096: other stamps count from elsewhere


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """The errors against a reference; times count from the start of the run.

    Attributes:
        source: of the reference.
        times_s: (N,).
        values: by name with its unit: each (N,), such as `horizontal [m]`.
    """

    source: str
    times_s: Array
    values: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """What became of the measurements of one sensor, in the order of their stamps.

    Attributes:
        stamps_ns: (N,).
        outcomes: (N,) names of outcomes; `held_out` for one that the estimator did not receive.
        nis: (N,) normalised innovation squared, NaN where there is none; of a held-out one against the track.
        dof: (N,) its degrees of freedom.
        limit: (N,) of the gate on it, NaN where there is none.
        positions: (N, 3) in W [m], NaN where the measurement is none.
    """

    stamps_ns: NDArray[np.int64]
    outcomes: NDArray[np.str_]
    nis: Array
    dof: NDArray[np.int64]
    limit: Array
    positions: Array


@dataclass(frozen=True, slots=True)
class InnovationScore:
    """How well the innovations of a sensor agree with their covariance.

    Attributes:
        name: of the sensor, and which of its measurements.
        tested: number of measurements with an NIS.
        mean_per_dof: NIS over its degrees of freedom, of those that were used; None if none was.
        lower_per_dof: lower end of the interval in which that mean lies in 95 %, if they are independent.
        upper_per_dof: upper end of it.
        bound: chi-square quantile below which 95 % of the NIS are.
        fraction_inside: fraction of all tested below it.
    """

    name: str
    tested: int
    mean_per_dof: float | None
    lower_per_dof: float | None
    upper_per_dof: float | None
    bound: float
    fraction_inside: float


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """The results of one replay.

    Attributes:
        name: of the run.
        command: that makes it again.
        start_ns: from which times count.
        summary: summary.json.
        events: events.jsonl.
        times_s: (N,) of the estimates.
        world: (N, 3) position of I in W, as it was published [m].
        odometry: (N, 3) and in O [m].
        attitude: (N, 3) roll, pitch, yaw of I in W, yaw without steps at 180 deg [deg].
        correction: (N, 4) east, north, up [m] and yaw [deg] of T_W_O.
        sigma_times_s: (M,).
        sigmas: standard deviations that the estimator reports, by name with its unit: each (M,).
        speeds: (M,) [m/s].
        bias_times_s: (B,).
        biases: (B, 6) of the gyroscope [rad/s], then the accelerometer [m/s^2]; without rows where none are known.
        true_bias_times_s: (T,) of a simulation; None where the truth is not known.
        true_biases: (T, 6) as `biases`.
        optimum: (B, 3) position of I in W by the optimum over the recording [m].
        reference: (R, 3) position of I in W by the reference [m]; None without one.
        smoothed_times_s: (S,) of the nodes that left the window.
        smoothed: (S, 3) position of I in W at them [m].
        measurements: by sensor.
        scores: of the innovations.
    """

    name: str
    command: str
    start_ns: int
    summary: Mapping[str, Any]
    events: Sequence[Event]
    times_s: Array
    world: Array
    odometry: Array
    correction: Array
    attitude: Array
    sigma_times_s: Array
    sigmas: Mapping[str, Array]
    speeds: Array
    bias_times_s: Array
    biases: Array
    true_bias_times_s: Array | None = None
    true_biases: Array | None = None
    optimum: Array = field(default_factory=lambda: np.zeros((0, 3)))
    reference: Array | None = None
    smoothed_times_s: Array = field(default_factory=lambda: np.zeros(0))
    smoothed: Array = field(default_factory=lambda: np.zeros((0, 3)))
    measurements: Mapping[str, Measurements] = field(default_factory=dict)
    scores: Sequence[InnovationScore] = ()
    errors: Errors | None = None
    seed: str = ""
    notes: Sequence[str] = field(default=())

    @property
    def kinds(self) -> dict[str, str]:
        """The kind of every sensor of which there were measurements, by its name."""
        configured = modernised(self.summary["config"])["sensors"]
        return {name: configured[name]["kind"] for name in self.summary["counts"] if name in configured}

    @property
    def end_s(self) -> float:
        """Time of the last estimate."""
        return float(self.times_s[-1])

    def seconds(self, event: Event) -> float:
        """Return the time of an event."""
        return float((event["stamp_ns"] - self.start_ns) * 1e-9)

    def seconds_of(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Return the times (N,) of stamps."""
        times_s: Array = (stamps_ns - self.start_ns) * np.float64(1e-9)
        return times_s

    def utc(self, event: Event) -> str:
        """Return the time of day of an event, to a hundredth of a second; a dash where stamps are none since 1970."""
        if not FIRST_UTC_NS <= event["stamp_ns"] < LAST_UTC_NS:
            return "-"
        seconds, rest_ns = divmod(event["stamp_ns"], 1_000_000_000)
        return f"{datetime.fromtimestamp(seconds, UTC):%H:%M:%S}.{rest_ns // 10_000_000:02d}"
