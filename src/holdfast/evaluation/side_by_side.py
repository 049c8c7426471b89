"""Several systems against one reference: judged at the same stamps, and over segments of the same lengths."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from holdfast.errors import RecordingError
from holdfast.evaluation.absolute import Statistics, summarise
from holdfast.evaluation.accuracy import Accuracy, Metrics, score_pairs
from holdfast.evaluation.alignment import AlignmentName
from holdfast.evaluation.association import Pairs, associate
from holdfast.evaluation.relative import rpe
from holdfast.messages import Array
from holdfast.state import Trajectory

FRACTIONS = (0.1, 0.2, 0.3, 0.4, 0.5)  # of the distance driven: Zhang and Scaramuzza, A tutorial ..., IROS 2018


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """One of several systems.

    Attributes:
        accuracy: its verdict at the common stamps.
        own_pairs: stamps of the reference at which this system has a pose, whatever the others have.
        segments: `translation_m` of the relative error, each (K,) [m], by the length of the segment [m].
    """

    name: str
    accuracy: Accuracy
    own_pairs: int
    segments: Mapping[float, Array]

    def segment_statistics(self) -> dict[str, Statistics]:
        """Return the statistics of the errors over each length, those that are longer than the track left out."""
        found = ((f"{length_m:g} m", summarise(errors)) for length_m, errors in self.segments.items())
        return {name: statistics for name, statistics in found if statistics is not None}

    def to_json(self) -> dict[str, Any]:
        """Return the verdict in plain numbers."""
        segments = {name: {key: getattr(of, key) for key in Statistics.__slots__}
                    for name, of in self.segment_statistics().items()}  # fmt: skip
        return {"own_pairs": self.own_pairs, "segments_translation_m": segments, **self.accuracy.to_json()}


def side_by_side(
    estimates: Mapping[str, Trajectory],
    reference: Trajectory,
    alignment: AlignmentName,
    metrics: Metrics,
    lengths_m: Sequence[float] = (),
) -> list[System]:
    """Judge several estimates against one reference where all of them have a pose.

    Args:
        estimates: by the name of the system.
        reference: by which they are judged.
        alignment: of each estimate on its own.
        metrics: as for one estimate.
        lengths_m: of the segments; by default `FRACTIONS` of the distance driven.

    Raises:
        RecordingError: one cannot be associated or aligned, or there is no time at which all have a pose.
        ConfigError: as `score_pairs`.
    """
    paired: dict[str, Pairs] = {}
    for name, estimate in estimates.items():
        try:
            paired[name] = associate(estimate, reference, metrics.association)
        except RecordingError as error:
            raise RecordingError(f"{name}: {error}") from None
    common = _common(paired, by_stamp=metrics.association.method == "interpolate")
    lengths_m = lengths_m or segment_lengths_m(next(iter(common.values())))
    systems = []
    for name, pairs in common.items():
        try:
            accuracy = score_pairs(pairs, alignment, metrics)
        except RecordingError as error:
            raise RecordingError(f"{name}: {error}") from None
        segments = {
            length: rpe(accuracy.pairs, length, "m", metrics.rpe_pairing).errors["translation_m"]
            for length in lengths_m
        }
        systems.append(System(name, accuracy, len(paired[name]), segments))
    return systems


def segment_lengths_m(pairs: Pairs) -> tuple[float, ...]:
    """Return lengths of segments for a track, with two digits; none where the reference stands still."""
    driven_m = float(pairs.driven_m()[-1])
    lengths = (float(f"{fraction * driven_m:.2g}") for fraction in FRACTIONS)
    return tuple(dict.fromkeys(length for length in lengths if length > 0.0))


def _common(paired: Mapping[str, Pairs], *, by_stamp: bool) -> dict[str, Pairs]:
    """Return the pairs at the stamps that all have, or (stamps of the estimates differ) in the time that all cover."""
    stamps = [pairs.reference.stamps_ns for pairs in paired.values()]
    if by_stamp:
        shared = reduce(np.intersect1d, stamps)
        found = {name: _chosen(pairs, np.isin(pairs.reference.stamps_ns, shared)) for name, pairs in paired.items()}
    else:
        first_ns, last_ns = max(one[0] for one in stamps), min(one[-1] for one in stamps)
        found = {
            name: _chosen(pairs, (pairs.reference.stamps_ns >= first_ns) & (pairs.reference.stamps_ns <= last_ns))
            for name, pairs in paired.items()
        }
    if min(map(len, found.values())) < 2:
        raise RecordingError(f"there is no time at which all of {', '.join(paired)} have a pose")
    return found


def _chosen(pairs: Pairs, inside: NDArray[np.bool_]) -> Pairs:
    estimate, reference = (
        Trajectory(of.stamps_ns[inside], of.positions[inside], of.quaternions[inside])
        for of in (pairs.estimate, pairs.reference)
    )
    return replace(pairs, estimate=estimate, reference=reference)
