"""A lever arm that is wrong in the configuration: named in seconds, survived, and learnt from the motion."""

from dataclasses import replace

import numpy as np
import pytest
from motion import (
    ARM,
    ARM_RIGHT,
    Drive,
    StopAndGo,
    error,
    estimates,
    fixes,
    imu,
    in_order,
    machine,
    ns,
    run,
    scans,
    seconds,
)
from test_begun_anew import largest_step_m

from holdfast.events import EventKind, Health, Outcome
from holdfast.messages import Heading

SWINGING = StopAndGo(radius_m=5.0, speed=0.7)
DRIVE = Drive(start_s=9.0, ramp_s=4.0, radius_m=15.0, speed=0.1, tilt=0.0, heave_m=0.0)  # 1.5 m/s
END_S = 30.0
BASELINE = ARM_RIGHT - ARM
ACROSS = 0.5 * np.cross(BASELINE, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(BASELINE, [0.0, 0.0, 1.0]))
ALONG = 0.5 * BASELINE / np.linalg.norm(BASELINE)


def drive(off_right, off_left=0.0, seed=0, end_s=END_S):
    """Antennas that sit elsewhere than the configuration says, and a heading of the true baseline."""
    rng = np.random.default_rng(seed)
    left, right = ARM + off_left, ARM_RIGHT + off_right
    headings = []
    for t in np.arange(0.0, end_s, 0.1):
        x, y, _ = DRIVE.nav(t).attitude().rotate(right - left)
        headings.append(Heading(ns(t), ns(t), "heading", float(np.arctan2(y, x) + rng.normal(0.0, 5e-3)), 5e-3))
    sent = in_order(
        imu(DRIVE, 0.0, end_s, 50.0, rng),
        fixes(DRIVE, 0.0, end_s, 10.0, rng, arm=left),
        fixes(DRIVE, 0.0, end_s, 10.0, rng, arm=right, sensor="gnss_right"),
        scans(DRIVE, 0.0, end_s, 5.0, rng, (0.001, 0.01), phase_s=0.0071),
        headings,
    )
    return run(machine(right=True, heading=True), sent)


def arm_events(estimator):
    return [event for event in estimator.events if event.kind is EventKind.LEVER_ARM]


def heading_errors_deg(outputs, since_s):
    late = [one for one in estimates(outputs) if one.stamp_ns > ns(since_s)]
    truths = [DRIVE.nav(seconds(one.stamp_ns)).attitude() for one in late]
    return np.degrees([truth.between(one.nav.attitude()).rpy()[2] for truth, one in zip(truths, late, strict=True)])


@pytest.mark.parametrize(
    ("left", "right"),
    [(0.0, ACROSS), (0.0, -ACROSS), (ACROSS, 0.0), (0.0, ALONG)],
    ids=["right", "other", "left", "along"],
)
def test_a_wrong_arm_is_named_and_the_heading_is_right_after_seconds_of_driving(left, right):
    estimator, outputs = drive(right, left)
    (event,) = arm_events(estimator)
    assert seconds(event.stamp_ns) < 9.0 and event.sensor == "gnss, gnss_right"
    assert estimator.health is Health.LEVER_ARM
    assert abs(heading_errors_deg(outputs, 20.0)).max() < 3.0
    errors = np.array([error(DRIVE, one)[3:6] for one in estimates(outputs) if one.stamp_ns > ns(20.0)])
    assert np.linalg.norm(errors, axis=1).max() < 0.5
    assert largest_step_m(outputs) < 5e-3


def test_what_is_published_about_a_wrong_arm_is_as_sure_as_it_is_right():
    """NEES of attitude and position, where the machine stands in doubt, and from when the motion has told the heading.

    In the seconds between the heading moves by 15 deg, which is not linear.
    """
    ratios = []
    for seed in range(3):
        _, outputs = drive(ACROSS, seed=seed, end_s=20.0)
        for one in estimates(outputs)[::25]:
            if 7.0 < seconds(one.stamp_ns) < DRIVE.start_s or seconds(one.stamp_ns) > 13.5:
                e, P = error(DRIVE, one)[:6], one.covariance[:6, :6]
                ratios.append(e @ np.linalg.solve(P, e) / 6.0)
    assert 0.2 < np.mean(ratios) < 1.5


def test_arms_that_are_right_stay_out_of_doubt():
    estimator, outputs = drive(0.0, end_s=20.0)
    assert arm_events(estimator) == [] and estimator.health is Health.NOMINAL
    assert abs(heading_errors_deg(outputs, 5.0)).max() < 0.5


@pytest.mark.parametrize(("arm", "has_heading"), [(ARM_RIGHT, True), (ARM, False)], ids=["heading", "no-heading"])
def test_two_receivers_that_report_one_position_are_named_once_and_count_as_one(arm, has_heading):
    """One topic in two sections, or a driver that publishes a fix twice: the direction between them was divided by."""
    rng, end_s = np.random.default_rng(0), 25.0
    first, headings = fixes(SWINGING, 0.0, end_s, 10.0, rng, arm=arm), []
    for t in np.arange(0.0, end_s if has_heading else 0.0, 0.1):
        x, y, _ = SWINGING.nav(t).attitude().rotate(BASELINE)
        headings.append(Heading(ns(t), ns(t), "heading", float(np.arctan2(y, x) + rng.normal(0.0, 5e-3)), 5e-3))
    sent = in_order(
        imu(SWINGING, 0.0, end_s, 50.0, rng),
        first,
        [replace(fix, sensor="gnss_right") for fix in first],
        scans(SWINGING, 0.0, end_s, 5.0, rng, (0.001, 0.01), phase_s=0.0071),
        headings,
    )
    estimator, outputs = run(machine(right=True, heading=has_heading, heading_deg=None), sent)
    (event,) = arm_events(estimator)
    assert event.reason.startswith("both receivers report the same position") and seconds(event.stamp_ns) < 1.0
    assert estimator.counts["gnss_right", Outcome.DUPLICATE] > 240
    errors = np.array([error(SWINGING, one)[:6] for one in estimates(outputs)])
    covariances = np.array([one.covariance[:6, :6] for one in estimates(outputs)])
    assert len(errors) > 500
    assert np.linalg.norm(errors[-100:, 3:], axis=1).max() < 1.0
    ratios = [e @ np.linalg.solve(P, e) / 6.0 for e, P in zip(errors[::25], covariances[::25], strict=True)]
    assert np.mean(ratios) < 5.0
