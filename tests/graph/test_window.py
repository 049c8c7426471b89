"""The window: what is solved step by step is what would be solved at once, and a step touches the end only."""

from unittest.mock import patch

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.graph.window import Window

STEP_NS = 10_000_000
LAG_NS = 30 * STEP_NS
Vector = gtsam.imuBias.ConstantBias  # six linear numbers: what is marginalised loses nothing
NEVER = 1e9


def node(k):
    return gtsam.symbol("x", k)


def frame(k):
    return gtsam.symbol("l", k)


def noise(sigma):
    return gtsam.noiseModel.Isotropic.Sigma(6, sigma)


def empty():
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter in "xl":
        thresholds.insert((letter, np.full(6, NEVER)))
    return Window(thresholds)


class Watched:
    """iSAM2 that keeps how many variables each of its updates eliminated, and in how many groups it ordered them."""

    def __init__(self, inner):
        self.inner, self.eliminated, self.groups, self.was_batch = inner, [], [], []

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def update(self, factors, values, step):
        result = self.inner.update(factors, values, step)
        self.eliminated.append(result.getVariablesReeliminated())
        self.groups.append(step.constrainedKeys.size())
        self.was_batch.append(result.getBatchReorderTriggered())
        return result


class Problem:
    """A walk along a line of nodes; frames link some of them, as the lidar's track does. Kept whole beside the window.

    It is solved at once by `expected`, and by the window step by step.
    """

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        made, new = [], gtsam.ISAM2
        with patch("gtsam.ISAM2", lambda parameters: made.append(Watched(new(parameters))) or made[-1]):
            self.window = empty()
        (self.isam,) = made
        self.graph = gtsam.NonlinearFactorGraph()
        self.values = gtsam.Values()
        self.newest = -1
        self.frames = {}  # its number -> the node that used it last

    def insert(self, key, stamp_ns):
        self.window.insert(key, Vector(), stamp_ns)
        self.values.insert(key, Vector())

    def add(self, factor):
        self.graph.add(factor)
        return self.window.add(factor)

    def measured(self):
        return Vector(self.rng.normal(size=3), self.rng.normal(size=3))

    def grow(self):
        self.newest += 1
        k = self.newest
        self.insert(node(k), k * STEP_NS)
        if k == 0:
            self.add(gtsam.PriorFactorConstantBias(node(0), self.measured(), noise(1.0)))
        else:
            self.add(gtsam.BetweenFactorConstantBias(node(k - 1), node(k), self.measured(), noise(0.5)))

    def fix(self, k):
        self.add(gtsam.PriorFactorConstantBias(node(k), self.measured(), noise(2.0)))

    def scan(self, k, number):
        """Join a node to a frame; the first of a frame joins it to the one before, whose variable may be old."""
        if number not in self.frames:
            self.insert(frame(number), k * STEP_NS)
            before = number - 1
            if before in self.frames and frame(before) in self.window:
                drift = gtsam.BetweenFactorConstantBias(frame(before), frame(number), self.measured(), noise(0.1))
                self.add(drift)
            else:
                self.add(gtsam.PriorFactorConstantBias(frame(number), self.measured(), noise(10.0)))
        elif frame(number) not in self.window:
            return
        self.frames[number] = k
        self.window.keep(frame(number), k * STEP_NS)
        self.add(gtsam.BetweenFactorConstantBias(frame(number), node(k), self.measured(), noise(0.3)))

    def oldest(self):
        return max(0, self.newest - LAG_NS // STEP_NS)

    def solve(self):
        count, steps = len(self.window), len(self.isam.groups)
        self.window.solve(self.newest * STEP_NS - LAG_NS)
        for groups, was_batch in zip(self.isam.groups[steps:], self.isam.was_batch[steps:], strict=True):
            # a variable without a group would be eliminated among the oldest, a group too many corrupts memory
            assert groups == count or (groups < count / 2 and not was_batch)

    def agrees(self):
        """Compare every node of the window with the solution of everything at once."""
        values = gtsam.GaussNewtonOptimizer(self.graph, self.values).optimize()
        marginals = gtsam.Marginals(self.graph, values)
        for k in range(self.oldest(), self.newest + 1):
            expected, found = values.atConstantBias(node(k)).vector(), self.window.bias(node(k)).vector()
            # iSAM2 leaves a change below 1e-3 where it is (its wildfire threshold)
            np.testing.assert_allclose(found, expected, atol=5e-3)
            covariance = self.window.covariance(node(k))
            np.testing.assert_allclose(covariance, marginals.marginalCovariance(node(k)), rtol=1e-6, atol=1e-9)


events = st.lists(
    st.tuples(st.sampled_from(["fix", "scan", "solve"]), st.integers(0, 29), st.integers(1, 12)),
    min_size=30,
    max_size=80,
)


@given(events, st.integers(0, 2**32 - 1))
def test_step_by_step_comes_to_what_is_solved_at_once(events, seed):
    """Fixes and scans of any age in the window, frames that outlive their nodes, solved whenever."""
    problem = Problem(seed)
    for number, (kind, age, grown) in enumerate(events):
        for _ in range(grown):
            problem.grow()
        k = max(problem.oldest(), problem.newest - age)
        if kind == "fix":
            problem.fix(k)
        elif kind == "scan":
            problem.scan(k, number // 7)
        else:
            problem.solve()
    problem.solve()
    problem.agrees()
    assert len(problem.window) <= LAG_NS // STEP_NS + 1 + len(problem.frames)


def test_what_is_new_touches_no_more_than_what_came_since_the_variables_that_it_is_on():
    """A scan every 10 nodes reaches back 10 nodes to its frame; a fix touches the newest; the oldest go for nothing."""
    problem = Problem(1)
    for k in range(200):
        problem.grow()
        if k % 10 == 0:
            problem.scan(k, k // 50)
        problem.fix(k)
        problem.solve()
        if k == 60:
            problem.isam.eliminated.clear()
    # two frames can be among them; iSAM2 counts a touched variable twice, and removes cliques (up to two nodes) whole
    assert len(problem.isam.eliminated) >= 139
    with_scan = problem.isam.eliminated[9::10]
    alone = [n for i, n in enumerate(problem.isam.eliminated) if i % 10 != 9]
    assert max(with_scan) <= 2 * (11 + 2 + 1)
    assert np.median(alone) <= 2 * (2 + 1)


def test_a_retracted_factor_counts_for_nothing_before_and_after_it_took_effect():
    problem = Problem(2)
    for _ in range(20):
        problem.grow()
    problem.solve()
    wrong = gtsam.PriorFactorConstantBias(node(15), Vector(np.full(3, 100.0), np.full(3, 100.0)), noise(1e-3))
    waiting = problem.window.add(wrong)
    problem.window.retract(waiting)
    problem.solve()
    problem.agrees()
    placed = problem.window.add(wrong)
    problem.solve()
    assert problem.window.bias(node(15)).vector() == pytest.approx(np.full(6, 100.0), abs=0.1)
    problem.window.retract(placed)
    problem.window.retract(placed)
    problem.solve()
    problem.agrees()


def test_a_copy_is_the_same_and_goes_its_own_way():
    problem = Problem(3)
    for k in range(50):
        problem.grow()
        problem.scan(k, k // 20)
        problem.solve()
    fix = problem.window.add(gtsam.PriorFactorConstantBias(node(45), Vector(), noise(1.0)))
    problem.solve()
    before = problem.window.bias(node(49)).vector()
    other, counterpart = problem.window.copy()
    np.testing.assert_allclose(other.bias(node(49)).vector(), before, atol=1e-9)
    np.testing.assert_allclose(other.covariance(node(49)), problem.window.covariance(node(49)), rtol=1e-9)
    assert (len(other), other.factor_count) == (len(problem.window), problem.window.factor_count)
    other.retract(counterpart(fix))
    other.solve(0)
    assert other.factor_count == problem.window.factor_count - 1
    np.testing.assert_array_equal(problem.window.bias(node(49)).vector(), before)
    assert fix.slot is not None


def test_a_silence_longer_than_the_lag_leaves_the_newest_alone():
    problem = Problem(4)
    for k in range(20):
        problem.grow()
        problem.fix(k)
    problem.solve()
    problem.grow()
    problem.window.solve(problem.newest * STEP_NS)
    assert len(problem.window) == 1 and node(20) in problem.window and node(19) not in problem.window
    problem.grow()
    problem.window.solve(problem.newest * STEP_NS)
    expected = gtsam.Marginals(problem.graph, problem.values).marginalCovariance(node(21))
    np.testing.assert_allclose(problem.window.covariance(node(21)), expected, rtol=1e-6)


def test_a_variable_that_is_kept_outlives_those_of_its_time():
    problem = Problem(5)
    for k in range(40):
        problem.grow()
        if k == 0:
            problem.scan(0, 0)
        if k == 15:
            problem.window.keep(frame(0), 35 * STEP_NS)
            problem.window.keep(frame(0), 20 * STEP_NS)  # it has been promised longer
        problem.solve()
        problem.agrees()
    assert node(1) not in problem.window and frame(0) in problem.window
    for _ in range(30):
        problem.grow()
        problem.solve()
    assert frame(0) not in problem.window
    problem.agrees()


def test_a_state_that_moves_far_takes_a_second_step():
    """An arm of 2 m is found turned by 0.5 rad: one linear step is off by 0.5^3 / 6 = 0.02 rad, a second by 1e-6."""
    thresholds = gtsam.ISAM2ThresholdMap()
    thresholds.insert(("x", np.full(9, 0.005)))
    window, arm = Window(thresholds), np.array([2.0, 0.0, 0.0])
    window.insert(node(0), gtsam.NavState(), 0)
    prior = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1.0, 1e-5, 1.0], 3))
    window.add(gtsam.PriorFactorNavState(node(0), gtsam.NavState(), prior))
    turned = gtsam.Rot3.Yaw(0.5).rotate(arm)
    window.add(gtsam.GPSFactor2Arm(node(0), turned, arm, gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    window.solve(0)
    assert window.nav(node(0)).attitude().rpy()[2] == pytest.approx(0.5, abs=1e-5)


def test_a_copy_that_relinearises_keeps_what_the_marginalised_variables_knew():
    """A yaw known to 0.1 rad meets an arm of 1 m that is measured turned by 0.6 rad to 0.1 m: they meet in the middle.

    The prior is on a variable that has left; a copy that forgot about which point it was linear would let it follow.
    """
    thresholds = gtsam.ISAM2ThresholdMap()
    thresholds.insert(("x", np.full(9, 0.005)))
    window, arm = Window(thresholds), np.array([1.0, 0.0, 0.0])
    sigmas = np.repeat([0.1, 1e-5, 1.0], 3)
    for k in range(2):
        window.insert(node(k), gtsam.NavState(), k)
    window.add(gtsam.PriorFactorNavState(node(0), gtsam.NavState(), gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
    rigid = gtsam.noiseModel.Isotropic.Sigma(9, 1e-6)
    window.add(gtsam.BetweenFactorNavState(node(0), node(1), gtsam.NavState(), rigid))
    window.solve(1)
    assert node(0) not in window
    copy, _ = window.copy()
    turned = gtsam.Rot3.Yaw(0.6).rotate(arm)
    copy.add(gtsam.GPSFactor2Arm(node(1), turned, arm, gtsam.noiseModel.Isotropic.Sigma(3, 0.1)))
    for _ in range(3):
        copy.solve(1)
    assert copy.nav(node(1)).attitude().rpy()[2] == pytest.approx(0.3, abs=0.02)
