"""Whether velocities lead where positions do, without an estimate: (81), (82), (83) in docs/math.md.

A receiver whose velocities are in other axes, late, of another sign or always zero claims no less than a good one.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from math import sqrt
from typing import NamedTuple, Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from holdfast.estimator.course import UNKNOWN_VARIANCE
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.sensor import Position, Velocity

# of the way, and of the noise of two positions: in 316 pieces of five drives good receivers missed half of it at most
ELSEWHERE, ELSEWHERE_SIGMA = 0.1, 3.0
BESIDE_M = 0.5  # so near are a receiver and a sensor of velocity that go the same way
PROVEN_ELSEWHERE = 0.03  # of the way, by which velocities that have proven right may miss
PIECE_NS = 5_000_000_000  # in which the past is looked at
LAGS_S = np.linspace(-1.5, 1.5, 13)
OTHERWISE = np.array([[[-1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0], [1.0, 0.0]]])  # of the other sign; north, east
HARMLESS_S, STEP_S, MIN_STEPS = 0.4, 0.9, 8
# of what is left of steps at the best, squared: in 102 stretches of 30 s of eight drives it is 1.4 at most
WORSE, MIN_MISSED_M = 4.0, 0.3


class Company(Enum):
    """How positions go beside where velocities lead."""

    UNKNOWN = "the way is so short that noise explains it"
    BESIDE = "there"
    ASTRAY = "somewhere they are farther from there than their noise explains"


class Mounted(Protocol):
    """A sensor at a point of the machine, (3,) [m] in the frame of the IMU."""

    p_I_P: Array


class VelocityCheck:
    """Knows the sensors of velocity that lead elsewhere than the positions.

    Both are given as they were collected. Velocities are compared with the positions of receivers at the same point of
    the machine: opposite antennas of a cabin that slews go opposite ways.

    Args:
        receivers: of positions, by name.
        sensors: of velocities, by name.

    Attributes:
        lying: names of the sensors; those that disagree with positions may be right, and are left out of starts alone.
        mistaken: those of them that are late, of another sign or in other axes, which no error of positions explains.
        proven: names of those that have led where the positions do.
    """

    def __init__(self, receivers: Mapping[str, Mounted], sensors: Mapping[str, Mounted]) -> None:
        self.lying: set[str] = set()
        self.mistaken: set[str] = set()
        self.proven: set[str] = set()
        self._receivers = receivers
        self._beside = [
            (name, receiver)
            for name, sensor in sensors.items()
            for receiver, at in receivers.items()
            if np.linalg.norm(sensor.p_I_P - at.p_I_P) < BESIDE_M
        ]
        self._reviewed_ns = NEVER_NS

    def look_back(self, velocities: Collection[Velocity], positions: Collection[Position]) -> None:
        """Leave out what leads elsewhere than the positions of a receiver in a piece of the past, or errs otherwise."""
        for name, series, track in self._pairs(velocities, positions):
            if any(_leads_elsewhere(inside, piece) for inside, piece in _pieces(series, track)):
                self.lying.add(name)
            self._compare(name, series, track)

    def review(self, velocities: Collection[Velocity], positions: Collection[Position], now_ns: int) -> None:
        """Every few seconds believe what leads where the positions do; leave out what errs."""
        if now_ns - self._reviewed_ns <= PIECE_NS:
            return
        self._reviewed_ns = now_ns
        for name, series, track in self._pairs(velocities, positions):
            self._compare(name, series, track)
            if name not in self.lying and _company(series, track) is Company.BESIDE:
                self.proven.add(name)

    def _compare(self, name: str, velocities: Sequence[Velocity], positions: Sequence[Position]) -> None:
        """Accuse a sensor that fits much better otherwise, and believe one that fits much worse."""
        fit = _fit(velocities, positions)
        if fit is Fit.OTHERWISE:
            self.lying.add(name)
            self.mistaken.add(name)
            self.proven.discard(name)
        elif fit is Fit.AS_IT_IS:
            self.lying.discard(name)
            self.mistaken.discard(name)
            self.proven.add(name)

    def confirms(
        self, witnesses: Iterable[Velocity], positions: Collection[Position], since_ns: int, estimate: gtsam.NavState
    ) -> bool:
        """Whether velocities that are believed lead from before a time to the newest position, not to an estimate."""
        believed = [one for one in witnesses if one.sensor not in self.lying]
        for _, series, track in self._pairs(believed, positions, since_ns - PIECE_NS):
            there = estimate.pose().transformFrom(self._receivers[track[-1].sensor].p_I_P)
            led, off_m = _where(series, track), float(np.linalg.norm(track[-1].p_W_P - there))
            if led is not None and not led.elsewhere and off_m > led.tolerance_m:
                return True
        return False

    def company(self, witnesses: Iterable[Velocity], positions: Collection[Position], since_ns: int) -> Company:
        """Return how the positions of one receiver go beside velocities that have been proven, from a time on."""
        proven = [one for one in witnesses if one.sensor in self.proven]
        found = {_company(series, track) for _, series, track in self._pairs(proven, positions, since_ns - PIECE_NS)}
        return next((one for one in (Company.ASTRAY, Company.BESIDE) if one in found), Company.UNKNOWN)

    def are_explained(self, velocities: Iterable[Velocity], left_out: Collection[str] = ()) -> bool:
        """Whether all sensors of some velocities have proven right or mistaken; none of the former is left out."""
        return {one.sensor for one in velocities} <= (self.proven - set(left_out)) | self.mistaken

    def erring(self, velocities: Collection[Velocity], positions: Collection[Position]) -> list[str]:
        """Return the sensors whose velocities err, these or earlier ones."""
        found = self.lying & {one.sensor for one in velocities}
        for name, series, track in self._pairs(velocities, positions):
            if _leads_elsewhere(series, track) or _fit(series, track) is Fit.OTHERWISE:
                found.add(name)
        return sorted(found)

    def _pairs(
        self, velocities: Collection[Velocity], positions: Collection[Position], since_ns: int = NEVER_NS
    ) -> Iterator[tuple[str, list[Velocity], list[Position]]]:
        """Yield each sensor of velocity, what it measured and the positions of a receiver beside it, by stamp."""
        for name, receiver in self._beside:
            series = sorted((v for v in velocities if v.sensor == name and v.stamp_ns >= since_ns), key=_stamp_ns)
            track = sorted((p for p in positions if p.sensor == receiver and p.stamp_ns >= since_ns), key=_stamp_ns)
            if series and track:
                yield name, series, track


def _stamp_ns(one: Velocity | Position) -> int:
    return one.stamp_ns


class _Led(NamedTuple):
    """Where the velocities of one sensor led.

    Attributes:
        missed_m: how far from the position at the end.
        tolerance_m: by how much a good one may miss it.
    """

    missed_m: float
    tolerance_m: float

    @property
    def elsewhere(self) -> bool:
        """Whether they led elsewhere."""
        return self.missed_m > self.tolerance_m


def _pieces(
    velocities: Sequence[Velocity], positions: Sequence[Position]
) -> Iterator[tuple[list[Velocity], list[Position]]]:
    """Yield the pieces of the past: what was measured between the first and the last position of each."""
    pieces: dict[int, list[Position]] = {}
    for one in positions:
        pieces.setdefault(one.stamp_ns // PIECE_NS, []).append(one)
    for piece in pieces.values():
        yield [one for one in velocities if piece[0].stamp_ns < one.stamp_ns <= piece[-1].stamp_ns], piece


def _leads_elsewhere(velocities: Sequence[Velocity], positions: Sequence[Position]) -> bool:
    led = _where(velocities, positions)
    return led is not None and led.elsewhere


def _where(velocities: Sequence[Velocity], positions: Sequence[Position]) -> _Led | None:
    """Return where the velocities of one sensor led among the positions of one receiver, if these tell."""
    if len(positions) < 2:
        return None
    stamps_ns = np.array([one.stamp_ns for one in velocities])
    at_ns = np.array([one.stamp_ns for one in positions])
    inside = (stamps_ns >= at_ns[0]) & (stamps_ns <= at_ns[-1])
    if inside.sum() < 2:
        return None
    t = (stamps_ns[inside] - at_ns[0]) * 1e-9
    track = np.array([one.p_W_P for one in positions])
    known = np.max([one.covariance.diagonal() for one in velocities], axis=0) < UNKNOWN_VARIANCE
    speeds = np.array([one.v_W_P for one in velocities])[inside][:, known]
    ends = np.column_stack([np.interp(t[[0, -1]], (at_ns - at_ns[0]) * 1e-9, axis) for axis in track.T])
    moved, led = (ends[1] - ends[0])[known], np.trapezoid(speeds, t, axis=0)
    noise_m = ELSEWHERE_SIGMA * sqrt(sum(float(np.trace(one.covariance)) for one in (positions[0], positions[-1])))
    way_m = max(np.linalg.norm(moved), np.trapezoid(np.linalg.norm(speeds, axis=1), t))
    return _Led(float(np.linalg.norm(moved - led)), noise_m + ELSEWHERE * float(way_m))


class _Way(NamedTuple):
    """What the velocities of one sensor lead to, beside the positions of one receiver.

    Attributes:
        at_s: (N,) times of the positions.
        t: (M,) times of the velocities.
        way: (M, 2) their integral [m].
    """

    at_s: Array
    t: Array
    way: Array

    @classmethod
    def of(cls, velocities: Sequence[Velocity], positions: Sequence[Position]) -> "_Way":
        """Return it from what is sorted by stamp."""
        zero_ns = positions[0].stamp_ns
        at_s, t = (np.array([(one.stamp_ns - zero_ns) * 1e-9 for one in series]) for series in (positions, velocities))
        speeds = np.array([one.v_W_P[:2] for one in velocities])
        moved = np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(t)[:, None], axis=0)
        return cls(at_s, t, np.vstack([np.zeros(2), moved]))

    def led(self, at_s: Array) -> Array:
        """Return the integral (K, 2) at some times."""
        return np.column_stack([np.interp(at_s, self.t, axis) for axis in self.way.T])


def _company(velocities: Sequence[Velocity], positions: Sequence[Position]) -> Company:
    way = _Way.of(velocities, positions)
    inside = (way.at_s >= way.t[0]) & (way.at_s <= way.t[-1])
    if inside.sum() < 2:
        return Company.UNKNOWN
    at_s, track = way.at_s[inside], np.array([one.p_W_P[:2] for one in positions])[inside]
    beside = track - way.led(at_s)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way.way, axis=0), axis=1))])
    length = np.interp(at_s, way.t, length) - np.interp(at_s[0], way.t, length)
    noise = np.array([np.trace(one.covariance[:2, :2]) for one in positions])[inside]
    tolerance = ELSEWHERE_SIGMA * np.sqrt(noise + noise[0]) + PROVEN_ELSEWHERE * length
    if (np.linalg.norm(beside - beside[0], axis=1) > tolerance).any():
        return Company.ASTRAY
    return Company.BESIDE if length[-1] > 2.0 * tolerance[-1] else Company.UNKNOWN


class Fit(Enum):
    """How velocities fit to the steps of positions."""

    UNKNOWN = "nothing tells"
    AS_IT_IS = "much better than they would otherwise"
    OTHERWISE = "much better at another time or in other axes"


def _fit(velocities: Sequence[Velocity], positions: Sequence[Position]) -> Fit:
    """Return how the velocities of one sensor fit to steps of the positions of one receiver.

    Whatever positions and velocities are worth: their noise is left in any case.
    """
    if len(velocities) < MIN_STEPS or len(positions) <= MIN_STEPS:
        return Fit.UNKNOWN
    way = _Way.of(velocities, positions)
    at_s, t = way.at_s, way.t
    inside = [k for k, s in enumerate(at_s) if t[0] - LAGS_S[0] <= s <= t[-1] - LAGS_S[-1]]
    steps: list[int] = []
    for k in inside:
        if not steps or at_s[k] - at_s[steps[-1]] >= STEP_S:
            steps.append(k)
    if len(steps) <= MIN_STEPS:
        return Fit.UNKNOWN
    moved = np.diff(np.array([positions[k].p_W_P[:2] for k in steps]), axis=0)

    def left(lag_s: float) -> NDArray[np.float64]:
        """Return what is left of the steps at a lag: as they are, and otherwise."""
        led = np.diff(way.led(at_s[steps] + lag_s), axis=0)
        return np.array([np.mean(np.sum((moved - one) ** 2, axis=1)) for one in (led, *(led @ OTHERWISE))])

    now, *otherwise = left(0.0)
    best = min(*otherwise, *(left(lag_s)[0] for lag_s in LAGS_S if abs(lag_s) > HARMLESS_S))
    if now > max(WORSE * best, MIN_MISSED_M**2):
        return Fit.OTHERWISE
    return Fit.AS_IT_IS if best > max(WORSE * now, MIN_MISSED_M**2) else Fit.UNKNOWN
