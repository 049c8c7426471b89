"""The fixed-lag smoother: nodes where measurements are, links that fill the time between, and what it takes back."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import ARM, Drive, apart, machine, ns
from rig import NO_BIAS, enter, position, smoother_of, truth

from holdfast.estimator.standstill import Standing
from holdfast.graph.biases import EPOCH_NS
from holdfast.graph.nodes import NODE_RESOLUTION_NS, Timeline, to_grid
from holdfast.graph.smoother import OptimiserError
from holdfast.graph.window import Window
from holdfast.sensors.sensor import Parameter
from holdfast.state import OptimisedState

MINUTE_NS = 60_000_000_000
STILL, DRIVE = Drive(start_s=100.0), Drive(start_s=-3.0)
POLICIES = pytest.mark.parametrize("nodes", ["measurement", "imu"])


# --- nodes ------------------------------------------------------------------------------------------------------------


@given(st.integers(0, MINUTE_NS))
def test_a_node_is_never_further_than_half_the_grid_from_its_measurement(stamp):
    assert abs(to_grid(stamp) - stamp) <= NODE_RESOLUTION_NS // 2
    assert to_grid(to_grid(stamp)) == to_grid(stamp) and to_grid(stamp) % NODE_RESOLUTION_NS == 0


@given(st.lists(st.integers(0, MINUTE_NS), min_size=1, max_size=20, unique=True), st.integers(0, MINUTE_NS))
def test_the_timeline_stays_sorted_and_finds_every_node(stamps, limit):
    timeline = Timeline()
    keys = {stamp: timeline.insert(stamp) for stamp in stamps}
    assert timeline.stamps == sorted(stamps) and len(set(keys.values())) == len(stamps)
    assert all(timeline.key(stamp) == key and stamp in timeline for stamp, key in keys.items())
    assert timeline.at_or_before(limit) == max((s for s in stamps if s <= limit), default=None)
    assert timeline.forget_before(limit) == sorted(s for s in stamps if s < limit)
    assert timeline.stamps == sorted(s for s in stamps if s >= limit)


def test_a_node_that_left_the_window_cannot_be_had():
    smoother = smoother_of(STILL, 2.0)
    assert smoother.node(ns(-0.1)) is None
    assert smoother.node(ns(0.0)) is not None


def test_the_same_node_is_not_made_twice():
    smoother = smoother_of(STILL, 2.0)
    assert smoother.node(ns(0.5)) == smoother.node(ns(0.5) + 40_000)
    assert len(smoother) == 2


def test_the_covariance_of_a_new_node_is_known_while_no_node_was_optimised_yet():
    smoother = smoother_of(STILL, 2.0)
    smoother.node(ns(0.3))
    smoother.node(ns(0.6))
    assert np.isfinite(smoother.covariance(ns(0.3))).all()


def test_a_node_between_two_others_changes_nothing_but_that_it_is_there():
    smoother = smoother_of(STILL, 2.0)
    smoother.node(ns(1.0))
    whole = smoother.optimise()
    smoother.node(ns(0.4371))
    split = smoother.optimise()
    assert len(smoother) == 3
    assert whole.stamp_ns == split.stamp_ns
    assert max(apart(whole.nav, split.nav)) < 1e-4
    np.testing.assert_allclose(np.diag(split.covariance)[:9], np.diag(whole.covariance)[:9], rtol=0.02)
    imu = machine().imu  # the bias of the second link may be another one, an epoch later
    walked = np.repeat([imu.accelerometer_random_walk, imu.gyroscope_random_walk], 3) ** 2 * EPOCH_NS * 1e-9
    np.testing.assert_allclose(np.diag(split.covariance - whole.covariance)[9:], walked, rtol=1e-6)


@POLICIES
def test_the_newest_node_is_where_the_imu_has_carried_the_state(nodes):
    smoother = smoother_of(DRIVE, 1.0, config=machine(graph={"nodes": nodes}))
    smoother.node(ns(1.0))
    assert len(smoother) == (2 if nodes == "measurement" else 101)
    position_m, rotation_rad, velocity_m_s = apart(smoother.optimise().nav, DRIVE.nav(1.0))
    assert position_m < 1e-4 and rotation_rad < 1e-4 and velocity_m_s < 1e-3


# --- factors ----------------------------------------------------------------------------------------------------------


def test_zero_velocity_takes_the_velocity_and_leaves_the_pose():
    nav = gtsam.NavState(STILL.nav(0.0).attitude(), np.zeros(3), np.array([0.3, 0.0, 0.0]))
    sigmas = np.repeat([0.01, 0.01, 1.0, 1e-3, 1e-4], 3)
    begun = OptimisedState(ns(0.0), nav, NO_BIAS, np.diag(sigmas**2), np.zeros(3))
    smoother = smoother_of(STILL, 2.0, state=begun)
    before = smoother.nav(ns(0.0))
    smoother.optimise()
    smoother.enter_zero_velocity(Standing(smoother.newest_ns), 0.01)
    state = smoother.optimise()
    # 0.3 m/s at sigma 1 m/s against 0 at 0.01 m/s
    assert np.linalg.norm(state.nav.velocity()) == pytest.approx(0.3 * 1e-4 / (1.0 + 1e-4), rel=0.01)
    position_m, rotation_rad, _ = apart(before, state.nav)
    assert position_m < 1e-9 and rotation_rad < 1e-9
    # 0.3 m/s seen in I, whose attitude is unsure by 0.01 rad: at most (0.3 m/s 0.01 rad)^2 more
    np.testing.assert_allclose(np.diag(state.covariance)[6:9], 1e-4 + 0.3**2 * 1e-4, rtol=0.09)
    np.testing.assert_allclose(np.diag(state.covariance)[:6], 1e-4, rtol=1e-3)


def test_a_measurement_that_is_retracted_counts_for_nothing():
    one, other = smoother_of(DRIVE, 2.0), smoother_of(DRIVE, 2.0)
    for smoother in (one, other):
        enter(smoother, position(DRIVE, 0.5, ARM))
        smoother.node(ns(0.8))
    wrong = enter(one, position(DRIVE, 0.8, ARM, (1.0, 0.0, 0.0)))
    expected = other.optimise()
    assert apart(one.optimise().nav, expected.nav)[0] > 0.01
    one.retract(wrong)
    one.retract(wrong)  # it is gone already
    assert max(apart(one.optimise().nav, expected.nav)) < 1e-3  # iSAM2 leaves a smaller change where it is


def test_a_measurement_that_left_the_window_is_not_retracted_from_it():
    smoother = smoother_of(DRIVE, 8.0)
    old = enter(smoother, position(DRIVE, 0.5, ARM))
    for t in np.arange(1.0, 8.0, 0.5):
        enter(smoother, position(DRIVE, t, ARM))
        before = smoother.optimise()
    smoother.retract(old)
    assert apart(smoother.optimise().nav, before.nav)[0] < 1e-9


def test_a_clone_has_the_same_state_and_goes_its_own_way():
    smoother = smoother_of(DRIVE, 8.0)
    for t in np.arange(0.5, 6.0, 0.1):
        last = enter(smoother, position(DRIVE, t, ARM))
        smoother.optimise()
    clone = smoother.clone()
    assert max(apart(clone.newest.nav, smoother.newest.nav)) < 1e-9
    assert clone.covariance(clone.newest_ns) == pytest.approx(smoother.covariance(smoother.newest_ns), rel=1e-6)
    clone.retract(last)
    enter(clone, position(DRIVE, 6.5, ARM, (1.0, 0.0, 0.0)))
    before = smoother.newest
    clone.optimise()
    assert smoother.newest is before and smoother.newest_ns < clone.newest_ns
    smoother.node(ns(6.5))
    assert apart(smoother.optimise().nav, DRIVE.nav(6.5))[0] < 0.02


def test_a_clone_knows_only_measurements_whose_factors_are_still_there():
    """A factor between two nodes leaves with the first of them, while its measurement is still in the window.

    A clone at the loss of GNSS failed over it with a KeyError.
    """
    smoother, measured = smoother_of(DRIVE, 8.0), []
    noise = gtsam.noiseModel.Isotropic.Sigma(9, 1.0)
    for t in np.arange(0.5, 6.0, 0.5):
        before, key = smoother.node(ns(t - 0.4)), smoother.node(ns(t))
        motion = DRIVE.nav(t - 0.4).pose().between(DRIVE.nav(t).pose())
        between = gtsam.BetweenFactorNavState(before, key, gtsam.NavState(motion, np.zeros(3)), noise)
        measured.append(position(DRIVE, t, ARM))
        smoother.enter(measured[-1], between)
        smoother.optimise()
    assert max(apart(smoother.clone().newest.nav, smoother.newest.nav)) < 1e-9
    # nor can they be retracted: another factor may have their slot
    for one in measured:
        if one.stamp_ns - 400_000_000 < smoother.oldest_ns:
            smoother.retract(one)
    before = smoother.newest
    after = smoother.optimise()
    assert max(apart(after.nav, before.nav)) < 1e-9
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-9)


# --- parameters -------------------------------------------------------------------------------------------------------

PRIOR = Parameter(np.zeros(1), np.array([0.5]))


def measure_height(smoother, t, constant_m, sigma_m=0.01):
    """A height that is off by a constant."""
    node = smoother.node(ns(t))
    key, value, covariance = smoother.parameter("laser", PRIOR, ns(t))

    def error(_, values, jacobians):
        if jacobians is not None:
            jacobians[0] = np.zeros((1, 9))
            jacobians[0][0, 3:6] = values.atNavState(node).attitude().matrix()[2]
            jacobians[1] = np.eye(1)
        return values.atNavState(node).position()[2:] + values.atVector(key) - (DRIVE.nav(t).position()[2] + constant_m)

    smoother.add(gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma_m), [node, key], error))
    return value, covariance


def test_a_parameter_is_estimated_and_its_sigma_shrinks():
    smoother = smoother_of(DRIVE, 8.0)
    assert smoother.parameters.estimate("laser") is None
    for t in np.arange(0.5, 6.0, 0.1):
        enter(smoother, position(DRIVE, t, ARM))
        measure_height(smoother, t, 0.7)
        smoother.optimise()
    value, covariance = measure_height(smoother, 6.0, 0.7)
    assert value == pytest.approx(0.7, abs=0.005)
    assert covariance[0, 0] ** 0.5 < 0.01
    found, sigmas = smoother.parameters.estimate("laser")
    assert found == value and sigmas**2 == pytest.approx(covariance[0])


@pytest.mark.parametrize("move", [False, True])
def test_what_is_known_of_a_parameter_outlives_a_window(move, monkeypatch):
    smoother = smoother_of(DRIVE, 8.0)
    for t in np.arange(0.5, 3.0, 0.1):
        enter(smoother, position(DRIVE, t, ARM))
        measure_height(smoother, t, 0.7)
        smoother.optimise()
    measure_height(smoother, 3.1, 0.7)
    if move:
        smoother.optimise()
        smoother.move(gtsam.Pose3(), 1.0)
    else:
        fail_once(monkeypatch)
        with pytest.raises(OptimiserError):
            smoother.optimise()
    value, covariance = measure_height(smoother, 3.2, 0.7)
    assert value == pytest.approx(0.7, abs=0.02)
    assert covariance[0, 0] ** 0.5 < 0.05


# --- what can go wrong ------------------------------------------------------------------------------------------------


def fail_once(monkeypatch):
    solve = Window.solve

    def failing(window, oldest_ns):
        monkeypatch.setattr(Window, "solve", solve)
        raise RuntimeError("indeterminate system\nnear x42")

    monkeypatch.setattr(Window, "solve", failing)


def test_after_a_failure_it_begins_anew_at_its_last_good_state_with_a_larger_covariance(monkeypatch):
    smoother = smoother_of(DRIVE, 8.0)
    enter(smoother, position(DRIVE, 0.5, ARM))
    good = smoother.optimise()
    enter(smoother, position(DRIVE, 0.6, ARM))
    fail_once(monkeypatch)
    with pytest.raises(OptimiserError, match=r"^indeterminate system$"):
        smoother.optimise()
    assert len(smoother) == 1 and smoother.newest_ns == good.stamp_ns
    np.testing.assert_allclose(smoother.newest.covariance, 4.0 * good.covariance)
    smoother.node(ns(0.7))
    assert apart(smoother.optimise().nav, DRIVE.nav(0.7))[0] < 0.05


def test_a_solution_that_diverges_is_a_failure_and_its_velocity_is_never_had():
    """A fix 2 km away that nobody has judged."""
    smoother = smoother_of(DRIVE, 8.0)
    enter(smoother, position(DRIVE, 0.5, ARM))
    good = smoother.optimise()
    enter(smoother, position(DRIVE, 0.6, ARM, (2e3, 0.0, 0.0)))
    with pytest.raises(OptimiserError, match=r"^it diverges: the (velocity steps by|speed is) \d+ m/s$"):
        smoother.optimise()
    assert smoother.newest.nav.equals(good.nav, 1e-12)


def test_a_solution_that_leaves_the_earth_is_a_failure_however_uncertain_the_velocity_was():
    smoother = smoother_of(DRIVE, 8.0, state=truth(DRIVE, 0.0, np.repeat([0.1, 10.0, 1e5, 1e-3], [3, 3, 3, 6])))
    enter(smoother, position(DRIVE, 0.5, ARM, (20e3, 0.0, 0.0)))
    with pytest.raises(OptimiserError, match=r"^it diverges: the speed is \d+ m/s$"):
        smoother.optimise()


@pytest.mark.parametrize("correlated", [0.0, 1.5])
def test_a_covariance_that_is_not_positive_is_a_failure(monkeypatch, correlated):
    """Neither one with a negative variance nor one whose variances are positive, but whose correlations are none."""
    smoother = smoother_of(DRIVE, 8.0)
    smoother.node(ns(0.5))
    wrong = np.eye(15) if correlated else -np.eye(15)
    wrong[0, 8] = wrong[8, 0] = correlated
    monkeypatch.setattr(Window, "covariance", lambda *_: wrong)
    with pytest.raises(OptimiserError, match="covariance of the optimised state is not positive"):
        smoother.optimise()


@pytest.mark.parametrize("entry", [1e200, np.nan])
def test_a_covariance_beyond_all_bounds_is_a_failure_whatever_part_it_is_of(monkeypatch, entry):
    """Its squares are no numbers any more: overflows in matmul were seen where a machine had no time to optimise."""
    smoother = smoother_of(DRIVE, 8.0)
    smoother.node(ns(0.5))
    covariance = np.eye(18)
    covariance[17, 17] = entry  # of a slow error
    monkeypatch.setattr(Window, "covariance", lambda *_: covariance)
    with pytest.raises(OptimiserError, match="covariance of the optimised state is beyond all bounds"):
        smoother.optimise()


def test_a_bias_that_no_imu_has_is_a_failure(monkeypatch):
    smoother = smoother_of(DRIVE, 8.0)
    smoother.node(ns(0.5))
    monkeypatch.setattr(Window, "bias", lambda *_: gtsam.imuBias.ConstantBias(np.full(3, 1e9), np.zeros(3)))
    with pytest.raises(OptimiserError, match="a bias is beyond the range of the IMU"):
        smoother.optimise()


def test_a_sensor_that_raises_in_a_factor_does_not_end_the_estimator():
    smoother = smoother_of(DRIVE, 8.0)

    def error(_, values, jacobians):
        raise ZeroDivisionError("a sensor of a user")

    key = smoother.node(ns(0.5))
    smoother.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [key], error))
    with pytest.raises(OptimiserError, match="a sensor of a user"):
        smoother.optimise()
    smoother.node(ns(0.7))
    assert apart(smoother.optimise().nav, DRIVE.nav(0.7))[0] < 0.05


def test_it_begins_anew_where_it_is_moved_to_with_a_position_in_doubt():
    smoother = smoother_of(DRIVE, 8.0)
    enter(smoother, position(DRIVE, 0.5, ARM))
    before = smoother.optimise()
    correction = gtsam.Pose3(gtsam.Rot3.Yaw(0.5), np.array([1.0, 2.0, 3.0]))
    smoother.move(correction, 2.0)
    assert smoother.newest.nav.pose().equals(correction * before.nav.pose(), 1e-9)
    np.testing.assert_allclose(smoother.newest.nav.velocity(), correction.rotation().rotate(before.nav.velocity()))
    np.testing.assert_allclose(np.diag(smoother.newest.covariance - before.covariance)[3:6], 4.0)


def test_nodes_settle_once_each_before_they_leave():
    smoother, settled = smoother_of(DRIVE, 12.0), []
    for t in np.arange(0.5, 12.0, 0.1):
        enter(smoother, position(DRIVE, t, ARM))
        smoother.optimise()
        settled += [stamp for stamp, _ in smoother.settled()]
    assert len(settled) == len(set(settled)) > 80
    assert settled == sorted(settled)


def test_while_the_imu_is_silent_the_last_node_before_is_known():
    smoother = smoother_of(DRIVE, 2.0)
    smoother.node(ns(0.5))
    assert smoother.last_before(ns(0.4)) == ns(0.0)
    assert smoother.last_before(ns(0.5)) == ns(0.5)
    assert smoother.last_before(ns(-1.0)) is None
