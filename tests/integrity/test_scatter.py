"""What positions scatter by beside the motion of the IMU: noise is found; motion, chance and lies are not."""

import numpy as np
import pytest
from motion import ARM, Drive, StopAndGo, imu, machine, ns

from holdfast.event_log import EventLog
from holdfast.events import EventKind
from holdfast.integrity.noise_scale import NoiseScale
from holdfast.integrity.scatter import Scatters
from holdfast.sensors.even_stamps import EvenStamps
from holdfast.sensors.imu import ImuBuffer
from holdfast.sensors.registry import sensors_of
from holdfast.sensors.sensor import Position

CONFIG = machine()
CLAIMED = np.diag(np.square([0.01, 0.01, 0.02]))
FAST = StopAndGo(speed=2.0)


class Run:
    """Positions of the antenna of a machine whose IMU measures, each with an error (3,)."""

    def __init__(self, motion=FAST, end_s=40.0, samples=None):
        self.buffer, self.log, self.motion = ImuBuffer(CONFIG.imu), EventLog("imu"), motion
        self.samples = iter(imu(motion, 0.0, end_s) if samples is None else samples)
        self.next = next(self.samples)
        self.scale = NoiseScale()
        self.stamps = EvenStamps(self.log)
        self.scatters = Scatters(sensors_of(CONFIG), self.buffer, self.log, "imu")

    def go(self, start_s, end_s, error, hz=5.0, *, round_m=None, ahead_s=0.0):
        for t in np.arange(start_s, end_s, 1.0 / hz):
            while self.next is not None and self.next.stamp_ns <= ns(t - ahead_s):
                self.buffer.check(self.next)
                self.buffer.add(self.next)
                self.next = next(self.samples, None)
            p = self.motion.pose(t).transformFrom(ARM) + error(t)
            if round_m is not None:
                p = np.round(p / round_m) * round_m
            believed = self.scatters.weighed(
                Position(ns(t), "gnss", p, CLAIMED, 0.0), {"gnss": self.scale}, self.stamps
            )
        return np.sqrt((believed.covariance / CLAIMED.clip(1e-12)).diagonal())


def white(sigma, seed=0):
    rng = np.random.default_rng(seed)
    return lambda _: rng.normal(0.0, sigma)


@pytest.mark.parametrize("hz", [2.0, 5.0, 20.0])
@pytest.mark.parametrize("times", [10.0, 30.0])
@pytest.mark.parametrize("ahead_s", [0.0, 0.3])
def test_noise_beyond_the_claim_is_found(hz, times, ahead_s):
    motion = Drive(tilt=0.3, heave_m=0.05)
    run = Run(motion)
    found = run.go(3.0, 38.0, white(times * np.array([0.01, 0.01, 0.02])), hz, ahead_s=ahead_s)
    assert (found > 0.4 * times).all() and (found < 2.5 * times).all()
    assert any(event.kind is EventKind.NOISE for event in run.log.take_events())


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("hz", [1.0, 5.0, 20.0])
def test_what_is_as_it_claims_is_believed_whatever_the_machine_does(seed, hz):
    run = Run()
    np.testing.assert_array_equal(run.go(0.0, 38.0, white([0.01, 0.01, 0.02], seed), hz), 1.0)
    assert not run.log.take_events()


def test_only_the_height_may_scatter():
    run = Run()
    east, north, up = run.go(0.0, 38.0, white([0.01, 0.01, 0.5]))
    assert east == north == 1.0 and 12.0 < up < 50.0


def test_lies_that_last_and_now_and_then_one_that_does_not_are_no_noise():
    rng = np.random.default_rng(3)

    def error(t):  # one in twenty is elsewhere
        lie = 5.0 if 10.0 < t < 20.0 else 0.05 * t
        lie += rng.uniform(10.0, 80.0) if rng.random() < 0.05 else 0.0
        return lie + rng.normal(0.0, [0.01, 0.01, 0.02])

    np.testing.assert_array_equal(Run().go(0.0, 38.0, error), 1.0)


def test_rounded_positions_scatter_though_most_are_the_one_before():
    run = Run(Drive(start_s=20.0, speed=0.3, tilt=0.0, heave_m=0.0))
    before = run.go(0.0, 20.0, white([0.0, 0.0, 0.02]), round_m=0.4)
    after = run.go(20.0, 38.0, white([0.0, 0.0, 0.02]), round_m=0.4)
    assert before[0] == 1.0 and after[0] > 5.0


def test_it_is_forgotten_slowly():
    run = Run(Drive(tilt=0.3, heave_m=0.05), end_s=100.0)
    noisy = run.go(3.0, 30.0, white([0.3, 0.3, 0.6]))
    soon = run.go(30.0, 40.0, white([0.01, 0.01, 0.02]))
    later = run.go(40.0, 99.0, white([0.01, 0.01, 0.02]))
    assert (noisy > soon).all() and (soon > 5.0).all()
    np.testing.assert_array_equal(later, 1.0)


def test_nothing_is_told_across_a_gap_of_the_imu_or_by_another_clock():
    samples = [one for one in imu(FAST, 0.0, 40.0) if (one.stamp_ns - ns(0.0)) * 1e-9 % 2.0 < 1.5]
    run = Run(samples=samples)
    np.testing.assert_array_equal(run.go(0.0, 38.0, white([0.3, 0.3, 0.6]), hz=2.0), 1.0)
    back = Run()
    for _ in range(12):
        found = back.go(5.0, 5.5, white([0.3, 0.3, 0.6]))  # the stamps go back again and again
    np.testing.assert_array_equal(found, 1.0)
