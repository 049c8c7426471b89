"""Outages of GNSS: how far the estimate drifts, compared with the odometry alone, and how it recovers.

The quality of GNSS is taken from the truth of the fixes and never from the estimator: an outage is a time without an
RTK-fixed fix that is not faulty, whatever the receiver reported meanwhile.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isnan, nan

import numpy as np
from numpy.typing import NDArray

from holdfast.evaluation import quaternions
from holdfast.evaluation.evidence import Published, Truth
from holdfast.evaluation.spans import Span, gaps, settling_s
from holdfast.evaluation.states import StateErrors, rotation_vector
from holdfast.messages import Array

OUTAGE_S = 1.0  # a longer time without a good fix is an outage
RECOVERY_S = 5.0  # so long after the start and after an outage, times are not nominal yet
SETTLED_M, SETTLED_FOR_S = 0.02, 1.0


@dataclass(frozen=True, slots=True)
class Outage:
    """One outage and the recovery from it.

    Attributes:
        has_faulty: there were faulty fixes.
        alone_horizontal_rms_m: of the odometry alone, anchored at the true pose at the loss; NaN without one.
        settled_s: from when GNSS is used again until the position error stays below 2 cm for a second.
        regained_s: from the first good fix until GNSS is used.
    """

    span: Span
    has_faulty: bool
    horizontal_rms_m: float
    vertical_rms_m: float
    heading_rms_deg: float
    alone_horizontal_rms_m: float
    alone_heading_rms_deg: float
    settled_s: float
    regained_s: float


def outage_spans(truth: Truth, whole: Span) -> list[Span]:
    """Return the outages within the time that was judged."""
    stamps = [fixes.stamps_ns[fixes.good] for fixes in truth.antennas]
    good_s = truth.seconds(np.sort(np.concatenate(stamps))) if stamps else np.zeros(0)
    return gaps(good_s, OUTAGE_S, whole)


def nominal(times_s: Array, spans: Sequence[Span]) -> NDArray[np.bool_]:
    """Return at which times (N,) GNSS is good and has been for a while."""
    good: NDArray[np.bool_] = times_s >= times_s[0] + RECOVERY_S
    for span in spans:
        good &= ~Span(span.start_s, span.end_s + RECOVERY_S).holds(times_s)
    return good


def within(times_s: Array, spans: Sequence[Span]) -> NDArray[np.bool_]:
    """Return which times (N,) are within one of the spans."""
    found = np.zeros(len(times_s), dtype=np.bool_)
    for span in spans:
        found |= span.holds(times_s)
    return found


def judge_outages(errors: StateErrors, published: Published, truth: Truth, spans: Sequence[Span]) -> list[Outage]:
    """Judge every outage, and the time from it to the next one."""
    times_s = truth.seconds(published.world.poses.stamps_ns)
    judged = []
    for k, span in enumerate(spans):
        following_s = spans[k + 1].start_s if k + 1 < len(spans) else float(times_s[-1])
        inside = span.holds(times_s)
        alone = _alone(span, truth)
        recovery = _recovery(Span(span.end_s, following_s), times_s, errors, published.trusted)
        judged.append(
            Outage(
                span=span,
                has_faulty=any((f.faulty & span.holds(truth.seconds(f.stamps_ns))).any() for f in truth.antennas),
                horizontal_rms_m=norm_rms(errors.position[inside, :2]),
                vertical_rms_m=norm_rms(errors.position[inside, 2:]),
                heading_rms_deg=float(np.degrees(norm_rms(errors.attitude[inside, 2:]))),
                alone_horizontal_rms_m=alone[0],
                alone_heading_rms_deg=alone[1],
                settled_s=recovery[0],
                regained_s=recovery[1],
            )
        )
    return judged


def sum_up(outages: Sequence[Outage]) -> dict[str, float]:
    """Return scores over all outages: RMS weighted by duration, everything else that of the worst outage."""
    ours = ("horizontal_rms_m", "vertical_rms_m", "heading_rms_deg")
    alone = ("alone_horizontal_rms_m", "alone_heading_rms_deg")
    return {f"outage_{name}": _pooled(outages, name) for name in ours + alone} | {
        "outage_horizontal_excess_m": _worst([o.horizontal_rms_m - o.alone_horizontal_rms_m for o in outages]),
        "outage_heading_excess_deg": _worst([o.heading_rms_deg - o.alone_heading_rms_deg for o in outages]),
        "settled_s": _worst([outage.settled_s for outage in outages]),
        "regained_s": _worst([outage.regained_s for outage in outages]),
    }


def norm_rms(vectors: Array) -> float:
    """Return the root of the mean squared length of vectors (N, d); NaN if there are none."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean())) if len(vectors) else nan


def _recovery(after: Span, times_s: Array, errors: StateErrors, trusted: NDArray[np.bool_]) -> tuple[float, float]:
    """Return how long it took to settle and to use GNSS again [s]; NaN where there was no time for it."""
    rows = after.holds(times_s)
    if not rows.any():
        return nan, nan
    away = np.linalg.norm(errors.position[rows], axis=1)
    used = times_s[rows][trusted[rows]]
    regained_s = float(used[0]) - after.start_s if len(used) else inf
    settled_s = settling_s(times_s[rows], away, SETTLED_M, SETTLED_FOR_S)
    if regained_s < inf:
        settled_s = max(0.0, settled_s - regained_s)
    if after.end_s - after.start_s < RECOVERY_S:
        return nan if settled_s == inf else settled_s, nan if regained_s == inf else regained_s
    return settled_s, regained_s


def _alone(span: Span, truth: Truth) -> tuple[float, float]:
    """Return horizontal [m] and heading [deg] RMS of the odometry alone, anchored at its last pose before."""
    if truth.odometry is None or truth.at_odometry is None:
        return nan, nan
    ours, theirs = truth.odometry, truth.at_odometry
    inside = np.flatnonzero(span.holds(truth.seconds(ours.stamps_ns)))
    if not len(inside):
        return nan, nan
    anchor = max(int(inside[0]) - 1, 0)
    q = quaternions.multiply(theirs.quaternions[anchor], quaternions.conjugate(ours.quaternions[anchor]))
    moved = quaternions.rotate(q, ours.positions[inside] - ours.positions[anchor])
    away = theirs.positions[anchor] + moved - theirs.positions[inside]
    turned = quaternions.multiply(q, ours.quaternions[inside])
    back = rotation_vector(quaternions.multiply(turned, quaternions.conjugate(theirs.quaternions[inside])))
    return norm_rms(away[:, :2]), float(np.degrees(norm_rms(back[:, 2:])))


def _pooled(outages: Sequence[Outage], name: str) -> float:
    known = [(o.span.end_s - o.span.start_s, getattr(o, name)) for o in outages if not isnan(getattr(o, name))]
    total_s = sum(duration_s for duration_s, _ in known)
    return float(np.sqrt(sum(duration_s * rms**2 for duration_s, rms in known) / total_s)) if known else nan


def _worst(values: Sequence[float]) -> float:
    return max((value for value in values if not isnan(value)), default=nan)
