"""GNSS that is seconds behind the IMU, or ahead of it: late, or by another clock; the motion tells which."""

from dataclasses import replace

import numpy as np
import pytest
from faults import late
from motion import FigureEight, deviation, estimates, fixes, imu, in_order, machine, ns, run

from holdfast.events import EventKind, Health
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT

END_S, TRANSPORT_S = 40.0, 0.06
DRIVE = FigureEight(speed=0.35)


def driven(off_s=0.0, late_s=0.0, learnt=NOTHING_LEARNT, silent_s=0.0):
    """The estimator and its answers after a drive of 10 m/s with a receiver by another clock, or late.

    The IMU is silent at first.
    """
    rng = np.random.default_rng(1)
    samples = [one for one in imu(DRIVE, 0.0, END_S, 100.0, rng) if one.stamp_ns >= ns(silent_s)]
    antenna = fixes(DRIVE, 0.0, END_S, 5.0, rng, phase_s=0.0137)
    antenna = late(antenna, np.full(len(antenna), TRANSPORT_S + late_s))
    antenna = [replace(one, stamp_ns=one.stamp_ns + ns(off_s) - ns(0.0)) for one in antenna]
    estimator, outputs = run(machine(lidar=False, heading_deg=None), in_order(samples, antenna), learnt)
    return estimator, estimates(outputs)


def largest_m(given, after_s):
    return max(deviation(DRIVE, one)[0] for one in given if one.stamp_ns > ns(after_s))


def begun(estimator):
    return [one.reason for one in estimator.events if one.kind in (EventKind.INITIALISED, EventKind.BEGUN_ANEW)]


@pytest.mark.parametrize("off_s", [-0.9, -3.0, -8.0, 0.8, 18.0, 1e9])
def test_a_clock_that_is_off_is_found(off_s):
    """8 s behind was taken for late: it began anew again and again."""
    estimator, given = driven(off_s)
    early_s = estimator.early_ns["gnss"] * 1e-9 + estimator.constants()["clock of GNSS"].value[-1]
    assert early_s == pytest.approx(-off_s, abs=5e-3)
    assert largest_m(given, 30.0) < 0.1
    assert estimator.health is Health.NOMINAL


def test_a_receiver_that_speaks_before_the_imu_is_dated_when_that_does():
    """Its first stamps, 30 years ahead, kept the estimator waiting for an IMU that is as far."""
    estimator, given = driven(1e9, silent_s=3.0)
    assert largest_m(given, 30.0) < 0.1
    assert estimator.health is Health.NOMINAL


@pytest.mark.parametrize("late_s", [0.9, 3.0, 8.0])
def test_what_is_late_is_not_taken_for_it(late_s):
    estimator, given = driven(late_s=late_s)
    assert not estimator.early_ns
    assert abs(estimator.constants()["clock of GNSS"].value[-1]) < 0.02
    assert len(begun(estimator)) == 1
    assert given[0].stamp_ns < ns(late_s + 15.0)


def test_while_the_motion_does_not_tell_it_waits_and_says_why():
    estimator, _ = driven(-3.0)
    waited = [one.reason for one in estimator.events if one.kind is EventKind.WAITING]
    assert any("late, or by a clock that is behind" in one for one in waited)
    (reason,) = begun(estimator)
    assert "stamps of GNSS are" in reason and "early" in reason


def test_it_does_not_wait_for_ever(monkeypatch):
    patient = driven(late_s=8.0)[1]
    monkeypatch.setattr("holdfast.estimator.fitting_batch.PATIENCE_NS", 0)
    assert driven(late_s=8.0)[1][0].stamp_ns < patient[0].stamp_ns


def test_it_is_known_when_the_estimator_is_started_again():
    learnt = driven(18.0)[0].learnt()
    assert learnt.early_ns == {"gnss": -18 * 10**9}
    estimator, given = driven(18.0, learnt=learnt)
    assert not [one for one in estimator.events if one.kind is EventKind.CLOCK_STEP]
    assert largest_m(given, 15.0) < 0.3
