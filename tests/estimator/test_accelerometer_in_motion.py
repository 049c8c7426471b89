"""What an accelerometer is worth in motion is learnt from resolved fixes, up and down; a file that boasts is told."""

from dataclasses import replace

import numpy as np
import pytest
from motion import UP, StopAndGo, fixes, imu, in_order, machine, optimised, run, seconds

from holdfast.calibration.learnt_table import learnt_rows
from holdfast.events import EventKind
from holdfast.integrity.learnt_snapshot import accelerometer_factor

DRIVE, END_S, RATIO = StopAndGo(), 60.0, 0.005


def messages(ratio, *, hz=5.0, sigma=(0.005, 0.005, 0.01), seed=1):
    """One antenna, and an accelerometer that is wrong by a ratio of the acceleration, anew every second."""
    rng = np.random.default_rng(seed)
    errors = ratio * rng.normal(0.0, 1.0, (round(END_S) + 2, 3))
    samples = []
    for one in imu(DRIVE, 0.0, END_S, 100.0, rng, densities=(1e-3, 1e-4)):
        t = seconds(one.stamp_ns)
        accelerated = np.linalg.norm(DRIVE.readings(t)[0] - DRIVE.nav(t).attitude().unrotate(UP))
        samples.append(replace(one, specific_force=one.specific_force + errors[int(t)] * accelerated))
    return in_order(samples, fixes(DRIVE, 0.0, END_S, hz, rng, sigma))


def learnt(ratio, configured=RATIO, **changes):
    config = machine(lidar=False, imu_={"accelerometer_error_ratio": configured})
    optimiser, log, _ = optimised(config, messages(ratio, **changes))
    return optimiser, log, config


@pytest.fixture(scope="module")
def boastful():
    return learnt(0.03)


def used(optimiser):
    return optimiser.tracking.graph.main.imu_noise.force_scale


def test_one_that_is_six_times_worse_than_the_file_says_is_found(boastful):
    assert 3.0 < used(boastful[0]) < 12.0


def test_a_second_receiver_that_is_silent_does_not_vouch_for_it():
    config = machine(lidar=False, right=True, imu_={"accelerometer_error_ratio": RATIO})
    optimiser, *_ = optimised(config, messages(0.03))
    assert 3.0 < used(optimiser) < 12.0


def test_at_one_fix_a_second_too():
    assert 3.0 < used(learnt(0.03, hz=1.0)[0]) < 12.0


def test_one_that_is_as_the_file_says_or_better_is_not_doubted():
    assert used(learnt(RATIO)[0]) < 1.6
    assert used(learnt(0.001)[0]) < 1.0


def test_a_file_that_is_ten_times_too_careful_is_corrected():
    assert used(learnt(RATIO, 10.0 * RATIO)[0]) < 0.3


def test_a_file_that_boasts_is_told_with_the_value_to_write(boastful):
    optimiser, log, config = boastful
    told = [one.reason for one in log.take_events() if one.kind is EventKind.CALIBRATION and one.sensor == "imu"]
    assert [one for one in told if one.startswith("accelerometer in motion: ") and "accelerometer_error_ratio" in one]
    (row,) = [one for one in learnt_rows(optimiser.learnt(), config) if one.what == "accelerometer in motion"]
    assert row.looks_wrong and row.key == "sensors.imu.accelerometer_error_ratio" and 0.015 < float(row.write) < 0.06


def test_it_is_kept_over_a_restart(boastful):
    optimiser, _, config = boastful
    kept = optimiser.learnt()
    assert accelerometer_factor(kept.accelerometer).value == pytest.approx(used(optimiser), rel=0.1)
    estimator, _ = run(config, messages(0.03)[:800], kept)
    assert estimator.learnt().accelerometer.log_mean == pytest.approx(kept.accelerometer.log_mean, abs=0.5)


def test_fixes_that_are_not_resolved_tell_nothing_of_it():
    optimiser, *_ = learnt(RATIO, sigma=(0.3, 0.3, 0.5))
    assert optimiser.learnt().accelerometer is None
