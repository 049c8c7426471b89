"""Whether two antennas are as far apart as their lever arms say; if they are not, one of the two arms is wrong.

Lever arms are constants: the first seconds of good fixes settle for good whether they are right. The distance tells
that one is wrong, not which, nor in which direction: an error e across a baseline of length b changes its length by
e^2 / 2b only, and its direction, which is the heading, by e / b.
"""

from collections import deque
from collections.abc import Collection, Mapping, Set
from enum import Enum
from itertools import combinations
from math import atan2, exp, hypot, inf, radians, sqrt
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.messages import Array
from holdfast.sensors.gnss import GnssModel
from holdfast.sensors.heading import HeadingModel
from holdfast.sensors.lever_arm import doubtful_arm
from holdfast.sensors.noise import correlation_inflation
from holdfast.sensors.sensor import Position, PositionSensor, Role, Sensor, of_role
from holdfast.state import OptimisedState

MEMORY_S = 10.0
DECIDED_AFTER_S = 5.0
MAX_INTERVAL_S = 1.0  # that counts between two pairs of fixes
SLACK_M = 0.03  # two mounts, each measured within 2 cm
SIGMA = 4.0
LARGE_M = 0.5  # a gross error in measuring an arm
KNOWN_M = 0.01  # sigma of a mean that can show two arms to be right
MAX_ROTATION_SIGMA_RAD = radians(60.0)
PAIRED_NS = 1_000_000  # in which even a fast machine moves by less than a fix is wrong
RIGHT_IN_A_ROW = 3  # distances, which no arm that is off by twice what may be seen shows
MEAN_OF = 10  # distances, which shows an arm that is off by more than two mounts may be
SAME_M, SAME_IN_A_ROW = 1e-3, 5  # two receivers of their own never agree so well so often


class Belief(Enum):
    """What a pair of antennas has shown of its lever arms."""

    OPEN = 0
    WRONG = 1
    RIGHT = 2


def are_the_same(one: Position, other: Position) -> bool:
    """Whether two simultaneous positions are at one place, as if one receiver repeated the other: no direction."""
    return float(np.linalg.norm(other.p_W_P - one.p_W_P)) < SAME_M


def variance_along(vector: Array, covariance: Array) -> float:
    """Return the variance [m^2] along a vector (3,) [m], or the largest of all (3, 3) if it has no direction."""
    length_m = float(np.linalg.norm(vector))
    if length_m < SAME_M:
        return float(np.linalg.eigvalsh(covariance)[-1])
    axis = vector / length_m
    return float(axis @ covariance @ axis)


class Length(NamedTuple):
    """How long a mean vector is, and what may have made it so.

    Attributes:
        m: the length.
        sigma_m: of it.
        lengthened_m: by how much noise across it may lengthen it.
        shortened_m: by how much it is shorter than the vectors, which point in more directions than their noise tells:
            an attitude that was wrong and is mended turns what is far apart enough.
    """

    m: float
    sigma_m: float
    lengthened_m: float
    shortened_m: float

    def excess_m(self, mounted_m: float) -> float:
        """Return by how much it differs from another length beyond all that; negative if it does not."""
        return max(self.m - mounted_m - self.lengthened_m, mounted_m - self.m - self.shortened_m) - SLACK_M


class MeanBaseline:
    """Mean of the vector (3,) [m] between two antennas in I over the last seconds, weighed by information: (49)."""

    def __init__(self) -> None:
        self._weight = 0.0
        self._sum, self._squares, self._claims = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        self._last_ns: int | None = None
        self.seen_s = self.newest_m = self.newest_sigma_m = 0.0

    def add(self, between_I: Array, covariance_I: Array, stamp_ns: int, correlation_s: float) -> None:
        """Take in a vector (3,) between simultaneous fixes with its covariance (3, 3), in I."""
        since_s = MAX_INTERVAL_S if self._last_ns is None else abs(stamp_ns - self._last_ns) * 1e-9
        if self._last_ns is not None:
            self.seen_s += min(since_s, MAX_INTERVAL_S)
        variance = variance_along(between_I, covariance_I)
        self._last_ns, self.newest_m, self.newest_sigma_m = stamp_ns, float(np.linalg.norm(between_I)), sqrt(variance)
        weight = 1.0 / (correlation_inflation(correlation_s, min(since_s, MAX_INTERVAL_S)) * variance)
        kept = exp(-since_s / MEMORY_S)
        self._weight = kept * self._weight + weight
        self._sum = kept * self._sum + weight * between_I
        self._squares = kept * self._squares + weight * np.outer(between_I, between_I)
        self._claims = kept * self._claims + weight * covariance_I

    def length(self) -> Length:
        """Return the length of the mean; noise is what the fixes claim, or what they show if that is more."""
        mean = self._sum / self._weight
        length_m = float(np.linalg.norm(mean))
        claimed, shown = self._claims / self._weight, self._squares / self._weight - np.outer(mean, mean)
        along, shown_along = variance_along(mean, claimed), variance_along(mean, shown)
        across, shown_across = float(np.trace(claimed)) - along, float(np.trace(shown)) - shown_along
        across_m = sqrt(max(across, shown_across, 0.0) / along / self._weight)
        turned_m = sqrt(max(shown_across - across, 0.0))
        return Length(
            length_m,
            sqrt(max(1.0, shown_along / along) / self._weight),
            hypot(length_m, across_m) - length_m,  # across^2 / 2 length, of a long one
            hypot(length_m, turned_m) - length_m,
        )


class Pair:
    """Two antennas: how far apart they are mounted, how far they are, and what that says: (50) in docs/math.md."""

    def __init__(self, mounted_m: float) -> None:
        self.mounted_m = self.distance_m = mounted_m
        self.belief = Belief.OPEN
        self.mean = MeanBaseline()
        self._same_in_a_row = self._right_in_a_row = 0
        self._newest_within_m = inf  # how far a distance that is right may be off, of the newest
        self._off_m: deque[float] = deque(maxlen=MEAN_OF)
        self._right_within_m = inf  # and of several in a row that were right: arms do not change

    def note(self, one: Position, other: Position, attitude: gtsam.Rot3) -> None:
        """Take in two simultaneous positions of a machine of some attitude, whose heading may be wrong."""
        R = attitude.matrix()
        correlation_s = max(one.correlation_s, other.correlation_s)
        covariance_I = R.T @ (one.covariance + other.covariance) @ R
        self.mean.add(R.T @ (other.p_W_P - one.p_W_P), covariance_I, one.stamp_ns, correlation_s)
        within_m = self._newest_within_m = SIGMA * self.mean.newest_sigma_m + SLACK_M
        is_right = abs(self.mean.newest_m - self.mounted_m) < within_m
        self._right_in_a_row = self._right_in_a_row + 1 if is_right else 0
        if self._right_in_a_row >= RIGHT_IN_A_ROW:
            self._right_within_m = min(self._right_within_m, within_m)
        self._off_m.append(self.mean.newest_m - self.mounted_m)
        is_exact = len(self._off_m) == MEAN_OF and abs(np.mean(self._off_m)) < 0.5 * SLACK_M
        if is_exact and self.mean.newest_sigma_m < SLACK_M:
            self._right_within_m = 0.5 * SLACK_M

    def counts_as_same(self, one: Position, other: Position) -> bool:
        """Count simultaneous positions at one place in a row; say whether these two are, whatever the attitude is."""
        is_same = are_the_same(one, other)
        self._same_in_a_row = self._same_in_a_row + 1 if is_same else 0
        return is_same

    @property
    def is_one_receiver(self) -> bool:
        """Whether the belief is wrong because both report one position: which antenna it is of, nobody knows."""
        return self.belief is Belief.WRONG and self.distance_m < SAME_M

    @property
    def across_m(self) -> float:
        """How far an arm is off if it is off across the baseline: the most that a rotation follows from."""
        return sqrt(abs(self.distance_m**2 - self.mounted_m**2))

    @property
    def arm_sigma_m(self) -> float:
        """How far an arm may be off: across as a rule, along where that would be a large error for a tape measure."""
        return max(abs(self.distance_m - self.mounted_m), min(self.across_m, LARGE_M))

    def review(self) -> bool:
        """Say whether the belief in the arms has changed."""
        if self.belief is Belief.OPEN and self._same_in_a_row >= SAME_IN_A_ROW:
            self.belief, self.distance_m = Belief.WRONG, 0.0
            return True
        if self.belief is Belief.RIGHT or self.mean.seen_s < DECIDED_AFTER_S:
            return False
        length, newest_m = self.mean.length(), self.mean.newest_m
        excess_m = length.excess_m(self.mounted_m)
        is_wrong = excess_m > SIGMA * length.sigma_m and abs(length.m - self.mounted_m) < 2.0 * self._right_within_m
        # a lie that has just ended is none now, and one that grows is no arm
        is_still = abs(newest_m - length.m) < min(abs(newest_m - self.mounted_m), self._newest_within_m)
        if self.belief is Belief.OPEN and is_wrong and is_still:
            self.belief, self.distance_m = Belief.WRONG, length.m
            return True
        if max(length.sigma_m / KNOWN_M, length.shortened_m / SLACK_M) <= 1.0 and excess_m <= 0.0:
            self.belief, self.distance_m = Belief.RIGHT, self.mounted_m
            return True
        return False


class LeverArms:
    """The belief in the lever arms of all antennas, from one start over to the next; it survives a beginning anew.

    Args:
        sensors: all models, by name.
    """

    def __init__(self, sensors: Mapping[str, Sensor]) -> None:
        receivers: dict[str, PositionSensor] = of_role(sensors, Role.POSITION)
        self._antennas = {name for name, one in receivers.items() if isinstance(one, GnssModel)}
        self._pairs = {
            (a, b): Pair(float(np.linalg.norm(receivers[b].p_I_P - receivers[a].p_I_P)))
            for a, b in combinations(receivers, 2)
        }
        self._newest: dict[str, Position] = {}  # of each antenna, as it arrived

    def distance_m(self, one: str, other: str) -> float:
        """Return how far apart two receivers are: as mounted, or as measured if their arms are in doubt."""
        return self._pair(one, other).distance_m

    def _pair(self, one: str, other: str) -> Pair:
        return self._pairs[(one, other) if (one, other) in self._pairs else (other, one)]

    def repeats(self, position: Position) -> bool:
        """Take in a position as it arrives; say whether it is that of another receiver once more.

        It is where the two have reported the same before, so often that they are one.
        """
        if position.sensor not in self._antennas:
            return False
        self._newest[position.sensor] = position
        is_repeated = False
        for other in self._newest.values():
            if other is not position and abs(other.stamp_ns - position.stamp_ns) <= PAIRED_NS:
                pair = self._pair(position.sensor, other.sensor)
                is_repeated |= pair.counts_as_same(position, other) and pair.is_one_receiver
        return is_repeated

    def note(self, one: Position, other: Position, attitude: gtsam.Rot3) -> None:
        """Take in two simultaneous positions of a machine of some attitude, whose heading may be wrong."""
        if (one.sensor, other.sensor) not in self._pairs:
            one, other = other, one
        pair = self._pairs[one.sensor, other.sensor]
        if pair.belief is Belief.RIGHT or not self._antennas >= {one.sensor, other.sensor}:
            return  # the grid of a prism may lie elsewhere: that is no arm
        pair.note(one, other, attitude)

    def forget_means(self, names: Collection[str]) -> None:
        """Forget what was measured between some antennas and others, which were not where it seemed."""
        for both, pair in self._pairs.items():
            if not set(names).isdisjoint(both):
                pair.mean = MeanBaseline()

    def review(self, now_ns: int, log: EventLog) -> bool:
        """Report what is new; say whether other arms are in doubt than before."""
        before = self.doubts()
        for (one, other), pair in self._pairs.items():
            was_wrong = pair.belief is Belief.WRONG
            if not pair.review() or (pair.belief is Belief.RIGHT and not was_wrong):
                continue
            if was_wrong:
                reason = f"the antennas are {pair.mounted_m:.2f} m apart after all, as the configuration says"
            elif pair.is_one_receiver:
                reason = (
                    f"both receivers report the same position, the configuration says {pair.mounted_m:.2f} m apart: "
                    f"do the topics of {one} and {other} come from one antenna?"
                )
            else:
                reason = (
                    f"the antennas are {pair.distance_m:.2f} m apart, the configuration says {pair.mounted_m:.2f} m: "
                    f"the translation of the frame of {one} or {other} is wrong"
                )
            log.report(EventKind.LEVER_ARM, now_ns, f"{one}, {other}", reason)
        return self.doubts().keys() != before.keys()

    def doubts(self) -> dict[str, float]:
        """Return the antennas that may be the wrong ones, and how far their arms may be off [m]."""
        wrong = {
            names: pair
            for names, pair in self._pairs.items()
            if pair.belief is Belief.WRONG and pair.arm_sigma_m >= SAME_M  # not two receivers on one mount
        }
        right = {name for names, pair in self._pairs.items() if pair.belief is Belief.RIGHT for name in names}
        found: dict[str, float] = {}
        for names, pair in wrong.items():
            for name in [name for name in names if name not in right] or names:
                found[name] = max(pair.arm_sigma_m, found.get(name, 0.0))
        return found

    def believed(self, sensors: Mapping[str, Sensor]) -> dict[str, Sensor]:
        """Return the models, with arms that are in doubt as constants to be estimated, without headings from them.

        Two receivers that report one position say nothing against the mounts: a heading of the antennas is kept.
        """
        doubts = self.doubts()
        wrong = {names for names, pair in self._pairs.items() if pair.belief is Belief.WRONG}
        misplaced = {
            name for names in wrong if not self._pairs[names].is_one_receiver for name in names
        } & doubts.keys()
        return {name: _believed(sensor, doubts, misplaced) for name, sensor in sensors.items()}

    def doubtful(self, state: OptimisedState, accelerometer_bias_sigma: float) -> OptimisedState:
        """Return a state that rests on arms in doubt, with a covariance that says so: (51) in docs/math.md.

        Two fixes on wrong arms pull at heading and tilt alike, and at the bias [m/s^2] that stands against the tilt.
        """
        doubts = self.doubts()
        if not doubts:
            return state
        arm_m = max(doubts.values())
        turned_rad = [
            atan2(pair.across_m, pair.mounted_m)
            for pair in self._pairs.values()
            if pair.belief is Belief.WRONG and not pair.is_one_receiver  # positions that agree do not turn a machine
        ]
        rotation_rad = min(max(turned_rad, default=0.0), MAX_ROTATION_SIGMA_RAD)
        covariance = state.covariance.copy()
        covariance[:3, :3] += rotation_rad**2 * np.eye(3)
        covariance[3:6, 3:6] += arm_m**2 * np.eye(3)
        covariance[9:12, 9:12] += accelerometer_bias_sigma**2 * np.eye(3)
        return OptimisedState(state.stamp_ns, state.nav, state.bias, covariance, state.angular_velocity)


def _believed(sensor: Sensor, doubts: Mapping[str, float], misplaced: Set[str]) -> Sensor:
    if isinstance(sensor, GnssModel) and sensor.name in doubts:
        return sensor.with_arm(doubtful_arm(np.full(3, doubts[sensor.name])))
    if isinstance(sensor, HeadingModel) and not misplaced.isdisjoint(sensor.antennas):
        return sensor.without_axis()
    return sensor
