"""The biases of a window, and the scale factors that its walks know of."""

import gtsam
import numpy as np
import pytest
from motion import Drive, machine, ns
from rig import NO_BIAS, smoother_of

from holdfast.graph.biases import EPOCH_NS, Biases
from holdfast.graph.parameters import Parameters
from holdfast.graph.window import Window
from holdfast.sensors.imu import NOT_TURNED, Turning
from holdfast.sensors.preintegration import ImuNoise

CONFIG = machine(imu_={"gyroscope_error_ratio": 0.003, "gyroscope_random_walk": 1e-5})
SECOND_NS = 1_000_000_000


def empty():
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter, size in ("b", 6), ("D", 3):
        thresholds.insert((letter, np.full(size, 1.0)))
    return Window(thresholds)


def prior(key, gyroscope, sigma):
    bias = gtsam.imuBias.ConstantBias(np.zeros(3), np.array(gyroscope))
    return gtsam.PriorFactorConstantBias(key, bias, gtsam.noiseModel.Isotropic.Sigma(6, sigma))


class Begun:
    """A window that begins at a bias of zero, known well."""

    def __init__(self, config=CONFIG):
        self.window, self.parameters = empty(), Parameters()
        self.biases = Biases(config, self.parameters, ImuNoise(config.imu, 1e-3, 9.81))
        self.biases.begin(self.window, 0, NO_BIAS)
        self.window.add(prior(self.biases.newest_key, np.zeros(3), 1e-6))

    def link(self, stamp_ns, rate, duration_s=0.1):
        return self.biases.use(self.window, stamp_ns, Turning(np.array(rate) * duration_s, duration_s), NO_BIAS)

    def see(self, key, gyroscope, sigma=1e-6):
        self.window.add(prior(key, gyroscope, sigma))

    def solve(self):
        self.biases.prepare(self.window)
        self.window.solve(-1)
        self.parameters.mark_solved()


def test_links_of_one_epoch_see_one_bias():
    begun = Begun()
    first, second = begun.link(0, np.zeros(3)), begun.link(EPOCH_NS - 1, np.zeros(3))
    third = begun.link(EPOCH_NS, np.zeros(3))
    assert first == second != third


def test_what_is_seen_while_it_turns_is_the_scale_factor_and_not_the_bias():
    begun = Begun()
    begun.link(0, np.zeros(3))
    turning = begun.link(SECOND_NS, [0.0, 0.0, 0.5])
    begun.see(turning, [0.0, 0.0, 1e-3])
    begun.solve()
    scale, covariance = begun.parameters.belief("imu", begun.biases._prior)
    begun.link(3 * SECOND_NS, np.zeros(3))
    assert begun.window.vector(begun.biases._epochs[1].scale_key)[2] == pytest.approx(2e-3, rel=0.01)
    bias, of_bias = begun.biases.without_error(begun.window, turning)
    np.testing.assert_allclose(bias.gyroscope(), 0.0, atol=2e-5)
    assert of_bias[5, 5] ** 0.5 < 2e-5
    assert scale.shape == (3,) and covariance.shape == (3, 3)


def test_a_walk_knows_how_much_there_was_turned_in_the_end():
    """The epoch begins at rest and turns at 0.9 rad/s for nine tenths of it: 0.81 rad/s on the mean."""
    begun = Begun()
    begun.link(0, np.zeros(3))
    turning = begun.link(SECOND_NS, np.zeros(3), 0.025)
    begun.link(SECOND_NS + EPOCH_NS // 10, [0.0, 0.0, 0.9], 0.225)
    begun.link(2 * SECOND_NS, np.zeros(3))
    begun.see(turning, [0.0, 0.0, 0.81e-3])
    begun.solve()
    epoch = begun.biases._epochs[-1]
    assert begun.window.vector(epoch.scale_key)[2] == pytest.approx(1e-3, rel=0.01)


def test_a_link_that_is_no_more_turns_nothing():
    begun = Begun()
    key = begun.link(0, [0.0, 0.0, 1.0])
    begun.biases.release(key, Turning(np.array([0.0, 0.0, 0.1]), 0.1))
    assert begun.biases._epochs[-1].turning.rate == pytest.approx(np.zeros(3))
    assert NOT_TURNED.rate == pytest.approx(np.zeros(3))


def test_without_scale_factors_there_is_the_random_walk_alone():
    begun = Begun(machine())
    for k in range(3):
        begun.link(k * SECOND_NS, [0.0, 0.0, 0.5])
    begun.solve()
    _, covariance = begun.biases.without_error(begun.window, begun.biases.newest_key)
    walked = machine().imu.gyroscope_random_walk ** 2 * (2.0 + EPOCH_NS * 1e-9)
    assert covariance[5, 5] == pytest.approx(walked + 1e-12, rel=1e-6)


@pytest.mark.parametrize("late_s", [0.3, 0.7371, 1.21])
def test_a_node_that_comes_late_changes_the_estimate_by_nothing(late_s):
    drive = Drive(start_s=-3.0)
    smoothers = [smoother_of(drive, 3.0, config=CONFIG) for _ in range(2)]
    times = [0.5, 1.0, 1.5, 2.0]
    for t in sorted([*times, late_s]):
        smoothers[0].node(ns(t))
    for t in times:
        smoothers[1].node(ns(t))
    smoothers[1].optimise()
    smoothers[1].node(ns(late_s))
    in_turn, late = (smoother.optimise() for smoother in smoothers)
    np.testing.assert_allclose(late.nav.localCoordinates(in_turn.nav), 0.0, atol=1e-6)
    sigmas = np.sqrt(np.diag(in_turn.covariance))
    np.testing.assert_allclose((late.covariance - in_turn.covariance) / np.outer(sigmas, sigmas), 0.0, atol=0.02)
