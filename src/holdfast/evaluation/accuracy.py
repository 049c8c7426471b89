"""Judge a trajectory against a reference: errors over all and over named intervals.

estimate, reference -> associate -> align -> ape, rpe -> statistics for all and for each interval
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from math import inf
from typing import Any

from holdfast.errors import ConfigError
from holdfast.evaluation.absolute import EndError, Statistics, ape, end_error, summarise
from holdfast.evaluation.alignment import Alignment, AlignmentName, align
from holdfast.evaluation.association import Association, Pairs, associate
from holdfast.evaluation.relative import Pairing, RelativeErrors, kitti, rpe
from holdfast.messages import Array
from holdfast.state import Trajectory

WHOLE = "all"

Summary = dict[str, Statistics]


@dataclass(frozen=True, slots=True)
class Interval:
    """A named piece of time from its start to before its end, in seconds since the reference's first stamp.

    The end is open because an outage ends with the first good fix: what is known then is no error of the outage.

    Raises:
        ConfigError: it ends before it starts, or its name is empty or that of the whole ("all").
    """

    name: str
    start_s: float
    end_s: float

    def __post_init__(self) -> None:
        """Check the order of the ends."""
        if not -inf < self.start_s < self.end_s < inf:
            raise ConfigError(
                f"interval {self.name!r}: its start {self.start_s} s must be before its end {self.end_s} s, both finite"
            )
        if self.name in ("", WHOLE):
            raise ConfigError(f"interval {self.name!r}: give it a name, and another than {WHOLE!r}")


@dataclass(frozen=True, slots=True)
class Metrics:
    """What is asked for.

    Attributes:
        rpe_distances_m: relative errors over these distances.
        rpe_times_s: relative errors over these times.
        kitti: also the segments of the KITTI odometry benchmark.
    """

    rpe_distances_m: tuple[float, ...] = (10.0,)
    rpe_times_s: tuple[float, ...] = (1.0,)
    rpe_pairing: Pairing = "all"
    kitti: bool = False
    intervals: tuple[Interval, ...] = ()
    association: Association = field(default_factory=Association)


@dataclass(frozen=True, slots=True)
class Score:
    """The statistics over one piece of time.

    Attributes:
        ape: by name of `holdfast.evaluation.absolute.ape`.
        rpe: by delta ("10 m", "1 s", "KITTI"), then by name of `holdfast.evaluation.relative.rpe`; a delta longer than
            the piece has an empty table.
        end: error of the last pair.
    """

    start_s: float
    end_s: float
    pairs: int
    ape: Summary
    rpe: dict[str, Summary]
    end: EndError


@dataclass(frozen=True, slots=True, eq=False)
class Accuracy:
    """The verdict under one alignment.

    Attributes:
        pairs: aligned.
        errors: absolute errors of all pairs, see `holdfast.evaluation.absolute.ape`.
        scores: by name of the interval; the first is "all".
    """

    alignment: Alignment
    pairs: Pairs
    errors: dict[str, Array]
    scores: dict[str, Score]

    def to_json(self) -> dict[str, Any]:
        """Return the verdict in plain numbers, without the pairs."""
        return {
            "transform": {
                "quaternion_xyzw": self.alignment.quaternion.tolist(),
                "translation_m": self.alignment.translation.tolist(),
            },
            "scores": {name: asdict(score) for name, score in self.scores.items()},
        }


def evaluate(
    estimate: Trajectory,
    reference: Trajectory,
    alignment: AlignmentName = "none",
    metrics: Metrics | None = None,
) -> Accuracy:
    """Judge the estimate against the reference.

    Raises:
        RecordingError: the two cannot be associated or aligned.
        ConfigError: an interval holds no pairs, or a delta is not positive.
    """
    metrics = metrics or Metrics()
    return score_pairs(associate(estimate, reference, metrics.association), alignment, metrics)


def score_pairs(pairs: Pairs, alignment: AlignmentName, metrics: Metrics) -> Accuracy:
    """Judge pairs that are already associated; the alignment is that of all of them, also for the intervals."""
    motion = align(pairs, alignment)
    pairs = motion.apply(pairs)
    scores = {WHOLE: _score(pairs, metrics)}
    for interval in metrics.intervals:
        if interval.name in scores:
            raise ConfigError(f"interval {interval.name!r} is given twice")
        inside = pairs.between(interval.start_s, interval.end_s)
        if not len(inside):
            first_s, last_s = pairs.since_start_s()[[0, -1]]
            raise ConfigError(
                f"interval {interval.name!r} from {interval.start_s} to {interval.end_s} s holds no pose; "
                f"those that can be compared lie between {first_s:.3f} and {last_s:.3f} s of the reference"
            )
        scores[interval.name] = _score(inside, metrics)
    return Accuracy(motion, pairs, ape(pairs), scores)


def _score(pairs: Pairs, metrics: Metrics) -> Score:
    errors = ape(pairs)
    relative: dict[str, RelativeErrors] = {}
    for delta in metrics.rpe_distances_m:
        relative[f"{delta:g} m"] = rpe(pairs, delta, "m", metrics.rpe_pairing)
    for delta in metrics.rpe_times_s:
        relative[f"{delta:g} s"] = rpe(pairs, delta, "s", metrics.rpe_pairing)
    if metrics.kitti:
        relative["KITTI"] = kitti(pairs)
    first_s, last_s = pairs.since_start_s()[[0, -1]]
    return Score(
        start_s=float(first_s),
        end_s=float(last_s),
        pairs=len(pairs),
        ape=_summaries(errors),
        rpe={name: _summaries(result.errors) for name, result in relative.items()},
        end=end_error(pairs, errors),
    )


def _summaries(errors: dict[str, Array]) -> Summary:
    named: Sequence[tuple[str, Statistics | None]] = [(name, summarise(values)) for name, values in errors.items()]
    return {name: statistics for name, statistics in named if statistics is not None}
