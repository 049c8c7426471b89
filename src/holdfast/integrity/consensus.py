"""Positions of one receiver that agree among themselves, whatever the estimate says.

An estimate that is wrong cannot judge the positions that could mend it. What they say of each other can: the speed
from one to the next is no other than it can become.
"""

from collections import deque
from collections.abc import Sequence
from itertools import dropwhile, takewhile
from math import sqrt
from typing import NamedTuple

import numpy as np

from holdfast.events import Outcome
from holdfast.messages import Array
from holdfast.sensors.sensor import Position

MAX_ACCELERATION_M_S2 = 10.0  # what tyres and tracks hold
SIGMA = 4.0
OUTLIERS = 3  # so many in a row that disagree end a run
COMPARED = 2  # of the newest tell the speed before the next
REFUSED_FRACTION = 0.8  # of the positions in a run: a wrong estimate explains one now and then
WALK_M_S = 0.3  # fixes hardly walk so fast
DEPARTING_NS = 12_000_000_000  # nor for so long
LEAST_NS = 1_000_000_000  # by fewer positions no shape is told
BEFORE_NS = 8_000_000_000  # positions that were right tell of what shape the way is
LEAST = 4  # positions have a shape


def first_of_shape(stamps_ns: Sequence[int], since_ns: int) -> int:
    """Return from which of positions on, sorted by stamp, they tell of what shape the way was about a time."""
    before = sum(stamp_ns < since_ns - BEFORE_NS for stamp_ns in stamps_ns)
    return max(min(before, len(stamps_ns) - LEAST), 0)


def follows(position: Position, before: Sequence[Position]) -> bool:
    """Whether a position is where one or two of the same receiver before may have led, of which the newest is last."""
    *others, last = before
    dt_s = (position.stamp_ns - last.stamp_ns) * 1e-9
    if dt_s <= 0.0:
        return False
    if not others:
        return True
    moved: Array = position.p_W_P - last.p_W_P
    noise_m = SIGMA * sqrt(float(np.trace(position.covariance + last.covariance)))
    before_s = (last.stamp_ns - others[-1].stamp_ns) * 1e-9
    expected = (last.p_W_P - others[-1].p_W_P) / before_s * dt_s
    reach_m = MAX_ACCELERATION_M_S2 * dt_s * 0.5 * (dt_s + before_s)
    return bool(np.linalg.norm(moved - expected) <= reach_m + noise_m * (1.0 + dt_s / before_s))


def agreeing(positions: Sequence[Position]) -> list[Position]:
    """Return the newest of positions of one receiver, sorted by stamp, that agree with each other: no outliers."""
    run: list[Position] = []
    outliers = 0
    for position in positions:
        if not run or follows(position, run[-COMPARED:]):
            run.append(position)
            outliers = 0
            continue
        outliers += 1
        if outliers >= OUTLIERS:
            run, outliers = [], 0
    return run


class Departure(NamedTuple):
    """Positions that the estimate leaves.

    Attributes:
        positions: of one receiver, from before it did.
        since_ns: stamp of the first that was refused.
        by_m: how far it has left the newest [m].
    """

    positions: list[Position]
    since_ns: int
    by_m: float


class _Judged(NamedTuple):
    """A position of a run, by how much (3,) it was beside the estimate in W [m], and whether that refused it."""

    position: Position
    off_W: Array
    is_refused: bool

    @property
    def stamp_ns(self) -> int:
        return self.position.stamp_ns


class Consensus:
    """The run of positions of one receiver that agree with each other, and which of them the estimate refused.

    Args:
        count: so many positions are looked at, or more if there are more in
        duration_s: [s], which may change.
    """

    def __init__(self, count: int, duration_s: float) -> None:
        self._count = count
        self.duration_s = duration_s
        self._newest: deque[Position] = deque(maxlen=COMPARED)
        self._run: deque[_Judged] = deque()
        self._refused = 0  # of them
        self._outliers = self._unexpected = 0
        self._kept_out: list[int] = []  # stamps of the newest that were neither expected nor used: the first two

    def add(self, position: Position, outcome: Outcome, off_W: Array, *, is_expected: bool) -> None:
        """Take in a position, in the order of stamps, and by how much (3,) it is beside the estimate in W [m].

        One that is not expected may be used all the same, or wait.
        """
        is_refused = outcome not in (Outcome.USED, Outcome.QUARANTINED)
        if self._newest and not follows(position, self._newest):
            self._outliers += 1
            if self._outliers >= OUTLIERS:
                self.clear()
            return
        self._outliers = 0
        self._unexpected = 0 if is_expected else self._unexpected + 1
        if is_expected or outcome is Outcome.USED:
            self._kept_out.clear()
        elif len(self._kept_out) < 2:
            self._kept_out.append(position.stamp_ns)
        self._newest.append(position)
        self._run.append(_Judged(position, off_W, is_refused))
        self._refused += is_refused
        since_ns = position.stamp_ns - round(self.duration_s * 1e9)
        while len(self._run) > self._count and self._run[1].stamp_ns <= since_ns:
            self._refused -= self._run.popleft().is_refused

    def contradict(self, position: Position) -> None:
        """Note that a position which was accepted has been taken out again."""
        for k, one in enumerate(self._run):
            if one.stamp_ns == position.stamp_ns:
                self._run[k] = one._replace(is_refused=True)
                self._refused += not one.is_refused

    def clear(self) -> None:
        """End the run."""
        self._newest.clear()
        self._run.clear()
        self._kept_out.clear()
        self._outliers = self._refused = self._unexpected = 0

    def is_against(self) -> bool:
        """Whether the estimate refused most of a run that is long enough."""
        if self._refused < REFUSED_FRACTION * self._count:  # as a rule: it need not be looked at
            return False
        run = self._since_first_refused()
        if len(run) < self._count or run[-1].stamp_ns - run[0].stamp_ns < self.duration_s * 1e9:
            return False
        return sum(one.is_refused for one in run) >= REFUSED_FRACTION * len(run)

    def is_suspicious(self) -> bool:
        """Whether the estimate refused the newest of the run, or has them wait, more than one: too few on their own."""
        if len(self._kept_out) > 1:
            return True
        if self._refused < 2:  # as a rule
            return False
        run = self._since_first_refused()
        return len(run) > 1 and all(one.is_refused for one in run)

    def departure(self) -> Departure | None:
        """Return how the estimate leaves the newest positions, refused one after another, if faster than they walk.

        It must have begun with one that was not refused, or last for long: else they may have jumped.
        """
        if not self._run or not self._run[-1].is_refused:
            return None
        run = list(self._run)
        refused = list(takewhile(lambda one: one.is_refused, reversed(run)))[::-1]
        if len(refused) < 2:
            return None
        last, since_ns = refused[-1], refused[0].stamp_ns
        at = max(len(run) - len(refused) - 1, 0)  # the last that was not refused
        at += max(sum(one.stamp_ns <= last.stamp_ns - DEPARTING_NS for one in run[at:]) - 1, 0)
        first = run[at]
        lasts_ns = last.stamp_ns - first.stamp_ns
        if lasts_ns < (DEPARTING_NS if first.is_refused else LEAST_NS):
            return None
        by_m = float(np.linalg.norm(last.off_W - first.off_W))
        noise_m = SIGMA * sqrt(float(np.trace(first.position.covariance + last.position.covariance)))
        if by_m <= WALK_M_S * lasts_ns * 1e-9 + noise_m:
            return None
        at = min(first_of_shape([one.stamp_ns for one in run], since_ns), at)
        return Departure([one.position for one in run[at:]], since_ns, by_m)

    @property
    def is_unexpected(self) -> bool:
        """Whether the newest of the run, more than one, are not what the estimate expects."""
        return self._unexpected > 1

    @property
    def since_ns(self) -> int:
        """Stamp of the first position of the run that the estimate refused or had wait; there must be one."""
        refused = self._since_first_refused()
        return refused[0].stamp_ns if refused else self._kept_out[0]

    def _since_first_refused(self) -> list[_Judged]:
        return list(dropwhile(lambda one: not one.is_refused, self._run))
