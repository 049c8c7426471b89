"""The batch of a start in motion, without what is at odds with the rest.

What does not fit is looked for where it is likely: an antenna that is elsewhere than configured, a clock that is off,
a receiver that is none of GNSS, whose station somebody has typed in, and an odometry that is mounted otherwise, or
lies. GNSS and IMU are what is left.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import inf, log
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from holdfast.estimator.batch_clock import REACH_S, Offset, kept, offset_of, restamped
from holdfast.estimator.collected import exchanged
from holdfast.estimator.fixes_in_motion import MIN_POSITIONS
from holdfast.estimator.odometry_tracks import OdometryTracks
from holdfast.graph.alignment import DOUBTFUL, FITS, JUMPED, Alignment, BatchAligner
from holdfast.graph.alignment_problem import BUCKET_NS, CLAIMED_DEGREES, MAX_EXCESS, BiasPrior, Evidence, Problems
from holdfast.integrity.exchanges import Pair
from holdfast.messages import Array
from holdfast.sensors.gnss import GnssModel, is_measured
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.lever_arm import GNSS_ARM, IF_RIGHT_M, doubtful_arm
from holdfast.sensors.preintegration import ImuNoise
from holdfast.sensors.sensor import Parameter, Position, VelocitySensor, is_gnss

FREED_M = 10.0  # sigma of an arm in doubt: nothing shall hold it
MOST_LATE_S = 1.0  # of clocks
TELLING = 8  # positions that may tell a clock, or a state although they are at odds with an odometry
STRAYS = 2  # positions of a batch, at most, that are elsewhere
PATIENCE_NS = 60_000_000_000  # after which what nobody can tell is believed as it is stamped
AT_ODDS = "positions, IMU and odometry are at odds: without the odometry the motion so far does not tell the heading"
CLEARLY = 10.0  # evidence, by which one explanation is better than another
TOLD_M, MOVED = 0.5, 5.0  # sigma to which motions must tell an element of an arm, and sigmas by which it is off


class FittingBatch(NamedTuple):
    """A batch that fits, or the whole one if none does, and what it was made of.

    Attributes:
        alignment: its outcome.
        evidence: of which it was made.
        left_out: who is not in it.
        shift: of the lever arms of antennas that are elsewhere than configured, as a prior of a graph, else None.
        clock: of GNSS, by which the evidence was stamped otherwise, else None.
        exchanged: antennas whose positions it takes by each other's name.
    """

    alignment: Alignment
    evidence: Evidence
    left_out: frozenset[str] = frozenset()
    shift: Parameter | None = None
    clock: Offset | None = None
    exchanged: Pair | None = None


class FittingBatches:
    """Solves batches; one instance per start.

    Args:
        buffer: of the IMU's samples.
        noise: of the IMU.
        points: the receivers of positions, by name; antennas are replaced where they are found to be elsewhere.
        velocities: sensors of velocity, by name.
        odometries: that have measured meanwhile.

    Attributes:
        may_be_moved: whether antennas may be elsewhere than they are believed to be.
    """

    def __init__(
        self,
        buffer: ImuBuffer,
        noise: ImuNoise,
        points: dict[str, Any],
        velocities: Mapping[str, VelocitySensor],
        odometries: OdometryTracks,
    ) -> None:
        self._points, self._odometries, self._measured = points, odometries, dict(points)
        self._freed: dict[str, Any] = {}
        self.put_back_antennas()
        receivers = {name for name, one in points.items() if is_gnss(one)}
        is_known = any(points[name].offset_sigma_s == 0.0 for name in receivers)
        self._by_gnss_clock = frozenset() if is_known or not receivers else receivers | velocities.keys()
        self.ask_for_clock()
        self._aligner = BatchAligner(Problems(buffer, noise, points, velocities))
        self._of_freed = BatchAligner(Problems(buffer, noise, self._freed, velocities))

    def settle_arms(self) -> None:
        """Know that the lever arms of antennas are as they were measured, for good: they are constants."""
        self.may_be_moved = False

    def ask_for_clock(self) -> None:
        """Know no more whether the clock of GNSS is far off."""
        self._is_clock_told, self._asked_ns = not self._by_gnss_clock, 0

    def put_back_antennas(self) -> None:
        """Know no more that antennas are elsewhere than they were believed to be at first, nor that they are there."""
        self.may_be_moved = any(is_measured(one) for one in self._measured.values())
        for name, point in self._measured.items():
            self._points[name], self._freed[name] = point, _freed(point) if is_measured(point) else point

    def move_antennas(self, shift: Parameter) -> None:
        """Know from now on that antennas are elsewhere than they were believed to be, in `points`, too."""
        for name, point in self._points.items():
            if isinstance(point, GnssModel):
                self._points[name] = point.with_arm(shift)
                self._freed[name] = _freed(self._points[name])

    def solve(
        self,
        evidence: Evidence,
        prior: BiasPrior,
        max_heading_sigma_rad: float,
        jump_sigmas: Array | None,
        late_s: float | None = 0.0,
    ) -> FittingBatch:
        """Solve the batch of some evidence and the motions of odometries; leave out who is at odds, if it fits then.

        Args:
            evidence: without motions.
            prior: of the biases.
            max_heading_sigma_rad: what is wanted.
            jump_sigmas: (6,) by how much the biases may have jumped; None: not.
            late_s: by how much stamps of GNSS are behind the IMU when they arrive, where their clock may be off: if
                biases may have jumped, or by as much as that, if it is much; None: it is not.
        """

        def solved(evidence: Evidence) -> Alignment:
            return self._aligner.solve(evidence, prior, max_heading_sigma_rad, jump_sigmas)

        whole = self._with_motions(evidence)
        alignment = solved(whole)
        is_at_odds = not alignment.fits
        if late_s is not None:
            seek = self._as_it_arrives if jump_sigmas is None else self._with_clock
            if (clocked := seek(evidence, prior, max_heading_sigma_rad, alignment, late_s)) is not None:
                return clocked
        if is_at_odds and (purged := self._without_strays(whole, alignment, solved)) is not None:
            return purged
        if is_at_odds:
            renamed = self.with_exchanged_antennas(evidence, prior, max_heading_sigma_rad, alignment)
            if renamed is not None:
                return renamed
            moved = self.with_moved_antennas(evidence, prior, max_heading_sigma_rad, jump_sigmas)
            if moved is not None:
                return moved
        found = FittingBatch(alignment, whole)
        for names in self._doubtful(whole, alignment):
            fewer = self._without(whole, names)
            if (count := len({one.stamp_ns for one in fewer.positions})) < MIN_POSITIONS:
                continue
            other = solved(fewer)
            fits_better = other.misfit <= FITS or _evidence(alignment, other, fewer) >= JUMPED
            is_better = len(fewer.positions) == len(whole.positions) or fits_better
            if is_better and other.excess <= (DOUBTFUL if fewer.motions else FITS):
                return FittingBatch(other, fewer, names)
            if names <= self._points.keys() and (purged := self._without_strays(fewer, other, solved)) is not None:
                return purged._replace(left_out=names)
            if found.alignment.is_contradictory and other.state is None and other.excess <= FITS:
                found = FittingBatch(other, fewer, names)  # it tells what is missing
            is_told_by_odometry = whole.motions and not fewer.motions and other.is_unsolved
            if is_told_by_odometry and alignment.excess > FITS and count < TELLING:
                found = FittingBatch(replace(alignment, state=None, reason=AT_ODDS), whole)
        return found

    def _without_strays(
        self, evidence: Evidence, alignment: Alignment, solved: Callable[[Evidence], Alignment]
    ) -> FittingBatch | None:
        """Return the batch without a few positions that are elsewhere, if nothing of what is left is at odds.

        The newest are none of them: what came last may be the first that is right.
        """
        fewer, other = evidence, alignment
        for _ in range(STRAYS):
            newest_ns = max(one.stamp_ns for one in fewer.positions)
            if other.worst is None or other.worst.stamp_ns > newest_ns - BUCKET_NS:
                return None
            positions = [one for one in fewer.positions if one is not other.worst]
            if len({one.stamp_ns for one in positions}) < MIN_POSITIONS:
                return None
            fewer = self._of_positions(positions, fewer)
            other = solved(fewer)
            if other.fits and _evidence(alignment, other, fewer) >= JUMPED:
                return FittingBatch(other, fewer)
        return None

    def _with_clock(
        self, evidence: Evidence, prior: BiasPrior, max_heading_sigma_rad: float, alignment: Alignment, late_s: float
    ) -> FittingBatch | None:
        """Return the batch with GNSS by another clock, if nothing else makes it fit; as it is where nobody can tell.

        `alignment` is that of the whole, in which biases may have jumped; None where that fits.
        """
        is_amiss = alignment.has_jumped or not alignment.fits
        if not is_amiss or not self._by_gnss_clock or len({one.stamp_ns for one in evidence.positions}) < TELLING:
            return None
        origins = [0.0, late_s] if abs(late_s) > REACH_S else [0.0]
        offset, solved = self._by_other_clocks(evidence, prior, max_heading_sigma_rad, origins)
        if offset is None or not offset.is_off:
            return None
        clocked, as_stamped = solved[offset.by_s], solved[0.0]
        if not clocked.alignment.fits:
            return None
        in_time = kept(evidence, clocked.evidence, self._by_gnss_clock, offset.by_s)
        others = (self._with_motions(one) for one in (Evidence(evidence.positions, ()), in_time))
        rivals = [as_stamped.alignment, *(self._aligner.solve(one, prior, max_heading_sigma_rad) for one in others)]
        if any(one.is_vague or _evidence(one, clocked.alignment, clocked.evidence) < JUMPED for one in rivals):
            return None
        better = _evidence(alignment, clocked.alignment, clocked.evidence) if alignment.has_jumped else JUMPED
        if better < -CLEARLY:
            return None
        return clocked._replace(clock=offset) if better > CLEARLY else as_stamped

    def _as_it_arrives(
        self, evidence: Evidence, prior: BiasPrior, max_heading_sigma_rad: float, alignment: Alignment, late_s: float
    ) -> FittingBatch | None:
        """Return the batch with GNSS by a clock by which it comes at once, if it is that and not late.

        None if it is late; a batch without a state where nobody can tell. Arguments as of `_with_clock`.
        """
        if abs(late_s) < REACH_S or self._is_clock_told:
            return None
        newest_ns = evidence.positions[-1].stamp_ns
        self._asked_ns = self._asked_ns or newest_ns
        if newest_ns - self._asked_ns > PATIENCE_NS:
            return None
        way = "late, or by a clock that is behind" if late_s > 0.0 else "by a clock that is ahead, or the IMU is late"
        reason = f"GNSS is {abs(late_s):.1f} s {way}: the motion so far does not tell"
        waiting = FittingBatch(replace(alignment, state=None, reason=reason), evidence)
        offset, solved = self._by_other_clocks(evidence, prior, max_heading_sigma_rad, [late_s])
        if not solved:
            return waiting
        by_s, other = min(solved.items(), key=lambda one: (_misfit(one[1].alignment), one[1].alignment.excess))
        if other.alignment.is_contradictory or DOUBTFUL < other.alignment.excess < inf:  # nor is it by this clock
            return None
        better = -CLEARLY
        if abs(by_s - late_s) < abs(by_s):  # nearer to when it came than to its stamps
            in_time = self._with_motions(kept(evidence, other.evidence, self._by_gnss_clock, by_s))
            as_stamped = self._aligner.solve(in_time, prior, max_heading_sigma_rad)
            if other.alignment.is_unsolved or as_stamped.is_unsolved:
                return waiting
            better = _evidence(as_stamped, other.alignment, other.evidence, attrgetter("excess"))
        is_off = better >= JUMPED and other.alignment.fits and offset is not None and offset.is_off
        self._is_clock_told = is_off or better <= -CLEARLY
        if not self._is_clock_told:
            return waiting
        return other._replace(clock=offset) if is_off else None

    def _by_other_clocks(
        self, evidence: Evidence, prior: BiasPrior, max_heading_sigma_rad: float, origins_s: Sequence[float]
    ) -> tuple[Offset | None, dict[float, FittingBatch]]:
        """Return the offset of the clock of GNSS about some with which the batch fits best, and all that were tried."""
        solved: dict[float, FittingBatch] = {}

        def misfit(by_s: float) -> float:
            moved = restamped(evidence, self._by_gnss_clock, by_s)
            if moved is None:
                return inf
            whole = self._with_motions(moved)
            solved[by_s] = FittingBatch(self._aligner.solve(whole, prior, max_heading_sigma_rad), whole)
            return _misfit(solved[by_s].alignment)

        return offset_of(misfit, evidence.freedom, origins_s), solved

    def with_exchanged_antennas(
        self, evidence: Evidence, prior: BiasPrior, max_heading_sigma_rad: float, alignment: Alignment | None = None
    ) -> FittingBatch | None:
        """Return the batch with two antennas' positions by each other's name, if nothing else makes it fit.

        Antennas that are all elsewhere, as far beside the IMU on its other side, look nearly the same: what explains
        more is chosen. `alignment` is that of the whole, as it is named. Other arguments as of `solve`.
        """
        as_named = self._with_motions(evidence)
        antennas = sorted({one.sensor for one in evidence.positions if is_gnss(self._points[one.sensor])})
        for pair in combinations(antennas, 2):
            whole = self._with_motions(evidence._replace(positions=exchanged(evidence.positions, pair)))
            renamed = self._aligner.solve(whole, prior, max_heading_sigma_rad)
            if not renamed.fits:
                continue
            without = self._with_motions(Evidence(evidence.positions, ()))
            rivals = [self._aligner.solve(without, prior, max_heading_sigma_rad)]
            rivals.append(alignment or self._aligner.solve(as_named, prior, max_heading_sigma_rad))
            if any(one.is_vague or _evidence(one, renamed, whole) < JUMPED for one in rivals):
                continue
            freed = self._of_freed.solve(as_named, prior, max_heading_sigma_rad) if self.may_be_moved else None
            if freed is None or _evidence(freed, renamed, whole) >= 0.0:
                return FittingBatch(renamed, whole, exchanged=pair)
        return None

    def with_moved_antennas(
        self, evidence: Evidence, prior: BiasPrior, max_heading_sigma_rad: float, jump_sigmas: Array | None
    ) -> FittingBatch | None:
        """Return the batch with antennas that are elsewhere than configured, if nothing else makes it fit.

        Velocities that are wrong would, too, a clock, or biases that have jumped: it is compared with what is left
        without velocities, with positions that are so much younger, and with a jump. Arguments as of `solve`.
        """
        if not self.may_be_moved:
            return None
        whole = self._with_motions(evidence)
        freed = self._of_freed.solve(whole, prior, max_heading_sigma_rad)
        shift = _shift(freed)
        if shift is None:
            return None
        without, late = Evidence(evidence.positions, ()), _younger(evidence, freed.clock_s)
        rivals: list[tuple[Evidence, Array | None]] = [
            (whole, None),
            (self._with_motions(without), None),
            (self._with_motions(late), None),
        ]
        if jump_sigmas is not None:
            rivals.append((whole, jump_sigmas))
        for rival, jump in rivals:
            if _evidence(self._aligner.solve(rival, prior, max_heading_sigma_rad, jump), freed, whole) < JUMPED:
                return None
        return FittingBatch(freed, whole, shift=shift)

    def _with_motions(self, evidence: Evidence) -> Evidence:
        """Return the evidence with the motions of odometries between its stamps."""
        return evidence._replace(motions=self._odometries.factors(evidence.stamps))

    def _doubtful(self, evidence: Evidence, alignment: Alignment) -> list[frozenset[str]]:
        """Return what may be left out of a batch that does not fit: receivers, one odometry of several, or all."""
        receivers = {one.sensor for one in evidence.positions}
        placed = frozenset(name for name in receivers if not is_gnss(self._points[name]))
        placed = placed if len(placed) < len(receivers) else frozenset()
        if alignment.excess <= DOUBTFUL:
            return [placed] if placed and alignment.misfit > FITS else []
        names = frozenset(self._odometries.names) if evidence.motions else frozenset[str]()
        singles = [frozenset({name}) for name in sorted(names)] if len(names) > 1 else []
        return [one for one in (placed, *singles, names, placed | names) if one]

    def _without(self, evidence: Evidence, names: Collection[str]) -> Evidence:
        """Return the evidence without some odometries and receivers."""
        return self._of_positions([one for one in evidence.positions if one.sensor not in names], evidence, names)

    def _of_positions(self, positions: Sequence[Position], evidence: Evidence, names: Collection[str] = ()) -> Evidence:
        """Return the evidence with these of its positions alone, without some odometries."""
        velocities = [one for one in evidence.velocities if one.stamp_ns >= positions[0].stamp_ns]
        fewer = Evidence(positions, velocities)
        return fewer._replace(motions=self._odometries.factors(fewer.stamps, names) if evidence.motions else ())


def _freed(antenna: GnssModel) -> GnssModel:
    """Return an antenna whose lever arm nothing holds."""
    return antenna.with_arm(doubtful_arm(np.full(3, FREED_M), GNSS_ARM))


def _shift(freed: Alignment) -> Parameter | None:
    """Return by how much antennas are elsewhere than configured, if they are and the batch in which they may be fits.

    What motions do not tell stays where it is configured.
    """
    if freed.state is None or not freed.fits:
        return None
    mean, covariance = freed.arms[GNSS_ARM]
    sigmas = np.sqrt(covariance.diagonal())
    is_told = sigmas <= TOLD_M
    if not (is_told & (np.abs(mean) > MOVED * np.hypot(sigmas, IF_RIGHT_M))).any():
        return None
    shift = doubtful_arm(np.where(is_told, sigmas, IF_RIGHT_M), GNSS_ARM)
    return shift._replace(mean=np.where(is_told, mean, 0.0))


def _younger(evidence: Evidence, by_s: float) -> Evidence:
    """Return the evidence with positions that are younger, as far as a clock can be off, within the same time."""
    receivers = {one.sensor for one in evidence.positions}
    return restamped(evidence, receivers, float(np.clip(by_s, -MOST_LATE_S, MOST_LATE_S))) or evidence


def _misfit(alignment: Alignment) -> float:
    """Return the squared residuals over what is claimed, or of positions or velocities alone if these vary by more."""
    return alignment.misfit if alignment.misfit > 1.0 else alignment.excess


def _evidence(
    before: Alignment, after: Alignment, evidence: Evidence, measure: Callable[[Alignment], float] = _misfit
) -> float:
    """Return twice the logarithm of how many times likelier other constants make what was measured: as (85)."""
    n = evidence.freedom
    of_before, of_after = (min(measure(one), MAX_EXCESS) * n + CLAIMED_DEGREES for one in (before, after))
    return n * log(of_before / of_after)
