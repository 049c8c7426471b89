"""What was learnt at the turn joint is a prior of the next start, and does no harm for long where it holds no more."""

from math import log, radians

import numpy as np
import pytest
from two_imus import Ground, TwoImus, Wrong

from holdfast.kernel.encoder_zero import REFUTED_S
from holdfast.messages import JointAngle
from holdfast.sensors.constants import LearntConstant
from holdfast.sensors.learnt_joint import NOTHING_OF_JOINT, LearntJoint
from holdfast.state import EncoderState

ZERO_SIGMA_RAD = radians(0.1)  # as configured by default
EXACT = {"mounting_sigma_deg": 0.0}
FLAT, LEVEL = Ground(rate_rad_s=0.0, force_m_s2=0.0), Ground(rate_rad_s=0.012, force_m_s2=0.4)
HARMLESS_RAD = radians(0.3)


def kept(zero_rad, sigma_rad=1e-3):
    return LearntJoint(zero=LearntConstant(mean=(zero_rad,), sigmas=(sigma_rad,)))


def errors_of(machine):
    """Times [s], errors of the joint's angle and their sigmas [rad]."""
    states, angles = machine.run()
    found = np.array([state.joint_angle_rad for state in states]) - angles
    sigmas = np.array([state.joint_angle_sigma_rad for state in states])
    times_s = 1e-9 * np.array([state.stamp_ns - states[0].stamp_ns for state in states])
    return times_s, np.abs(np.remainder(found + np.pi, 2.0 * np.pi) - np.pi), sigmas


def learnt_after(machine):
    machine.run()
    return machine.chassis.base.learnt()


@pytest.fixture(scope="module")
def yesterday():
    """What a machine has learnt whose encoder is 2 deg off, and whose base IMU is tilted."""
    wrong = Wrong(radians(2.0), rotation_rad=(radians(2.0), radians(-1.5), 0.0))
    return learnt_after(TwoImus(1, 60.0, wrong=wrong))


def test_what_is_learnt_is_what_is_otherwise_than_configured(yesterday):
    assert yesterday.zero.mean[0] == pytest.approx(radians(2.0), abs=3.0 * yesterday.zero.sigmas[0])
    assert yesterday.zero.sigmas[0] < 2e-3
    assert np.degrees(yesterday.base_tilt.mean) == pytest.approx((2.0, -1.5), abs=0.3)
    assert np.degrees(yesterday.cabin_tilt.mean) == pytest.approx((0.0, 0.0), abs=0.3)
    assert LearntJoint.model_validate_json(yesterday.model_dump_json()) == yesterday


def test_the_zero_is_right_from_the_first_estimate_of_the_next_day(yesterday):
    machine = TwoImus(2, 5.0, wrong=Wrong(radians(2.0)), ground=FLAT, learnt=yesterday)
    _, errors, sigmas = errors_of(machine)
    assert errors[0] < 3.0 * yesterday.zero.sigmas[0]
    assert errors.max() < 3.0 * sigmas[0] < 3.0 * radians(0.5)
    assert ("encoder", "joint", "wrong_zero") in machine.events
    reading = JointAngle(0, 0, "joint", 0.5)  # what a sensor on the chassis gets
    assert machine.chassis.base.corrected(reading).angle_rad == pytest.approx(0.5 + radians(2.0), abs=4e-3)


def test_the_zero_is_known_no_better_than_it_may_have_changed_overnight():
    for mounting_deg, trusted_deg in ((0.0, 0.1), (0.3, 0.1), (0.3, 5.0)):
        sections = {"base_imu": {"mounting_sigma_deg": mounting_deg}, "joint": {"zero_offset_sigma_deg": trusted_deg}}
        _, _, sigmas = errors_of(TwoImus(2, 3.0, ground=FLAT, learnt=kept(radians(20.0), 1e-5), **sections))
        may_have_changed = np.hypot(min(0.25, mounting_deg), min(0.25, trusted_deg))
        assert np.degrees(sigmas[-1]) == pytest.approx(np.hypot(may_have_changed, mounting_deg), rel=0.05)


def shown_s(seed, off_deg, ground):
    """When the motion shows a machine that has learnt nothing that its encoder is off by so much."""
    machine = TwoImus(seed, 20.0, ground, Wrong(radians(off_deg)))
    machine.run()
    return next(t for t, state in machine.chassis.encoder_states() if state is EncoderState.WRONG_ZERO)


@pytest.mark.parametrize("learnt_deg", [5.0, -5.0, 60.0])
@pytest.mark.parametrize("ground", [Ground(), LEVEL], ids=["rough", "level"])
def test_an_encoder_that_has_another_zero_than_was_learnt_costs_a_few_seconds(learnt_deg, ground):
    """The file is right, so without what was learnt the angle is right all the time."""
    for seed in range(3):
        times_s, errors, sigmas = errors_of(TwoImus(seed, 20.0, ground, learnt=kept(radians(learnt_deg))))
        assert errors[0] == pytest.approx(radians(abs(learnt_deg)), abs=radians(0.1))  # nothing contradicts it yet
        goes_out_s = REFUTED_S * log(radians(abs(learnt_deg)) / HARMLESS_RAD)
        assert times_s[errors > HARMLESS_RAD][-1] < shown_s(seed, learnt_deg, ground) + goes_out_s + 1.5
        is_going_out = (errors < radians(0.9 * abs(learnt_deg))) & (times_s > 1.0)
        assert (errors[is_going_out] < 3.0 * sigmas[is_going_out]).all()
        _, without, _ = errors_of(TwoImus(seed, 20.0, ground))
        assert errors[times_s > 19.0] == pytest.approx(without[times_s > 19.0], abs=1e-4)


@pytest.mark.parametrize("learnt_deg", [0.0, -2.0])
def test_a_file_that_is_wrong_too_is_found_sooner_than_without(learnt_deg):
    for seed in range(3):
        wrong = Wrong(radians(5.0))
        times_s, errors, _ = errors_of(TwoImus(seed, 20.0, wrong=wrong, learnt=kept(radians(learnt_deg))))
        _, without, _ = errors_of(TwoImus(seed, 20.0, wrong=wrong))
        late = times_s > 6.0
        assert (errors[late] < without[late] + 1e-3).all() and errors[late].mean() < 0.5 * without[late].mean()


def test_what_is_refuted_is_gone_and_what_was_found_instead_is_learnt():
    found = learnt_after(TwoImus(1, 20.0, learnt=kept(radians(5.0))))
    assert found.zero.mean[0] == pytest.approx(0.0, abs=3.0 * found.zero.sigmas[0])


def test_it_does_not_step_when_it_is_refuted():
    states, _ = TwoImus(1, 20.0, learnt=kept(radians(5.0))).run()
    angles = np.array([state.joint_angle_rad - 0.01 * state.joint_rate_rad_s for state in states])[1:]
    before = np.array([state.joint_angle_rad for state in states])[:-1]
    assert np.abs(angles - before).max() < 1.1 * radians(5.0) * 0.01 + 1e-3  # 5 deg with 1 s, and the encoder's noise


@pytest.mark.slow
def test_on_the_second_day_forty_machines_are_as_wrong_as_their_sigmas_say():
    """Their zero is another one than yesterday by what the configuration allows."""
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        zero_rad = radians(2.0) + ZERO_SIGMA_RAD * rng.standard_normal()
        ground = Ground(*rng.uniform((0.003, 0.05, 0.0), (0.1, 2.0, 1.0)))
        machine = TwoImus(seed, 12.0, ground, Wrong(zero_rad), base_imu=EXACT, learnt=kept(radians(2.0)))
        _, errors, sigmas = errors_of(machine)
        assert machine.chassis.base.encoder is EncoderState.WRONG_ZERO
        ratios.append([errors[row] / sigmas[row] for row in (100, 300, 600, -1)])
    assert (np.mean(np.array(ratios) < 3.0, axis=0) >= 0.95).all()
    mean_squares = np.mean(np.square(ratios), axis=0)
    assert 0.6 < mean_squares[0] < 1.5  # chi square of 40: 0.61 to 1.48 in 95 %
    assert (mean_squares[1:] < 1.5).all()  # the noise of the regressions is assumed too large at first


def test_where_the_ground_shows_nothing_it_stays_known_as_it_was(yesterday):
    assert learnt_after(TwoImus(3, 20.0, ground=FLAT, learnt=yesterday)).zero == yesterday.zero
    assert learnt_after(TwoImus(3, 20.0, ground=FLAT)).zero is None


def test_a_tilt_of_before_is_told_where_it_fits_and_forgotten_where_it_does_not(yesterday):
    wrong = Wrong(rotation_rad=(radians(2.0), radians(-1.5), 0.0))
    told = []
    for learnt in (NOTHING_OF_JOINT, yesterday):
        early = TwoImus(4, 1.5, wrong=wrong, ground=FLAT, learnt=learnt)
        early.run()
        told.append([reason for _, sensor, reason in early.events if sensor == "base_imu"])
    assert told[0] == [] and "roll +1.9" in told[1][0] and "pitch -1.4" in told[1][0]
    late = learnt_after(TwoImus(4, 60.0, learnt=yesterday))  # it sits as configured today
    assert np.degrees(late.base_tilt.mean) == pytest.approx((0.0, 0.0), abs=0.3)


def test_without_a_base_imu_nothing_is_learnt():
    assert learnt_after(TwoImus(1, 20.0, has_base=False)) == NOTHING_OF_JOINT


def test_when_the_clock_goes_back_what_was_to_be_kept_is_known_at_once():
    machine = TwoImus(1, wrong=Wrong(radians(2.0)))
    machine.run()
    machine.chassis.base.keep_learnt()
    _, errors, _ = errors_of(machine)  # from the beginning again
    assert errors[0] < radians(0.3)
