"""The results of one replay as arrays: the material of its report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from holdfast.config.legacy import modernised
from holdfast.messages import Array

Event = Mapping[str, Any]


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
        correction: (N, 4) east, north, up [m] and yaw [deg] of T_W_O.
        sigma_times_s: (M,).
        sigmas: standard deviations that the estimator reports, by name with its unit: each (M,).
        bias_times_s: (B,).
        biases: (B, 6) of the gyroscope [rad/s], then the accelerometer [m/s^2]; without rows where none are known.
        true_bias_times_s: (T,) of a simulation; None where the truth is not known.
        true_biases: (T, 6) as `biases`.
        reference: (R, 3) position of I in W by the reference [m]; None without one.
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
    sigma_times_s: Array
    sigmas: Mapping[str, Array]
    bias_times_s: Array
    biases: Array
    true_bias_times_s: Array | None = None
    true_biases: Array | None = None
    reference: Array | None = None
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
