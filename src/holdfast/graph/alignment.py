"""Starting in motion: attitude, heading, velocity and biases from a stretch of GNSS and IMU, solved as one batch.

The first guess turns the increments of velocity that the IMU measured into those that GNSS saw (Wahba's problem).
Heading may have other minima, so the batch is solved from other headings as well, and the best must stand out.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, log, radians, sqrt
from typing import NamedTuple

import gtsam
import numpy as np

from holdfast.graph.alignment_problem import (
    CLAIMED_DEGREES,
    MAX_EXCESS,
    Belief,
    BiasPrior,
    Evidence,
    Noise,
    Problem,
    Problems,
    Spell,
)
from holdfast.graph.first_guess import course, first_attitudes
from holdfast.messages import Array
from holdfast.sensors.sensor import Position
from holdfast.state import OptimisedState

HEADINGS = 3  # the first guess, and others evenly beside it
ITERATIONS = 15
SAME_RAD = 1e-2  # of two solutions, which are then one
DISTINCT = 9.0  # difference of the objective (half a chi-square) by which the best heading must win
JUMPED = 20.0  # evidence: chance leaves twelve or so
VAGUE_RAD = radians(30.0)  # to which a heading is better than none, or than one that is in doubt
SAME_BIAS_RAD_S, MOST_RAD_S = 5e-3, 0.09  # two standstills differ by no more; what jumps by more has been knocked
SAME_NS, SAME_RATIO = 1_500_000_000, 2.0
BEYOND, WIDENED = 3.0, 10.0  # sigmas by which a bias departs from what was known of it, which then was so much less
COARSE = 3  # nodes: the time of a jump is looked for in such steps, then from node to node
FITS = 4.0  # squared residuals over what is claimed
DOUBTFUL = 2.0  # the same, where an odometry is among what was measured
REWEIGHTED = 2  # times: how residuals fall to positions and velocities depends on what they weigh
TO_DECIDE = Belief(CLAIMED_DEGREES, 0.01)  # whether the heading is known: a start that is wrong costs more than a wait
TO_TELL = Belief(4.0, 1e-3)  # how well: a claim that is right within a factor of three or so
Solution = tuple[float, gtsam.Values]  # half the sum of squares that is left, and where


class Jump(NamedTuple):
    """A jump of the biases.

    Attributes:
        stamp_ns: when [ns].
        by_rad_s: by how much that of the gyroscope jumps.
        evidence: twice the logarithm of how many times likelier it makes what was measured: (85) in docs/math.md.
    """

    stamp_ns: int
    by_rad_s: float
    evidence: float

    @property
    def is_believed(self) -> bool:
        """Whether it is no drift and no knock, and explains more than six numbers and a time do by chance."""
        return SAME_BIAS_RAD_S < self.by_rad_s < MOST_RAD_S and self.evidence >= JUMPED

    def is_same(self, other: "Jump") -> bool:
        """Whether another, found later or earlier, is of about the same time and size."""
        ratio = self.by_rad_s / max(other.by_rad_s, 1e-9)
        return abs(self.stamp_ns - other.stamp_ns) <= SAME_NS and 1.0 / SAME_RATIO < ratio < SAME_RATIO


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The outcome of one batch.

    Attributes:
        state: at the last measurement, or None where the heading is not yet certain.
        reason: what was found, in words.
        heading_sigma_rad: standard deviation of the heading, if a single best solution was found.
        excess: squared residuals over their expectation.
        misfit: the same, or how many times more than claimed the positions or the velocities vary, if that is more.
        jump: of the biases that would explain most; if it `is_believed`, the state is that after it.
        is_contradictory: whether no state explains what was measured, whatever else would be measured.
        arms: shifts (3,) [m] of lever arms that were in doubt, with covariance (3, 3), by name.
        clock_s: offset of the clock of positions that looks most like the first of them [s].
        worst: the position that is furthest beside the solution.
    """

    state: OptimisedState | None
    reason: str
    heading_sigma_rad: float | None = None
    excess: float = inf
    misfit: float = inf
    jump: Jump | None = None
    is_contradictory: bool = False
    arms: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    clock_s: float = 0.0
    worst: Position | None = None

    @property
    def fits(self) -> bool:
        """Whether what was measured is as near to the solution as it claims, or nearly so."""
        return self.excess <= DOUBTFUL and self.misfit <= FITS

    @property
    def is_unsolved(self) -> bool:
        """Whether what was measured tells nothing, not even that it does not fit."""
        return self.excess == inf and not self.is_contradictory

    @property
    def is_vague(self) -> bool:
        """Whether what was measured may fit, but tells too little to say how well."""
        return self.misfit == inf and self.excess < inf

    @property
    def has_jumped(self) -> bool:
        """Whether the biases are believed to have jumped."""
        return self.jump is not None and self.jump.is_believed


class Explained(NamedTuple):
    """Biases with which a batch was solved.

    Attributes:
        spells: of biases, as they were known.
        deltas: what the IMU measured between the nodes.
        problem: made of them.
        solutions: its own, the best first.
        jump: that was looked for.
        noise: on what is claimed.
    """

    spells: list[Spell]
    deltas: Sequence[gtsam.PreintegratedImuMeasurements]
    problem: Problem
    solutions: list[Solution]
    jump: Jump | None
    noise: Noise = Noise()


class BatchAligner:
    """Solves the batch again and again while its window moves on; one instance per start.

    Args:
        problems: make its graphs.
    """

    def __init__(self, problems: Problems) -> None:
        self._problems = problems

    def solve(
        self, evidence: Evidence, prior: BiasPrior, max_heading_sigma_rad: float, jump_sigmas: Array | None = None
    ) -> Alignment:
        """Align the window that measurements span.

        Args:
            evidence: measurements while the IMU measured, of at least two positions.
            prior: of the biases.
            max_heading_sigma_rad: what is wanted.
            jump_sigmas: (6,) as in `BiasPrior`, by how much the biases may have jumped within the window; None: not.
        """
        found = self._explained(evidence, prior, jump_sigmas)
        for _ in range(REWEIGHTED):
            found = self._reweighted(found, evidence, TO_DECIDE)
        if not found.solutions:
            return Alignment(None, "the batch of GNSS and IMU has no solution")
        if len(found.spells) > 1:
            max_heading_sigma_rad = max(max_heading_sigma_rad, VAGUE_RAD)
        decided = self._judge(found, evidence, max_heading_sigma_rad)
        told = decided if decided.state is None else self._told(decided, found, evidence)
        return replace(told, jump=found.jump, worst=found.problem.worst(found.solutions[0][1]))

    def _reweighted(self, found: Explained, evidence: Evidence, claims: Belief) -> Explained:
        """Solve once more, with the noise that residuals show, from each solution that there is, if there is any."""
        if not found.solutions:
            return found
        noise = found.problem.noise(found.solutions[0][1], found.noise, evidence.freedom, claims)
        problem = self._problems.problem(evidence, found.deltas, found.spells, noise)
        starts = _distinct(found.solutions, gtsam.symbol("x", len(evidence.stamps) - 1))
        return found._replace(
            problem=problem, noise=noise, solutions=_solved(problem.graph, [values for _, values in starts])
        )

    def _told(self, decided: Alignment, found: Explained, evidence: Evidence) -> Alignment:
        """Return what was decided with the heading that residuals tell, if they tell more of it than claims do."""
        best = self._reweighted(found._replace(solutions=found.solutions[:1]), evidence, TO_TELL)
        told = self._judge(best, evidence, inf) if best.solutions else decided
        if decided.state is None or told.state is None:
            return decided
        state = _with_heading(decided.state, told.state)
        return replace(decided, state=state, reason=told.reason, heading_sigma_rad=told.heading_sigma_rad)

    def _explained(self, evidence: Evidence, prior: BiasPrior, jump_sigmas: Array | None) -> Explained:
        """Solve for biases that are constant, that have jumped if they may, or that were not what was known of them."""
        deltas, spells, jump = self._problems.preintegrate(evidence.stamps, prior.bias), [Spell(0, prior)], None
        problem = self._problems.problem(evidence, deltas, spells, Noise())
        solutions = _solved(problem.graph, list(self._starts(evidence, deltas, prior.bias)))
        if solutions and jump_sigmas is not None:
            after = BiasPrior(prior.bias, jump_sigmas)
            jump, solution = self._jump(evidence, deltas, prior, after, solutions[0])
            if jump.is_believed:
                spells.append(Spell(jump.stamp_ns, after))
                problem = self._problems.problem(evidence, deltas, spells, Noise())
                return Explained(spells, deltas, problem, [solution], jump)
        if solutions and _is_beyond(solutions[0], prior):
            spells = [Spell(0, BiasPrior(prior.bias, WIDENED * prior.sigmas))]
            found = solutions[0][1].atConstantBias(gtsam.symbol("b", 0))
            deltas = self._problems.preintegrate(evidence.stamps, found)
            problem = self._problems.problem(evidence, deltas, spells, Noise())
            solutions = _solved(problem.graph, [values for _, values in solutions])
        return Explained(spells, deltas, problem, solutions, jump)

    def _jump(
        self,
        evidence: Evidence,
        deltas: Sequence[gtsam.PreintegratedImuMeasurements],
        before: BiasPrior,
        after: BiasPrior,
        constant: Solution,
    ) -> tuple[Jump, Solution]:
        """Return when biases that jump would have done so, and the solution with that: (85) in docs/math.md."""
        stamps, start = evidence.stamps, gtsam.Values(constant[1])
        start.insert(gtsam.symbol("b", 1), start.atConstantBias(gtsam.symbol("b", 0)))
        tried: dict[int, Solution] = {0: constant}

        def best_of(indices: Iterable[int]) -> int:
            near = start
            for k in indices:
                if 0 < k < len(stamps) - 1 and k not in tried:
                    spells = [Spell(0, before), Spell(stamps[k], after)]
                    problem = self._problems.problem(evidence, deltas, spells, Noise())
                    for solution in _solved(problem.graph, [near]):
                        tried[k], near = solution, solution[1]
            return min(tried, key=lambda k: tried[k][0])

        nearest = best_of(range(len(stamps) - COARSE // 2, 0, -COARSE))  # the later, the less it changes
        best = best_of(range(nearest - COARSE + 1, nearest + COARSE))
        without, left = (2.0 * error + CLAIMED_DEGREES for error in (constant[0], tried[best][0]))
        jumped: Array = tried[best][1].atConstantBias(gtsam.symbol("b", min(best, 1))).gyroscope()
        by_rad_s = float(np.linalg.norm(jumped - tried[best][1].atConstantBias(gtsam.symbol("b", 0)).gyroscope()))
        found = evidence.freedom * log(without / left)
        return Jump(stamps[best], by_rad_s, found), tried[best]

    def _starts(
        self,
        evidence: Evidence,
        deltas: Sequence[gtsam.PreintegratedImuMeasurements],
        bias: gtsam.imuBias.ConstantBias,
    ) -> Iterator[gtsam.Values]:
        """Yield where the search begins: the first guess of the heading, and others evenly beside it."""
        track, speeds = course(evidence.stamps, evidence.positions, evidence.velocities)
        first, attitudes = first_attitudes(evidence.stamps, deltas, speeds, self._problems.noise.gravity)
        arm = self._problems.positions[evidence.positions[0].sensor].p_I_P
        for k in range(HEADINGS):
            turned = gtsam.Rot3.Yaw(2.0 * np.pi * k / HEADINGS).compose(first)
            values = gtsam.Values()
            values.insert(gtsam.symbol("b", 0), bias)
            for i, attitude in enumerate(attitudes):
                R_W_I = turned.compose(attitude)
                values.insert(gtsam.symbol("x", i), gtsam.NavState(R_W_I, track[i] - R_W_I.rotate(arm), speeds[i]))
            for name, key in self._problems.arms.items():
                values.insert(key, self._problems.positions[name].p_I_P)
            yield values

    def _judge(self, found: Explained, evidence: Evidence, max_heading_sigma_rad: float) -> Alignment:
        problem, solutions, noise, stamps = found.problem, found.solutions, found.noise, evidence.stamps
        last, of_bias = gtsam.symbol("x", len(stamps) - 1), problem.last_bias
        error, best = solutions[0]
        nav = best.atNavState(last)
        excess = 2.0 * error / max(evidence.freedom, 1)
        scale = max(1.0, excess)
        if max(excess, *noise) >= MAX_EXCESS:
            times = sqrt(max(excess, *noise))
            why = f"GNSS and IMU disagree: the residuals are {times:.0f} times what they claim"
            why = f"{why}; `holdfast config init` finds axes, units and clocks that are wrong"
            return Alignment(None, why, is_contradictory=True)
        for other_error, other in solutions[1:]:
            apart = abs(nav.attitude().between(other.atNavState(last).attitude()).rpy()[2])
            if apart > 3.0 * max_heading_sigma_rad and other_error - error < DISTINCT * scale:
                return Alignment(None, "the motion so far fits more than one heading")
        shifts = self._problems.shifts()
        try:
            joint = scale * joint_covariance(
                problem.graph, best, [last, of_bias, *(key for key, _ in shifts.values())], 15 + 3 * len(shifts)
            )
        except np.linalg.LinAlgError:
            return Alignment(None, "the motion so far does not determine the heading")
        arms = {
            name: (best.atVector(key) - sensor.p_I_P, joint[15 + 3 * k : 18 + 3 * k, 15 + 3 * k : 18 + 3 * k])
            for k, (name, (key, sensor)) in enumerate(shifts.items())
        }
        covariance = joint[:15, :15].copy()
        R = nav.attitude().matrix()
        sigma = float(np.sqrt((R @ covariance[:3, :3] @ R.T)[2, 2]))
        if sigma > max_heading_sigma_rad:
            known, needed = np.degrees(sigma), np.degrees(max_heading_sigma_rad)
            reason = f"heading is known to {known:.1f} deg, {needed:.1f} deg are needed"
            return Alignment(None, reason, sigma, excess)
        # a slow error of the positions is still that of the newest
        covariance[3:6, 3:6] += R.T @ evidence.positions[-1].covariance @ R * max(0.0, 1.0 - noise.of_positions)
        bias = best.atConstantBias(of_bias)
        rate = self._problems.buffer.angular_velocity(stamps[-1]) - bias.gyroscope()
        state = OptimisedState(stamps[-1], nav, bias, covariance, rate)
        reason, misfit = f"heading from motion, {np.degrees(sigma):.1f} deg", max(excess, *noise)
        clock_s = next((_as_clock_s(best, len(stamps), shift) for shift, _ in arms.values()), 0.0)
        return Alignment(state, reason, sigma, excess, misfit, arms=arms, clock_s=clock_s)


def _distinct(solutions: Sequence[Solution], last: int) -> list[Solution]:
    """Return solutions, the best first, without those that are one with a better one: by the attitude at the last."""
    found: list[Solution] = []
    for one in solutions:
        R = one[1].atNavState(last).attitude()
        if all(np.linalg.norm(R.logmap(better.atNavState(last).attitude())) > SAME_RAD for _, better in found):
            found.append(one)
    return found


def _with_heading(state: OptimisedState, told: OptimisedState) -> OptimisedState:
    """Return a state that has the heading of another and is as sure of it, with what that says of all the rest."""
    R, P = state.nav.attitude(), state.covariance
    H = np.r_[R.unrotate(np.array([0.0, 0.0, 1.0])), np.zeros(12)]
    before, after = float(H @ P @ H), float(H[:3] @ told.covariance[:3, :3] @ H[:3])
    if after >= before:
        return state
    along = P @ H / before
    turned = float(gtsam.Rot3.Logmap(told.nav.attitude().compose(R.inverse()))[2])
    nav = state.nav.retract(along[:9] * turned)
    bias = state.bias + gtsam.imuBias.ConstantBias(*(along[9:] * turned).reshape(2, 3))
    return replace(state, nav=nav, bias=bias, covariance=P - (before - after) * np.outer(along, along))


def _is_beyond(solution: Solution, prior: BiasPrior) -> bool:
    """Whether a bias is so far from what was known of it that this must have been wrong."""
    off: Array = (solution[1].atConstantBias(gtsam.symbol("b", 0)) - prior.bias).vector()
    return bool((np.abs(off) > BEYOND * prior.sigmas).any())


def _as_clock_s(values: gtsam.Values, nodes: int, shift: Array) -> float:
    """Return in how long [s] the nodes moved by a shift (3,) in I, as nearly as they did."""
    navs = [values.atNavState(gtsam.symbol("x", k)) for k in range(nodes)]
    along = sum(float(nav.attitude().rotate(shift) @ nav.velocity()) for nav in navs)
    return along / max(sum(float(nav.velocity() @ nav.velocity()) for nav in navs), 1e-9)


def joint_covariance(graph: gtsam.NonlinearFactorGraph, at: gtsam.Values, keys: Sequence[int], size: int) -> Array:
    """Return the joint covariance (n, n) of some variables, of so many numbers.

    GTSAM's marginals fail where pivots differ by four thousand, as metres and radians do, however well they are known.

    Raises:
        LinAlgError: nothing tells one of the variables, or too little for the digits that there are.
    """
    order = gtsam.Ordering()
    others = [key for key in at.keys() if key not in keys]  # noqa: SIM118 (no mapping)
    for key in (*keys, *others):
        order.push_back(key)
    information, _ = graph.linearize(at).hessian(order)
    if not information.diagonal().min() > 0.0:
        raise np.linalg.LinAlgError("nothing tells one of the variables")
    scale = 1.0 / np.sqrt(information.diagonal())
    root = np.linalg.solve(np.linalg.cholesky(scale[:, None] * information * scale), np.eye(len(scale), size))
    covariance: Array = scale[:size, None] * (root.T @ root) * scale[:size]
    return covariance


def _solved(graph: gtsam.NonlinearFactorGraph, starts: Sequence[gtsam.Values]) -> list[Solution]:
    """Return the objective and the values that are found from each start, the best first."""
    parameters, found = gtsam.LevenbergMarquardtParams(), []
    parameters.setMaxIterations(ITERATIONS)
    for values in starts:
        try:
            solved = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        except RuntimeError:
            continue
        found.append((graph.error(solved), solved))
    return sorted(found, key=lambda one: one[0])
