"""What was learnt of the sensors survives a restart that nobody asked for, and the night; it holds nothing for good."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from motion import (
    T_I_L,
    Drive,
    StopAndGo,
    error,
    estimates,
    fixes,
    imu,
    in_order,
    link,
    machine,
    optimised,
    run,
    scans,
    seconds,
)

from holdfast.estimator.imu_path import receive
from holdfast.estimator.optimiser import Optimiser
from holdfast.event_log import EventLog
from holdfast.events import EventKind, Outcome
from holdfast.integrity.learnt_snapshot import NOTHING_LEARNT, LearntSnapshot

DRIVE = Drive()
LONG = StopAndGo(radius_m=4.0, speed=0.35)
END_S = 40.0
TURNED, OTHERWISE = np.radians([1.5, -1.0, 2.0]), np.radians([-1.0, 1.5, -1.0])


def messages(end_s=12.0):
    rng = np.random.default_rng(1)
    return in_order(
        imu(DRIVE, 0.0, end_s, 100.0, rng),
        fixes(DRIVE, 0.0, end_s, 10.0, rng),
        scans(DRIVE, 0.0, end_s, 5.0, rng, (1e-3, 0.05)),
    )


@pytest.fixture(scope="module")
def known():
    """What an optimiser has learnt in twelve seconds."""
    return optimised(machine(), messages())[0].learnt()


def test_an_optimiser_learns_of_odometries_fixes_and_constants(known):
    assert known.odometries["lidar"].translation_noise is not None
    assert known.noise["gnss"].log_factor != 0.0
    assert len(known.constants["lidar"].mean) == 4 and "clock of GNSS" in known.constants


def test_it_survives_a_file(known):
    assert LearntSnapshot.model_validate_json(known.model_dump_json()) == known


def test_it_is_there_before_and_after_the_start_that_follows(known):
    optimiser = Optimiser(machine(), optimised(machine(), [])[2], EventLog("imu"), learnt=known)
    assert optimiser.learnt() == known
    later = Optimiser(machine(), optimised(machine(), [])[2], EventLog("imu"), learnt=known)
    for message in messages(4.0):
        later.add(message) if not hasattr(message, "specific_force") else later.receive(receive(later._buffer, message))
        if later.is_due:
            later.update()
    assert later.tracking is not None
    before, after = (one.odometries["lidar"].translation_noise.log_mean for one in (known, later.learnt()))
    assert after == pytest.approx(before, abs=0.3)


def test_a_clock_that_goes_back_does_not_make_it_forget():
    optimiser, log, buffer = optimised(machine(), messages(6.0))
    before = optimiser.learnt()
    for sample in imu(DRIVE, 6.01, 6.5):
        shifted = replace(sample, stamp_ns=sample.stamp_ns - 3_600_000_000_000)
        if buffer.check(shifted) is Outcome.USED:
            optimiser.receive(receive(buffer, shifted))
    assert [event.kind for event in log.take_events()].count(EventKind.CLOCK_STEP) == 1
    assert optimiser.tracking is None
    assert before.odometries and optimiser.learnt() == before


def test_a_new_datum_does_not_make_it_forget_but_a_reset_does():
    optimiser, _, _ = optimised(machine(), messages(6.0))
    datum, before = optimiser.world.datum, optimiser.learnt()
    optimiser.restart(datum)
    assert before != NOTHING_LEARNT and optimiser.learnt() == before
    optimiser.restart()
    assert optimiser.learnt() == NOTHING_LEARNT


def test_a_reset_forgets_a_file_too(known):
    estimator, _ = run(machine(), messages(4.0), known)
    estimator.reset()
    assert estimator.learnt() == NOTHING_LEARNT


def test_an_estimate_that_was_wrong_keeps_noise_but_no_constants():
    optimiser, _, _ = optimised(machine(), messages(12.0))
    before = optimiser.learnt()
    optimiser._begin_anew(optimiser.tracking, optimiser.tracking.graph.published.newest, optimiser._without_heading())
    now = optimiser.learnt()
    assert before.constants["clock of GNSS"].sigmas[0] < 1e-3
    arm = now.constants.pop("arm of GNSS")  # on which the state rests
    assert now.constants == {} and not arm.is_off
    was, is_now = (one.odometries["lidar"].translation_noise for one in (before, now))
    assert is_now.log_mean == pytest.approx(was.log_mean, abs=0.1)
    assert now.noise == before.noise


def test_an_estimate_that_begins_anew_trusts_an_odometry_no_more_than_before():
    optimiser, _, _ = optimised(machine(), messages(6.0))
    optimiser.tracking._odometries._odometries["lidar"].learning.trust_less(3.0)
    optimiser._begin_anew(optimiser.tracking, optimiser.tracking.graph.published.newest, optimiser._without_heading())
    assert optimiser.tracking._odometries.noises["lidar"].scale == 3.0


# --- constants --------------------------------------------------------------------------------------------------------


def drive(turned, learnt=NOTHING_LEARNT, lidar_late_s=0.0, seed=0, end_s=END_S):
    """The estimator after a drive with a lidar that sits otherwise than the file says, and its errors over time."""
    rng = np.random.default_rng(seed)
    sent = in_order(
        imu(LONG, 0.0, end_s, 100.0, rng),
        fixes(LONG, 0.0, end_s, 10.0, rng),
        scans(LONG, 0.0, end_s, 5.0, rng, (3e-4, 0.005), phase_s=0.0071, stamp_shift_s=lidar_late_s, delay_s=0.1),
    )
    config = machine()
    mount = T_I_L * gtsam.Pose3(gtsam.Rot3.Expmap(-np.asarray(turned)), np.zeros(3))
    links = [one for one in config.model_dump()["extrinsics"] if one["child"] != "lidar"]
    data = config.model_dump(exclude_unset=True) | {"extrinsics": [*links, link("imu", "lidar", mount)]}
    estimator, outputs = run(type(config).model_validate(data), sent, learnt)
    squares = [(seconds(one.stamp_ns), float(np.sum(error(LONG, one)[3:6] ** 2))) for one in estimates(outputs)]
    return estimator, squares


def rms_m(squares, start_s, end_s):
    return float(np.sqrt(np.mean([one for t, one in squares if start_s <= t < end_s])))


@pytest.fixture(scope="module")
def yesterday():
    return drive(TURNED, lidar_late_s=0.035)[0].learnt()


def test_mounting_and_clock_hold_from_the_start_of_the_next_day(yesterday):
    estimator, _ = drive(TURNED, yesterday, lidar_late_s=0.035, seed=1, end_s=4.0)
    found, without = (one.constants()["lidar"] for one in (estimator, drive(TURNED, end_s=4.0)[0]))
    assert found.is_off and found.value[3] == pytest.approx(-0.035, abs=0.006)
    assert np.degrees(np.linalg.norm(found.value[:3] - TURNED)) < 0.4
    assert np.degrees(np.linalg.norm(without.value[:3] - TURNED)) > 1.0


def test_no_constant_is_known_better_than_it_may_have_changed_overnight(yesterday):
    estimator, _ = drive(TURNED, yesterday, lidar_late_s=0.035, end_s=3.5)
    found = estimator.constants()["lidar"]
    assert (yesterday.constants["lidar"].sigmas[0]) < np.radians(0.25)
    assert found.sigmas[:3].max() > np.radians(0.1) and found.sigmas[3] > 1e-3


def test_a_lidar_that_was_moved_overnight_is_found_and_costs_nothing_in_the_end(yesterday):
    estimator, squares = drive(OTHERWISE, yesterday, seed=1)
    _, expected = drive(OTHERWISE, seed=1)
    assert np.degrees(np.linalg.norm(estimator.constants()["lidar"].value[:3] - OTHERWISE)) < 0.5
    assert abs(estimator.constants()["lidar"].value[3]) < 6e-3
    assert rms_m(squares, END_S / 2, END_S) < 1.2 * rms_m(expected, END_S / 2, END_S)


def test_what_is_not_configured_or_has_another_size_is_left_alone(yesterday):
    strange = yesterday.constants["lidar"].model_copy(update={"mean": (1.0,), "sigmas": (1.0,)})
    learnt = yesterday.model_copy(update={"constants": {"lidar": strange, "radar": strange}})
    estimator, _ = drive(TURNED, learnt, end_s=4.0)
    assert len(estimator.constants()["lidar"].value) == 4 and "radar" not in estimator.constants()
