"""The batch of a start in motion, without what is at odds with the rest.

What does not fit is looked for where it is likely: a receiver that is none of GNSS, whose station somebody has typed
in, and an odometry that is mounted otherwise, or lies. GNSS and IMU are what is left.
"""

from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

from holdfast.estimator.odometry_tracks import OdometryTracks
from holdfast.graph.alignment import FITS, Alignment
from holdfast.graph.alignment_problem import Evidence
from holdfast.sensors.sensor import is_gnss

DOUBTFUL = 2.0  # squared residuals over what is claimed, where an odometry is among them


class FittingBatch(NamedTuple):
    """A batch that fits, or the whole one if none does, what it was made of, and who was left out."""

    alignment: Alignment
    evidence: Evidence
    left_out: frozenset[str]


def fitting_batch(
    solve: Callable[[Evidence], Alignment], evidence: Evidence, points: Mapping[str, object], odometries: OdometryTracks
) -> FittingBatch:
    """Solve the batch of some evidence and the motions of odometries; leave out who is at odds, if it fits then.

    Args:
        solve: solves it.
        evidence: without motions.
        points: the receivers of positions, by name.
        odometries: that have measured meanwhile.
    """
    whole = evidence._replace(motions=odometries.factors(evidence.stamps))
    alignment = solve(whole)
    for names in _doubtful(whole, alignment, points, odometries):
        fewer = _without(whole, names, odometries)
        other = solve(fewer)
        is_better = len(fewer.positions) == len(whole.positions) or other.misfit <= FITS
        if is_better and other.excess <= (DOUBTFUL if fewer.motions else FITS):
            return FittingBatch(other, fewer, names)
    return FittingBatch(alignment, whole, frozenset())


def _doubtful(
    evidence: Evidence, alignment: Alignment, points: Mapping[str, object], odometries: OdometryTracks
) -> list[frozenset[str]]:
    """Return what may be left out of a batch that does not fit: receivers, one odometry of several, or all of them."""
    receivers = {one.sensor for one in evidence.positions}
    placed = frozenset(name for name in receivers if not is_gnss(points[name]))
    placed = placed if len(placed) < len(receivers) else frozenset()
    if alignment.excess <= DOUBTFUL:
        return [placed] if placed and alignment.misfit > FITS else []
    names = frozenset(odometries.names) if evidence.motions else frozenset[str]()
    singles = [frozenset({name}) for name in sorted(names)] if len(names) > 1 else []
    return [one for one in (placed, *singles, names, placed | names) if one]


def _without(evidence: Evidence, names: Collection[str], odometries: OdometryTracks) -> Evidence:
    """Return the evidence without some odometries and receivers."""
    positions = [one for one in evidence.positions if one.sensor not in names]
    velocities = [one for one in evidence.velocities if one.stamp_ns >= positions[0].stamp_ns]
    fewer = Evidence(positions, velocities)
    return fewer._replace(motions=odometries.factors(fewer.stamps, names) if evidence.motions else ())
