"""The chain of a window: its nodes, and the motion between neighbours, by the IMU or by a model where it is silent."""

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.biases import EPOCH_NS, Biases
from holdfast.graph.motion_nearby import MotionNearby
from holdfast.graph.nodes import Link, Timeline, to_grid
from holdfast.graph.solver import Placed, Solver
from holdfast.messages import Array
from holdfast.sensors.imu import NOT_TURNED, ImuBuffer
from holdfast.sensors.preintegration import ImuNoise, MotionModel, preintegrate
from holdfast.sensors.sensor import Joint, State
from holdfast.state import OptimisedState

UNTRUSTED_RATE_NS = 20_000_000  # a gap that is longer says more of the angular velocity than the sample before it


class Motion(NamedTuple):
    """What is known of the motion between nodes.

    Attributes:
        imu: the samples.
        noise: of what is preintegrated of them.
        model: in their place where there are none.
        at_samples: whether there is a node at each sample, too.
        known: tells the state at the time of a new node [ns], if it is known better than by prediction.
    """

    imu: ImuBuffer
    noise: ImuNoise
    model: MotionModel
    at_samples: bool
    known: Callable[[int], gtsam.NavState | None]


class Prediction(NamedTuple):
    """How a node follows from the one before: derivatives by state (9, 9) and bias (9, 6), and what is added (9, 9)."""

    H_nav: Array
    H_bias: Array
    added: Array


class Chain:
    """Nodes in the order of time, each linked to the next; variables and factors of both are in a solver.

    Args:
        motion: between the nodes.
        biases: of the IMU; they begin anew.
        solver: of the window, empty.
        state: the first node; a prior on it and on the newest bias must follow.
    """

    def __init__(self, motion: Motion, biases: Biases, solver: Solver, state: OptimisedState) -> None:
        self._motion, self._biases, self._solver = motion, biases, solver
        self._nodes = Timeline()
        self._links: dict[int, Link] = {}  # by the stamp of the left node
        self._first_bias = state.bias  # of all preintegration: the result must not depend on when a link was made
        self._bias = state.bias  # newest estimate
        self._new: dict[int, gtsam.NavState] = {}  # not optimised yet, by stamp
        stamp = to_grid(state.stamp_ns)
        key = self._nodes.insert(stamp)
        biases.begin(solver, stamp, state.bias)
        self._insert(key, stamp, state.nav)

    def copy(self, solver: Solver, counterpart: Callable[[Placed], Placed], biases: Biases) -> "Chain":
        """Return an equal one for a copy of the solver, in which each factor has a counterpart; nothing may wait."""
        other = copy(self)
        other._solver, other._biases, other._nodes, other._new = solver, biases, self._nodes.copy(), {}
        other._links = {start: replace(link, placed=counterpart(link.placed)) for start, link in self._links.items()}
        return other

    def __len__(self) -> int:
        return len(self._nodes)

    def __contains__(self, stamp_ns: int) -> bool:
        return stamp_ns in self._nodes

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest node."""
        return self._nodes.stamps[-1]

    @property
    def oldest_ns(self) -> int:
        """Stamp of the oldest node."""
        return self._nodes.stamps[0]

    def links(self) -> list[Link]:
        """Return the links between neighbouring nodes, in the order of time."""
        return [self._links[stamp] for stamp in self._nodes.stamps[:-1]]

    def key(self, stamp_ns: int) -> int:
        """Return the key of the node at a time, which must exist."""
        return self._nodes.key(stamp_ns)

    def nav(self, stamp_ns: int) -> gtsam.NavState:
        """Return the estimate of the node at a time, which must exist."""
        if stamp_ns in self._new:
            return self._new[stamp_ns]
        return self._solver.nav(self._nodes.key(stamp_ns))

    def is_new(self, stamp_ns: int) -> bool:
        """Whether a node waits to be optimised."""
        return stamp_ns in self._new

    def before(self, stamp_ns: int) -> int:
        """Return the stamp of the last node before a time that lies inside the window."""
        return self._nodes.before(stamp_ns)

    def at_or_before(self, stamp_ns: int) -> int | None:
        """Return the stamp of the last node at or before a time, None if the window starts later."""
        return self._nodes.at_or_before(stamp_ns)

    def until(self, stamp_ns: int) -> list[int]:
        """Return the stamps of the nodes at or before a time."""
        return self._nodes.until(stamp_ns)

    def angular_velocity(
        self, stamp_ns: int, nav: gtsam.NavState | None = None, bias: gtsam.imuBias.ConstantBias | None = None
    ) -> Array:
        """Return the angular velocity (3,) of I at a node [rad/s]: from the last two nodes where the IMU is silent.

        State and bias are as they are known; without them as they are estimated.
        """
        nav, bias = nav or self.nav(stamp_ns), bias or self._bias
        if stamp_ns > self.oldest_ns:
            before = self._nodes.before(stamp_ns)
            if self._links[before].is_gap and stamp_ns - before > UNTRUSTED_RATE_NS:
                rotation: Array = self.nav(before).attitude().logmap(nav.attitude())
                return rotation / ((stamp_ns - before) * 1e-9)
        return self._motion.imu.angular_velocity(stamp_ns) - bias.gyroscope()

    def state_at(self, stamp_ns: int, joint: Joint | None, covariance: Array) -> State:
        """Return what a measurement is compared with at a node, whose covariance (9, 9) is given."""
        nav = self.nav(stamp_ns)
        rate, gravity = self.angular_velocity(stamp_ns, nav), self._motion.noise.gravity
        near = MotionNearby(self._motion.imu, stamp_ns, nav, rate, bias=self._bias, gravity=gravity)
        return State(nav, covariance, rate, joint, twist_beyond=near.twist_beyond, acceleration=near.acceleration)

    def extend(self, stamp_ns: int) -> Iterator[Prediction]:
        """Make a node behind the newest one, with those that must lie between, and yield how each follows."""
        for milestone, is_gap in self._milestones(stamp_ns):
            yield self._append(milestone, is_gap)

    def turn(self, by: gtsam.Rot3) -> None:
        """Begin with another attitude, turned by so much in W, at the nodes that wait to be optimised."""
        for stamp, nav in self._new.items():
            turned = gtsam.NavState(by.compose(nav.attitude()), nav.position(), nav.velocity())
            self._solver.guess(self.key(stamp), turned)
            self._new[stamp] = turned

    def split(self, stamp_ns: int) -> None:
        """Make a node between two others: the link that spans it is replaced by two."""
        left_ns = self._nodes.before(stamp_ns)
        nav, old = self.nav(left_ns), self._links.pop(left_ns)
        self._unlink(old)
        key = self._nodes.insert(stamp_ns)
        pim, first = self._join(left_ns, stamp_ns, old.is_gap, nav)
        predicted = pim.predict(nav, self._biases.seen(self._bias, first.turning.rate))
        self._insert(key, stamp_ns, predicted)
        self._join(stamp_ns, old.end_ns, old.is_gap, predicted)

    def mark_silent(self, since_ns: int) -> None:
        """Put the motion model in place of the IMU factors that end after a time."""
        for link in [link for link in self._links.values() if link.end_ns > since_ns and not link.is_gap]:
            self._unlink(link)
            self._join(link.start_ns, link.end_ns, True, self.nav(link.start_ns))

    def mark_solved(self, bias: gtsam.imuBias.ConstantBias, horizon_ns: int) -> None:
        """Note the newest bias once the solver has solved, and that it holds nothing before a time any more."""
        self._bias, self._new = bias, {}
        for stamp in self._nodes.forget_before(horizon_ns):
            self._links.pop(stamp, None)

    def _milestones(self, end_ns: int) -> Iterator[tuple[int, bool]]:
        """Yield the ends of the links that lead from the newest node to a new one, and whether each is a gap."""
        at = start_ns = self.newest_ns
        for piece in self._motion.imu.pieces(start_ns, end_ns):
            stops = [piece.end_ns]
            if self._motion.at_samples and not piece.is_gap:
                stops = [*self._motion.imu.stamps_between(piece.start_ns, piece.end_ns), piece.end_ns]
            for stop in stops:
                stamp = min(to_grid(stop), end_ns)
                if stamp > at:
                    yield stamp, piece.is_gap
                    at = stamp
        if at < end_ns:
            yield end_ns, piece.is_gap

    def _append(self, stamp_ns: int, is_gap: bool) -> Prediction:
        left_ns = self.newest_ns
        nav = self.nav(left_ns)
        key = self._nodes.insert(stamp_ns)
        pim, link = self._join(left_ns, stamp_ns, is_gap, nav)
        H_nav, H_bias = np.zeros((9, 9), order="F"), np.zeros((9, 6), order="F")
        seen = self._biases.seen(self._bias, link.turning.rate)
        self._insert(key, stamp_ns, pim.predict(nav, seen, H_nav, H_bias))
        added = pim.residualCovariance()
        if stamp_ns - left_ns > EPOCH_NS:
            H_rate = H_bias[:, 3:]
            added = added + H_rate @ self._biases.error(link.turning.rate)[1] @ H_rate.T
        return Prediction(H_nav, H_bias, added)

    def _unlink(self, link: Link) -> None:
        self._solver.retract(link.placed)
        self._biases.release(link.bias_key, link.turning)

    def _join(
        self, start_ns: int, end_ns: int, is_gap: bool, nav: gtsam.NavState
    ) -> tuple[gtsam.PreintegratedImuMeasurements, Link]:
        """Link two existing neighbours; `nav` is the state at the first. Return what leads from one to the other."""
        imu, turning = self._motion.imu, NOT_TURNED
        if is_gap:
            pim = self._crossed(start_ns, end_ns, nav)
        else:
            imu.forecast.learn(imu, end_ns, self._bias.gyroscope())
            steps, seen = imu.steps(start_ns, end_ns), imu.density(start_ns, end_ns)
            pim = preintegrate(steps, self._motion.noise, nav.attitude(), self._first_bias, seen)
            turning = imu.turning(start_ns, end_ns)
        bias_key = self._biases.use(self._solver, start_ns, turning, self._bias)
        factor = gtsam.ImuFactor2(self._nodes.key(start_ns), self._nodes.key(end_ns), bias_key, pim)
        link = self._links[start_ns] = Link(start_ns, end_ns, bias_key, is_gap, self._solver.add(factor), turning)
        self._biases.keep(self._solver, bias_key, end_ns)
        return pim, link

    def _crossed(self, start_ns: int, end_ns: int, nav: gtsam.NavState) -> gtsam.PreintegratedImuMeasurements:
        """Return what stands in for the IMU between two neighbours, of the first of which the state is known."""
        model, silent_ns = self._motion.model, start_ns
        while silent_ns > self.oldest_ns and self._links[before := self._nodes.before(silent_ns)].is_gap:
            silent_ns = before
        rate, duration_s = self.angular_velocity(start_ns, nav), (end_ns - start_ns) * 1e-9
        turning = self._motion.imu.forecast.over(
            duration_s, (start_ns - silent_ns) * 1e-9, rate, model.angular_rate_density
        )
        return model.preintegrate(duration_s, nav, turning.rate, self._bias, turning.density)

    def _insert(self, key: int, stamp_ns: int, predicted: gtsam.NavState) -> None:
        nav = self._motion.known(stamp_ns) or predicted
        self._solver.insert(key, nav, stamp_ns)
        self._new[stamp_ns] = nav
