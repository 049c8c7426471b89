"""The smoother's own factors and its timeline of nodes."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import Drive, G, apart, imu, machine, ns

from holdfast.graph.nodes import NODE_RESOLUTION_NS, Timeline, to_grid
from holdfast.graph.smoother import Smoother
from holdfast.sensors.imu import ImuBuffer
from holdfast.state import OptimisedState

MINUTE = 60_000_000_000


def started(speed_m_s=0.0, velocity_sigma=1.0):
    """A smoother at the first sample of a machine that stands, told that it moves."""
    config, still = machine(), Drive(start_s=100.0)
    buffer = ImuBuffer(config.sensors.imu)
    for sample in imu(still, 0.0, 2.0, 100.0, np.random.default_rng(1)):
        buffer.add(sample)
    smoother = Smoother(config, buffer, G)
    nav = gtsam.NavState(still.nav(0.0).attitude(), np.zeros(3), np.array([speed_m_s, 0.0, 0.0]))
    sigmas = np.repeat([0.01, 0.01, velocity_sigma, 1e-3, 1e-4], 3)
    smoother.start(OptimisedState(ns(0.0), nav, gtsam.imuBias.ConstantBias(), np.diag(sigmas**2), np.zeros(3)))
    return smoother


@given(st.integers(0, MINUTE))
def test_a_node_is_never_further_than_half_the_grid_from_its_measurement(stamp):
    assert abs(to_grid(stamp) - stamp) <= NODE_RESOLUTION_NS // 2
    assert to_grid(to_grid(stamp)) == to_grid(stamp) and to_grid(stamp) % NODE_RESOLUTION_NS == 0


@given(st.lists(st.integers(0, MINUTE), min_size=1, max_size=20, unique=True), st.integers(0, MINUTE))
def test_the_timeline_stays_sorted_and_finds_every_node(stamps, limit):
    timeline = Timeline()
    keys = {stamp: timeline.insert(stamp) for stamp in stamps}
    assert timeline.stamps == sorted(stamps) and len(set(keys.values())) == len(stamps)
    assert all(timeline.key(stamp) == key and stamp in timeline for stamp, key in keys.items())
    assert timeline.at_or_before(limit) == max((s for s in stamps if s <= limit), default=None)
    assert timeline.forget_before(limit) == sorted(s for s in stamps if s < limit)
    assert timeline.stamps == sorted(s for s in stamps if s >= limit)


def test_zero_velocity_takes_the_velocity_and_leaves_the_pose():
    smoother = started(0.3)
    before = smoother.nav(ns(0.0))
    smoother.optimise()
    smoother.add_zero_velocity(smoother.newest_ns, 0.01)
    state = smoother.optimise()
    # 0.3 m/s at sigma 1 m/s against 0 at 0.01 m/s
    assert np.linalg.norm(state.nav.velocity()) == pytest.approx(0.3 * 1e-4 / (1.0 + 1e-4), rel=0.01)
    position, rotation, _ = apart(before, state.nav)
    assert position < 1e-9 and rotation < 1e-9
    # 0.3 m/s seen in I, whose attitude is unsure by 0.01 rad: at most (0.3 m/s 0.01 rad)^2 more
    np.testing.assert_allclose(np.diag(state.covariance)[6:9], 1e-4 + 0.3**2 * 1e-4, rtol=0.09)
    np.testing.assert_allclose(np.diag(state.covariance)[:6], 1e-4, rtol=1e-3)


def test_a_node_between_two_others_replaces_their_link_by_two():
    smoother = started()
    smoother.node(ns(1.0))
    whole = smoother.optimise()
    smoother.node(ns(0.4371))
    split = smoother.optimise()
    assert sorted(smoother._links) == [ns(0.0), to_grid(ns(0.4371))]
    assert whole.stamp_ns == split.stamp_ns
    # 0.4371 s cut one step in two: a change of force of 0.03 m/s^2 over 5 ms
    assert max(apart(whole.nav, split.nav)) < 0.03 * 5 * 0.01
    np.testing.assert_allclose(np.diag(split.covariance), np.diag(whole.covariance), rtol=0.02)


def test_a_node_that_left_the_window_cannot_be_had():
    smoother = started()
    assert smoother.node(ns(-0.1)) is None
    assert smoother.node(ns(0.0)) is not None


def test_the_same_node_is_not_made_twice():
    smoother = started()
    assert smoother.node(ns(0.5)) == smoother.node(ns(0.5) + 40_000)
    assert len(smoother) == 2


def test_the_covariance_of_a_new_node_is_known_while_no_node_was_optimised_yet():
    smoother = started()
    smoother.node(ns(0.3))
    smoother.node(ns(0.6))
    assert np.isfinite(smoother.covariance(ns(0.3))).all()
