"""A rehearsal warms the caches and nothing else."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from engine import nav_bits

from holdfast.estimator.estimator import Estimator
from holdfast.messages import ImuSample, JointAngle
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.realtime.rehearsal import Rehearsal


def published(estimator):
    """What a rehearsal asks of what the optimiser published: the state that the path goes on from."""
    predictor = estimator._path.predictor
    state = None if predictor is None else predictor._newest.state
    return SimpleNamespace(state=state, gravity=9.81, epoch=0)


def estimates(drive, messages, rehearses):
    estimator, rehearsal, found, runs = Estimator(drive.config), Rehearsal(drive.config), [], 0
    for message in messages:
        output = estimator.process(message)
        if output.estimate is not None:
            found.append((output.estimate, output.base))
        if not rehearses:
            continue
        if isinstance(message, ImuSample) and message.sensor == "imu":
            rehearsal.note(message)
            rehearsal.run(published(estimator))
            runs += rehearsal._path.predictor is not None
        elif isinstance(message, ImuSample | JointAngle):
            rehearsal.add_to_base(message)
    return found, runs


def test_estimates_with_rehearsals_are_the_same_to_the_bit(drive):
    plain, _ = estimates(drive, drive.messages, rehearses=False)
    rehearsed, runs = estimates(drive, drive.messages, rehearses=True)
    assert runs > 0.9 * len(plain) > 0
    for (one, base), (other, other_base) in zip(plain, rehearsed, strict=True):
        assert nav_bits(one.nav) == nav_bits(other.nav)
        assert one.covariance.tobytes() == other.covariance.tobytes()
        assert (base is None) == (other_base is None)
        assert base is None or base.T_O_B.matrix().tobytes() == other_base.T_O_B.matrix().tobytes()


def test_rehearsals_go_on_through_a_gap_and_a_clock_that_goes_back(drive):
    first_ns = drive.messages[0].arrival_ns
    silent = [m for m in drive.messages if not 9.0 < (m.arrival_ns - first_ns) * 1e-9 < 10.5]
    stepped = [
        replace(m, stamp_ns=m.stamp_ns - 60_000_000_000) if (m.arrival_ns - first_ns) * 1e-9 > 14.0 else m
        for m in silent
    ]
    found, runs = estimates(drive, stepped, rehearses=True)
    assert runs > 0.8 * len(found) > 0


def test_a_rehearsal_is_due_a_moment_before_the_next_sample_and_only_once(drive):
    with RealtimeEstimator(drive.config) as engine:
        assert engine.refresh_in_s is None
        for message in drive.until(8.0):
            engine.process(message)
            if not isinstance(message, ImuSample):
                engine.flush()
        assert engine.initialised
        sample = next(m for m in drive.between(8.0, 9.0) if isinstance(m, ImuSample) and m.sensor == "imu")
        engine.process(sample)
        due_in_s = engine.refresh_in_s
        assert due_in_s is not None
        assert 0.0 <= due_in_s <= engine._rehearsal._period_s
        engine.refresh()
        assert engine.refresh_in_s is None


def test_in_step_with_the_optimiser_there_is_nothing_to_rehearse(drive):
    with RealtimeEstimator(drive.config, in_step=True) as engine:
        for message in drive.until(1.0):
            engine.process(message)
        assert engine.refresh_in_s is None


@pytest.mark.parametrize("started", [False, True])
def test_a_program_may_refresh_whenever_it_likes(drive, started):
    with RealtimeEstimator(drive.config) as engine:
        for message in drive.until(8.0 if started else 0.5):
            engine.process(message)
            engine.refresh()
            engine.refresh()
            assert engine.refresh_in_s is None  # else a program that obeys would never sleep
            if started and not isinstance(message, ImuSample):
                engine.flush()
        assert engine.initialised == started
