"""Antennas that are elsewhere than the configuration says: found by the first curves, however far they are off."""

import numpy as np
import pytest
from motion import (
    ARM,
    ARM_RIGHT,
    FigureEight,
    at,
    fixes,
    horizontal_errors_m,
    imu,
    in_order,
    machine,
    run,
    scans,
    seconds,
)

from holdfast.estimator.estimator import Estimator
from holdfast.events import EventKind
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT
from holdfast.sensors.lever_arm import GNSS_ARM
from holdfast.sensors.registry import sensors_of
from holdfast.smoothing.batch_smoother import BatchSmoother

RTK, CONSUMER = (0.01, 0.01, 0.02), (0.4, 0.4, 0.8)
END_S, SETTLED_S = 50.0, 25.0


DRIVE = FigureEight(start_s=4.0, ramp_s=4.0, speed=0.3)  # up to 8 m/s


def recorded(shift, sigma=RTK, hz=5.0, *, right=False, lidar=False, end_s=END_S):
    """A drive with antennas that are shifted (3,) from where the configuration has them."""
    rng = np.random.default_rng(1)
    sent = [imu(DRIVE, 0.0, end_s, 50.0, rng), fixes(DRIVE, 0.0, end_s, hz, rng, sigma, arm=ARM + shift)]
    if right:
        sent.append(fixes(DRIVE, 0.0, end_s, hz, rng, sigma, arm=ARM_RIGHT + shift, sensor="gnss_right"))
    if lidar:
        sent.append(scans(DRIVE, 0.0, end_s, 5.0, rng, (0.001, 0.01), phase_s=0.0071))
    return in_order(*sent)


def driven(shift, *what, right=False, lidar=False, learnt=NOTHING_LEARNT, **more):
    """The estimator after such a drive, and what came out."""
    sent = recorded(shift, *what, right=right, lidar=lidar, **more)
    return run(machine(lidar=lidar, right=right, heading_deg=None), sent, learnt)


def worst_m(outputs, since_s=SETTLED_S):
    """The largest horizontal error from a time on."""
    return max(horizontal_errors_m(DRIVE, outputs, since_s))


@pytest.mark.parametrize("shift", [(0.5, 0.0, 0.0), (0.0, -3.0, 0.0), (10.0, 0.0, 0.0)])
def test_a_lone_antenna_is_found(shift):
    estimator, outputs = driven(shift)
    arm = estimator.constants()[GNSS_ARM]
    assert arm.is_off
    np.testing.assert_allclose(arm.value, shift, atol=0.1)
    assert worst_m(outputs) < 0.1
    told = [event.reason for event in estimator.events if event.kind is EventKind.CALIBRATION]
    assert any("beside where it is configured" in reason for reason in told)


@pytest.mark.parametrize("lidar", [False, True])
def test_two_antennas_that_are_moved_alike_are_found_though_they_are_as_far_apart_as_configured(lidar):
    shift = np.array([0.0, 1.0, 0.0])
    estimator, outputs = driven(shift, right=True, lidar=lidar)
    np.testing.assert_allclose(estimator.constants()[GNSS_ARM].value, shift, atol=0.1)
    assert worst_m(outputs) < 0.1


def test_what_was_found_is_known_from_the_start_of_the_next_day_and_found_again_if_it_is_right_then():
    shift = np.array([0.0, -3.0, 0.0])
    before, _ = driven(shift)
    learnt = before.learnt()
    estimator, outputs = driven(shift, end_s=20.0, learnt=learnt)
    assert worst_m(outputs, 7.0) < 0.15 and estimator.constants()[GNSS_ARM].is_off
    assert EventKind.BEGUN_ANEW not in {event.kind for event in estimator.events}
    _, outputs = driven(np.zeros(3), learnt=learnt)
    assert worst_m(outputs) < 0.1


def test_the_optimum_over_a_recording_begins_where_the_antennas_are():
    """A window that begins as if they were where the file has them bends by centimetres."""
    shift, config = np.array([0.0, -3.0, 0.0]), machine(lidar=False, heading_deg=None)
    batch = BatchSmoother(config)
    estimator = Estimator(config, batch)
    for message in recorded(shift):
        estimator.process(message)
    batch.stop()
    block = batch.take()[-1]
    np.testing.assert_allclose(block.constants[GNSS_ARM].value[:2], shift[:2], atol=0.02)
    track = block.track
    off = [
        position - DRIVE.nav(seconds(time)).position()
        for time, position in zip(track.times_ns.tolist(), track.positions, strict=True)
    ]
    assert np.hypot(*np.array(off).T[:2]).max() < 0.03


def test_fixes_of_half_a_metre_find_three_metres():
    shift = np.array([0.0, 3.0, 0.0])
    estimator, outputs = driven(shift, CONSUMER, 1.0, end_s=90.0)
    np.testing.assert_allclose(estimator.constants()[GNSS_ARM].value, shift, atol=0.5)
    assert worst_m(outputs, 60.0) < 1.5


@pytest.mark.parametrize(("sigma", "hz"), [(RTK, 5.0), (CONSUMER, 1.0)])
def test_antennas_that_are_right_are_held_where_they_are(sigma, hz):
    estimator, outputs = driven(np.zeros(3), sigma, hz)
    arm = estimator.constants()[GNSS_ARM]
    assert not arm.is_off and abs(arm.value).max() < 0.01
    assert worst_m(outputs) < 5.0 * sigma[0]
    kinds = {event.kind for event in estimator.events}
    assert not kinds & {EventKind.BEGUN_ANEW, EventKind.CALIBRATION}


def test_beside_a_prism_nobody_says_which_of_the_two_is_elsewhere():
    prism = {"prism": {"kind": "prism", "mount": at([0.1, 0.2, 2.0])}}
    assert sensors_of(machine(more=prism))["gnss"].parameters == ()
    assert [one.name("gnss") for one in sensors_of(machine())["gnss"].parameters] == [GNSS_ARM]
    assert sensors_of(machine(gnss_={"lever_arm_sigma_m": 0.0}))["gnss"].parameters == ()
    (own,) = sensors_of(machine(gnss_={"lever_arm_sigma_m": 0.2}))["gnss"].parameters
    assert own.name("gnss") == "gnss arm" and own.if_right is None
    np.testing.assert_array_equal(own.sigmas, 0.2)
