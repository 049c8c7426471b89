"""A warm-up fetches what the IMU path needs into the caches, and changes nothing else."""

from dataclasses import replace

import pytest
from engine import nav_bits

from holdfast.estimator.estimator import Estimator
from holdfast.estimator.health import HealthMonitor
from holdfast.messages import ImuSample, JointAngle
from holdfast.realtime.engine import RealtimeEstimator
from holdfast.realtime.records import Published, Records
from holdfast.realtime.warm_up import WarmUp


def estimates(drive, messages, warms_up):
    """The estimates, and how often there was something to warm up."""
    config, records = drive.config, Records(drive.config)
    estimator, warm_up, found, runs = Estimator(config), WarmUp(config, records), [], 0
    newest = Published(0, 1, 1, 0, False, (), HealthMonitor(config).snapshot(), 9.81, None, None)
    for message in messages:
        output = estimator.process(message)
        if output.estimate is not None:
            found.append((output.estimate, output.base))
        if output.optimised is not None:
            newest = replace(newest, state=output.optimised)
        if not warms_up:
            continue
        if isinstance(message, ImuSample) and message.sensor == config.imu_name:
            warm_up.note(message)
            runs += newest.state is not None
            warm_up.run(newest)
            assert warm_up.due_in_s is None
        elif isinstance(message, ImuSample | JointAngle):
            warm_up.add_to_chassis(message)
    return found, runs


def test_estimates_with_warm_ups_are_the_same_to_the_bit(drive):
    plain, _ = estimates(drive, drive.messages, warms_up=False)
    warmed, runs = estimates(drive, drive.messages, warms_up=True)
    assert runs > 0.9 * len(plain) > 0
    for (one, base), (other, other_base) in zip(plain, warmed, strict=True):
        assert nav_bits(one.nav) == nav_bits(other.nav)
        assert one.covariance.tobytes() == other.covariance.tobytes()
        assert (base is None) == (other_base is None)
        assert base is None or base.T_O_B.matrix().tobytes() == other_base.T_O_B.matrix().tobytes()


def test_warm_ups_go_on_through_a_gap_and_a_clock_that_goes_back(drive):
    first_ns = drive.messages[0].arrival_ns
    silent = [m for m in drive.messages if not 9.0 < (m.arrival_ns - first_ns) * 1e-9 < 10.5]
    stepped = [
        replace(m, stamp_ns=m.stamp_ns - 60_000_000_000) if (m.arrival_ns - first_ns) * 1e-9 > 14.0 else m
        for m in silent
    ]
    found, runs = estimates(drive, stepped, warms_up=True)
    assert runs > 0.8 * len(found) > 0


def test_a_warm_up_is_due_a_moment_before_the_next_sample_and_only_once(drive):
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
        assert 0.0 <= due_in_s <= 0.011  # samples come each 10 ms
        engine.refresh()
        assert engine.refresh_in_s is None


def test_in_step_with_the_optimiser_there_is_nothing_to_warm_up(drive):
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
