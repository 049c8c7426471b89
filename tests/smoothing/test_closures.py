"""Places seen twice hold the optimum together in an outage; one that is wrong is found by the others."""

import itertools
from collections import Counter

import gtsam
import numpy as np
import pytest
from motion import Drive, fixes, imu, in_order, machine, seconds

from holdfast.estimator.estimator import Estimator
from holdfast.smoothing.batch_smoother import BatchSmoother
from holdfast.smoothing.closures import CONTRADICTED, Closure, Found

MOTION = Drive()
OUTAGE = 12.0, 28.0
COVARIANCE = np.diag(np.repeat([1e-3, 0.01], 3) ** 2)


class Oracle:
    """Knows how the machine moved; its first `wrong` closures are off by a metre."""

    def __init__(self, wrong=0):
        self.wrong, self.stretches = wrong, []

    def __call__(self, stretch):
        self.stretches.append(stretch)
        times = stretch.covariances.times_ns
        early = times[np.searchsorted(times, times[0] + 5_000_000_000)]
        inside = [t for t in times.tolist() if OUTAGE[0] + 2.0 < seconds(t) < OUTAGE[1] - 2.0][::3]
        closures = []
        for number, late in enumerate(inside):
            T = MOTION.nav(seconds(int(early))).pose().between(MOTION.nav(seconds(late)).pose())
            if number < self.wrong:
                T = gtsam.Pose3(T.rotation(), T.translation() + np.array([1.0, 0.0, 0.0]))
            closures.append(Closure(int(early), late, T, COVARIANCE))
        return Found(closures, Counter(accepted=len(closures)))


def drive():
    rng = np.random.default_rng(0)
    of_fixes = fixes(MOTION, 0.0, 40.0, 5.0, rng=rng, phase_s=0.0037)
    outside = [fix for fix in of_fixes if not OUTAGE[0] <= seconds(fix.stamp_ns) < OUTAGE[1]]
    return in_order(imu(MOTION, 0.0, 40.0, rng=rng), outside)


@pytest.fixture(scope="module")
def results():
    """The stretch of the optimum with no closer, one that is right, and one that errs at first."""
    config = machine(lidar=False)
    batches = [BatchSmoother(config), *(BatchSmoother(config, closer=Oracle(wrong)) for wrong in (0, 2))]
    found = []
    for batch in batches:
        estimator = Estimator(config, batch)
        for message in drive():
            estimator.process(message)
        batch.stop()
        assert not batch.failures
        (block,) = batch.take()
        found.append(block)
    return found


def outage_rms(block):
    track = block.track
    times = [seconds(t) for t in track.times_ns.tolist()]
    off = [
        np.linalg.norm(p - MOTION.nav(t).position())
        for t, p in zip(times, track.positions, strict=True)
        if OUTAGE[0] < t < OUTAGE[1]
    ]
    return float(np.sqrt(np.mean(np.square(off))))


def test_closures_hold_the_optimum_in_an_outage(results):
    without, with_closures, _ = results
    assert outage_rms(with_closures) < 0.5 * outage_rms(without)
    assert without.closures == Counter()
    assert with_closures.closures["accepted"] >= 5 and with_closures.closures[CONTRADICTED] == 0


def test_closures_that_the_others_contradict_are_refused_and_counted(results):
    _, right, erring = results
    assert erring.closures[CONTRADICTED] == 2
    assert erring.closures["accepted"] == right.closures["accepted"] - 2
    assert outage_rms(erring) < 1.5 * outage_rms(right)


def test_a_closer_is_told_until_when_it_was_asked_before():
    oracle = Oracle()
    config = machine(lidar=False)
    batch = BatchSmoother(config, 10.0, 8.0, oracle)
    estimator = Estimator(config, batch)
    for message in drive():
        estimator.process(message)
    batch.stop()
    asked = [(one.after_ns, int(one.covariances.times_ns[-1])) for one in oracle.stretches]
    assert len(asked) >= 2
    assert all(after == newest for (_, newest), (after, _) in itertools.pairwise(asked))
