"""What the estimator would start from now, ready for the day on which its state turns out to be wrong.

It collects measurements beside the graphs, and is asked only where positions that agree among themselves contradict
the estimate for long: position, velocity, heading and biases then begin anew, from these positions alone if they tell
the heading, else at the attitude as it is, held in doubt.
"""

from math import cos, degrees, inf, radians
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.estimator.initialisation import Initialising
from holdfast.graph.alignment import FITS, VAGUE_RAD, Jump
from holdfast.graph.first_guess import level_attitude
from holdfast.measured_fields import NEVER_NS
from holdfast.messages import Array
from holdfast.sensors.lever_arm import GNSS_ARM
from holdfast.sensors.sensor import Measurement
from holdfast.state import OptimisedState

AGAIN_NS = 60_000_000_000
CALM_NS = 20_000_000_000  # after which the IMU is doubted less: such a walk is what an outage is lost by
FASTER, MOST_DOUBTS = 10, 3  # the biases walk for each time that what has begun is contradicted within a minute
LOOKED_NS = 30_000_000_000  # whether antennas are elsewhere is looked at this often
TRIED_NS = 500_000_000  # whether the biases have jumped is looked at this often
GROWN = 10.0  # a jump is believed if it is found again with so much more evidence
IN_DOUBT = "the heading in doubt"  # ends the reason of what begins anew once more, as soon as its heading is told
DOUBT_RAD = radians(60.0)  # of a heading that is kept
TURNED_RAD = radians(30.0)  # by which a vague heading is beside the course, at least, to begin anew
TILT_DOUBT_RAD = radians(15.0)
OVERTURNED_RAD = radians(60.0)  # of what the accelerometer feels from the vertical: no machine accelerates so
FELT_NS, FELT_M_S2 = 500_000_000, (5.0, 15.0)  # over which it is asked, and what may be gravity


class Beginning(NamedTuple):
    """A state to begin anew from, and why it is believed."""

    state: OptimisedState
    reason: str


class Successor:
    """Collects, and begins anew.

    Args:
        start: what the estimator has started from, or would.
        is_in_doubt: whether the heading of the estimate is, so that the first that motion tells is better.
    """

    def __init__(self, start: Initialising, *, is_in_doubt: bool = False) -> None:
        self.start = start
        start.found.newly_forgotten()  # before this estimate, which does not rest on it
        self._is_in_doubt = is_in_doubt
        self._begun_ns = self._tried_ns = self._tried_arms_ns = NEVER_NS
        self._suspected: tuple[Jump, int] | None = None  # and stamp of the newest of what it would explain
        self._doubts, self._doubted_ns = 0, NEVER_NS
        self._lying: frozenset[str] = frozenset()  # as of the last contradiction
        self._told: set[str] = set()

    @property
    def is_in_doubt(self) -> bool:
        """Whether the estimate begins anew as soon as a start is told."""
        return self._is_in_doubt

    @property
    def walk_scale(self) -> float:
        """How many times faster than configured the biases of the IMU may walk."""
        return float(FASTER**self._doubts)

    def add(self, measurement: Measurement) -> None:
        """Take in a checked measurement."""
        self.start.add(measurement)

    @property
    def oldest_ns(self) -> int:
        """Samples of the IMU before this time are of no use."""
        return self.start.oldest_ns

    def begin(self, current: OptimisedState, since_ns: int) -> Beginning | None:
        """Return a state to begin anew from, now.

        Args:
            current: the estimate that is contradicted.
            since_ns: stamp from which on it is. If what was measured before does not fit to it, as after a knock that
                turned the mount, or what has begun within a minute is contradicted again, only that counts.
        """
        self.start.check_velocities()
        before, self._lying = self._lying, self.start.lying
        is_explained = bool(self._lying - before)  # by velocities that have led astray
        is_again = current.stamp_ns - self._begun_ns < AGAIN_NS and not is_explained
        is_wrong_again = is_again and not self._is_in_doubt  # an attitude that is in doubt says nothing of the others
        if is_wrong_again:
            self._doubts, self._doubted_ns = min(self._doubts + 1, MOST_DOUBTS), current.stamp_ns
        limit_rad = VAGUE_RAD if self._is_in_doubt else 0.0
        state = None if is_wrong_again else self.start.attempt(may_have_jumped=True, limit_rad=limit_rad)
        has_failed = state is None or self.start.misfit > FITS
        is_untold = self._is_in_doubt and self.start.misfit == inf  # wait on, until the motion tells the heading
        if has_failed and is_again:  # a bias may have jumped
            self.start.biases.doubt()
        if has_failed and not is_untold:
            self.start.forget_before(since_ns)
            state = self.start.attempt()
        self._is_in_doubt = state is None
        if state is not None:
            return self._begun(state)
        moved = self._moved(current, doubt_biases=is_again)
        if moved is None:
            return None
        self._begun_ns = current.stamp_ns
        return Beginning(moved, f"position and velocity of the fixes, {IN_DOUBT}")

    def after_jump(self, now_ns: int, *, has_witness: bool, is_astray: bool = True) -> Beginning | None:
        """Return a state to begin from if the biases have jumped, and what came later says so of the same time.

        Or if it is the clock of GNSS, which what came until now tells by itself, where positions are not as expected.

        What an IMU without a fault leaves unexplained looks like a jump, too, but later like another one. And positions
        that wander do: so velocities that have proven right must say the same, or another witness.
        """
        if now_ns - self._tried_ns < TRIED_NS or not (has_witness or self.start.has_witness):
            return None
        self._tried_ns, clock_ns = now_ns, self.start.clock_ns
        state = self.start.attempt(may_have_jumped=True, may_be_late=is_astray)
        if state is None:
            return None
        if self.start.clock_ns != clock_ns:
            return self._begun(state)
        jump, suspected = self.start.jump, self._suspected
        if jump is None or suspected is None or not jump.is_same(suspected[0]):
            self._suspected = None if jump is None else (jump, state.stamp_ns)
            return None
        before, newest_ns = suspected
        has_grown = state.stamp_ns > newest_ns and jump.evidence - before.evidence >= GROWN
        if not has_grown or not jump.is_believed or self.start.misfit > FITS:
            return None
        self._is_in_doubt = False
        return self._begun(state)

    def with_moved_antennas(self, now_ns: int, *, is_suspected: bool) -> Beginning | None:
        """Return a state to begin from if antennas that are elsewhere than configured explain what was measured.

        It is asked now and then, and more often where positions are refused.
        """
        is_found = GNSS_ARM in self.start.found.priors
        if now_ns - self._tried_arms_ns < (TRIED_NS if is_suspected else LOOKED_NS) or (is_found and not is_suspected):
            return None
        self._tried_arms_ns = now_ns
        state = self.start.attempt_with_moved_antennas()
        return None if state is None else self._begun(state)

    def turned(self, current: OptimisedState) -> Beginning | None:
        """Return a state to begin from if a heading that was vague, as after a gap, is far beside the course.

        Of headings and antennas the graph itself makes what they are worth.
        """
        by_rad = self.start.compass.beside_course(current.stamp_ns, current.nav.attitude())
        if by_rad is None or abs(by_rad) < TURNED_RAD:
            return None
        state = _turned(current, gtsam.Rot3.Yaw(by_rad))
        self._is_in_doubt = True
        state = self._moved(state, doubt_biases=False) or state
        return Beginning(state, f"turned by {degrees(by_rad):.0f} deg to go with the course, {IN_DOUBT}")

    def _begun(self, state: OptimisedState) -> Beginning:
        jump = self.start.jump
        if jump is not None and jump.is_believed:
            self.start.believe_jump(jump, state.bias)
        self._begun_ns, self._suspected = state.stamp_ns, None
        return Beginning(state, self.start.reason)

    def doubt(self) -> None:
        """The estimate has followed a sensor that lies: begin anew as soon as the motion tells the heading."""
        self._is_in_doubt = True

    def newly_mistaken(self) -> set[str]:
        """Return the sensors of velocity that have been found mistaken since this was asked last."""
        before, self._told = self._told, set(self.start.mistaken())
        return self._told - before

    def calm(self, now_ns: int) -> None:
        """Doubt the IMU less if nothing has contradicted it for a while."""
        if self._doubts and now_ns - self._doubted_ns > CALM_NS:
            self._doubts, self._doubted_ns = self._doubts - 1, now_ns

    def settle_doubt(self) -> Beginning | None:
        """Return a state to begin from once more, as soon as the motion tells the heading that was kept in doubt.

        Or where what was found of antennas and clock is believed no more: the estimate rests on it.
        What no state explains has a fault in it that may be over: its older half is forgotten.
        """
        self._is_in_doubt |= self.start.found.newly_forgotten()
        if not self._is_in_doubt:
            return None
        state = self.start.attempt()
        if state is None:
            if self.start.is_contradictory:
                self.start.forget_older_half()
            return None
        self._is_in_doubt = False
        return Beginning(state, f"no longer in doubt: {self.start.reason}")

    def _moved(self, current: OptimisedState, *, doubt_biases: bool) -> OptimisedState | None:
        """Return the estimate with position and velocity of the positions, its attitude in doubt."""
        course = self.start.course(current.stamp_ns)
        if course is None:
            return None
        attitude = self._upright(current)
        R = attitude.matrix()
        covariance = np.zeros((15, 15))
        bias, covariance[9:, 9:] = current.bias, current.covariance[9:, 9:]
        if doubt_biases:
            bias, covariance[9:, 9:] = self.start.biases.prior.bias, np.diag(self.start.biases.prior.sigmas**2)
        covariance[:3, :3] = current.covariance[:3, :3] + _doubt(attitude)
        across = gtsam.SO3.Hat(course.p_I_P)
        covariance[3:6, 3:6] = R.T @ course.of_position @ R + across @ covariance[:3, :3] @ across.T
        covariance[6:9, 6:9] = R.T @ course.of_velocity @ R
        moved = gtsam.NavState(attitude, course.p_W_P - R @ course.p_I_P, course.v_W_P)
        return OptimisedState(current.stamp_ns, moved, bias, covariance, current.angular_velocity)

    def _upright(self, current: OptimisedState) -> gtsam.Rot3:
        """Return the attitude of an estimate, turned upright where the accelerometer feels that it has overturned."""
        attitude = current.nav.attitude()
        felt = self.start.specific_force(current.stamp_ns - FELT_NS, current.stamp_ns)
        if felt is None or not FELT_M_S2[0] < np.linalg.norm(felt) < FELT_M_S2[1]:
            return attitude
        up_W = attitude.rotate(felt / np.linalg.norm(felt))
        if up_W[2] > cos(OVERTURNED_RAD):
            return attitude
        return level_attitude(up_W).compose(attitude)


def _doubt(attitude: gtsam.Rot3) -> Array:
    """Return the covariance (3, 3) of an attitude that is in doubt, in its own axes [rad^2]."""
    R, in_W = attitude.matrix(), np.diag([TILT_DOUBT_RAD**2, TILT_DOUBT_RAD**2, DOUBT_RAD**2])
    doubt: Array = R.T @ in_W @ R
    return doubt


def _turned(state: OptimisedState, by: gtsam.Rot3) -> OptimisedState:
    """Return a state turned in W, its position and velocity as they are, its heading in doubt."""
    attitude = by.compose(state.nav.attitude())
    into_I = attitude.matrix().T @ state.nav.attitude().matrix()  # from I as it was
    covariance = np.zeros((15, 15))
    for first in 3, 6:
        part = slice(first, first + 3)
        covariance[part, part] = into_I @ state.covariance[part, part] @ into_I.T
    covariance[9:, 9:] = state.covariance[9:, 9:]
    covariance[:3, :3] = _doubt(attitude)
    nav = gtsam.NavState(attitude, state.nav.position(), state.nav.velocity())
    return OptimisedState(state.stamp_ns, nav, state.bias, covariance, state.angular_velocity)
