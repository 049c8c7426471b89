"""An encoder of the turn joint that fails is found out and reported, and the angle goes on by the gyroscopes."""

from dataclasses import replace

import numpy as np
import pytest
from slewing import (
    DRIVING,
    MAX_ATTITUDE_DEG,
    MAX_YAW_RATE_RAD_S,
    TIMES,
    Chassis,
    Machine,
    calibrated,
    estimates,
    machine,
    ns,
    received,
    rms,
    run_simulated,
    simulated,
)

from holdfast.config.model import Config
from holdfast.messages import JointAngle
from holdfast.state import EncoderState

SLEW_S = (5.0, 9.0)  # the cabin turns by 2.3 rad
# scale errors of 5e-4 of two gyroscopes over 2.3 rad, and a bias known to 1e-4 rad/s: 1.7 mrad; three times that
GYRO_ONLY_RAD = 5e-3


@pytest.mark.parametrize(("kind", "text", "after_s"), [("freeze", "frozen", 0.1), ("silence", "late", 0.21)])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_angle_goes_on_by_the_gyroscopes_when_the_encoder_fails_and_that_is_reported(kind, text, after_s, seed):
    run, found = run_simulated(simulated(seed, ((kind, "joint", *SLEW_S),)))
    times, texts = zip(*run.encoder_states(), strict=True)
    assert texts == ("ok", text, "ok")
    assert SLEW_S[0] < times[1] <= SLEW_S[0] + after_s
    assert SLEW_S[1] < times[2] <= SLEW_S[1] + 0.1
    assert abs(found.between(*SLEW_S).angle_rad).max() < GYRO_ONLY_RAD
    assert rms(found.between(*SLEW_S).rate_rad_s[:, 2]) <= MAX_YAW_RATE_RAD_S
    assert rms(found.between(SLEW_S[1] + 2.0, 40.0).angle_rad) < 0.5e-3
    # an IMU-rate consumer of T_O_B sees no step: the bound of T_O_I
    assert abs(np.diff(found.angle_rad)).max() < np.radians(0.02)
    reported = {state.encoder for state, t in zip(found.states, found.times_s, strict=True) if 5.3 < t < 9.0}
    assert reported == {EncoderState(text)}
    growing = [state.joint_angle_sigma_rad for state in found.states]
    rows = np.searchsorted(found.times_s, [5.3, 8.9])
    assert growing[rows[1]] > growing[rows[0]]


def test_a_frozen_encoder_is_found_out_before_it_has_pulled_the_chassis_along_with_a_slow_slew():
    # it freezes while the machine stands; then the cabin starts to turn by 0.6 rad/s^2
    run, found = run_simulated(simulated(1, (("freeze", "joint", 1.5, 6.0),)))
    assert [text for _, text in run.encoder_states()] == ["ok", "frozen", "ok"]
    # if a repeated reading weighed as much as a new one: 7 mrad
    assert abs(found.between(2.0, 6.0).angle_rad).max() < GYRO_ONLY_RAD


def test_nothing_is_known_until_the_encoder_has_sent_a_reading():
    run, found = run_simulated(simulated(1, (("silence", "joint", 0.0, 3.0),)))
    assert found.times_s[0] >= 3.0
    assert run.base.encoder is EncoderState.OK
    absent = Chassis(machine())
    assert absent.run(estimates(DRIVING), [m for m in received(DRIVING) if m.sensor != "joint"]) == [None] * len(TIMES)
    assert absent.base.encoder is EncoderState.ABSENT


@pytest.mark.parametrize("offset_s", [-0.02, 0.03])
def test_stamps_that_are_off_by_a_time_that_nobody_knows_are_learnt_in_one_slew(offset_s):
    # 30 ms at 0.6 rad/s: 1 deg
    _, found = run_simulated(simulated(1, (), offset_s))
    again = found.between(25.0, 40.0)
    assert again.slew_rad_s.max() > 0.5
    assert np.degrees(rms(again.attitude_rad)) <= MAX_ATTITUDE_DEG
    assert abs(np.diff(found.angle_rad)).max() < np.radians(0.02)


@pytest.mark.parametrize("offset_s", [0.0, 0.03])
def test_a_base_gyroscope_that_is_believed_to_be_ten_times_noisier_than_it_is_does_no_harm(offset_s):
    simulation = simulated(1, (), offset_s)
    data = calibrated(simulation).model_dump(exclude_unset=True)
    data["sensors"]["base_imu"]["gyroscope_noise_density"] = 2e-3
    errors_rad = [
        rms(run_simulated(simulation, config)[1].between(25.0, 40.0).attitude_rad)
        for config in (None, Config.model_validate(data))
    ]
    assert errors_rad[1] < 2.0 * errors_rad[0]


@pytest.mark.parametrize("step_rad", [1e-6, 6e-3, 0.02])
def test_an_encoder_with_a_coarse_step_is_not_frozen(step_rad):
    swaying = replace(DRIVING, swing_rad=0.3)
    messages = [
        replace(m, angle_rad=float(np.round(m.angle_rad / step_rad) * step_rad)) if isinstance(m, JointAngle) else m
        for m in received(swaying)
    ]
    noise_deg = float(np.degrees(step_rad) / np.sqrt(12))
    run = Chassis(machine(joint={"noise_deg": max(noise_deg, 1e-3)}))
    states = run.run(estimates(swaying), messages)
    assert [text for _, text in run.encoder_states()] == ["ok"]
    errors = np.array([s.joint_angle_rad - swaying.angle(t) for s, t in zip(states[300:], TIMES[300:], strict=True)])
    assert abs(errors).max() < max(step_rad, 1e-3)


def test_without_encoder_and_base_imu_the_angle_has_a_growing_sigma():
    _, found = run_simulated(simulated(1, (("silence", "joint", *SLEW_S),)), names=("joint",))
    rows = np.searchsorted(found.times_s, [4.9, 5.5, 8.9])
    sigmas = [found.states[row].joint_angle_sigma_rad for row in rows]
    assert sigmas[0] < 3e-3 < sigmas[1] < sigmas[2]
    assert found.states[rows[2]].encoder is EncoderState.LATE
    assert abs(found.angle_rad[rows[2]]) < 3 * sigmas[2]


def test_a_gap_of_the_base_imu_leaves_the_angle_to_the_encoder():
    run, found = run_simulated(simulated(1, (("silence", "base_imu", *SLEW_S),)))
    assert np.degrees(rms(found.between(*SLEW_S).attitude_rad)) <= MAX_ATTITUDE_DEG
    assert rms(found.between(*SLEW_S).rate_rad_s[:, 2]) <= 0.02
    assert rms(found.between(SLEW_S[1] + 0.5, 40.0).rate_rad_s[:, 2]) <= MAX_YAW_RATE_RAD_S
    assert [text for _, text in run.encoder_states()] == ["ok"]


def test_one_wild_reading_is_refused_and_moves_nothing():
    wild = JointAngle(ns(8.0005), ns(8.004), "joint", float(DRIVING.angle(8.0) + 0.5))
    messages = received(DRIVING)
    run = Chassis(machine())
    states = run.run(estimates(DRIVING), [*messages, wild])
    clean = Chassis(machine()).run(estimates(DRIVING), messages)
    assert run.counts["joint", "innovation"] == 1
    assert abs(states[810].joint_angle_rad - clean[810].joint_angle_rad) < 1e-12


@pytest.mark.parametrize(("base_imu", "after_s"), [(True, 5.0), (False, 0.2)])
def test_an_encoder_with_a_new_zero_is_accepted_in_the_end(base_imu, after_s):
    still = Machine(np.zeros(3), np.zeros(3), swing_rad=0.0)
    times = np.arange(0.0, 12.0, 0.01)
    messages = [replace(m, angle_rad=m.angle_rad + 1.0) if m.stamp_ns > ns(2.0) else m for m in readings(still, times)]
    messages += [still.base_sample(t + 0.006) for t in times] if base_imu else []
    states = Chassis(machine(base_imu=base_imu)).run(estimates(still, times), messages)
    angles = np.array([state.joint_angle_rad for state in states[2:]])
    moved_s = times[2:][abs(angles - 0.3) > 0.01][0]  # it flows there
    assert moved_s == pytest.approx(2.0 + after_s, abs=0.05)
    assert angles[-1] == pytest.approx(1.3, abs=1e-3)
    assert EncoderState.LATE in {state.encoder for state in states[2:]}


def readings(motion, times):
    return [motion.reading(t + 0.003) for t in times]
