"""The filter of the turn joint: known answers of its four states, and which readings it refuses."""

from types import SimpleNamespace

import numpy as np
import pytest
from compiled import JointFilter

from holdfast.events import Outcome
from holdfast.kernel.joint_filter import GATE_SIGMA

SECOND_NS = 1_000_000_000
STEP_S = 0.01
READING, GYRO, CABIN = 1e-4**2, 2e-3**2, 1e-4**2  # variances of a reading and a rate; density of the cabin's
SURE_GYRO = SimpleNamespace(bias_variance=0.05**2, walk_variance=1e-12, noise_variance=1e-8)


def ns(t):
    return round(t * SECOND_NS)


def new_filter(gyro=SURE_GYRO, accept_after_s=5.0):
    return JointFilter(gyro, ns(0.2), ns(accept_after_s))


def run(
    joint, seconds, *, cabin=0.0, chassis=0.0, bias=0.0, start_s=0.0, angle=0.0, encoder=True, gyro=True, lag_s=0.0
):
    """Cabin and chassis rotate evenly; return the angle that is true at the end."""
    for k in range(round(seconds / STEP_S) + 1):
        t = start_s + k * STEP_S
        joint.predict(ns(t), cabin, CABIN)
        if gyro:
            joint.add_rate(ns(t), chassis + bias, GYRO)
        if encoder and k % 2 == 0:
            reading = angle + (cabin - chassis) * (t - lag_s - start_s)
            joint.add_angle(ns(t), reading, READING, joint.rotation_until(ns(t)))
    return angle + (cabin - chassis) * seconds


def test_nothing_is_known_before_a_reading_and_the_first_one_is_the_angle():
    joint = new_filter()
    joint.predict(0, 0.0, CABIN)
    assert not joint.is_known
    assert joint.add_angle(0, 0.7, READING, joint.rotation_until(0)) is Outcome.USED
    assert joint.is_known and joint.angle_rad == 0.7
    assert joint.angle_variance == pytest.approx(READING)


def test_the_angle_follows_the_cabin_and_the_chassis_between_readings():
    joint = new_filter()
    run(joint, 5.0)
    expected = run(joint, 2.0, cabin=0.6, chassis=0.1, start_s=5.0, encoder=False)
    assert joint.angle_rad == pytest.approx(expected, abs=2e-3)
    assert joint.rate_rad_s == pytest.approx(0.1, abs=2e-3)


def test_without_a_base_gyroscope_the_encoder_tells_how_the_chassis_rotates():
    joint = new_filter(None)
    expected = run(joint, 10.0, cabin=0.5, chassis=0.2, gyro=False)
    assert joint.angle_rad == pytest.approx(expected, abs=1e-3)
    assert joint.rate_rad_s == pytest.approx(0.2, abs=5e-3)
    assert joint.bias_rad_s == joint.lag_s == 0.0


def test_the_bias_of_the_base_gyroscope_is_learnt():
    joint = new_filter()
    run(joint, 30.0, cabin=0.3, chassis=0.1, bias=0.04)
    assert joint.bias_rad_s == pytest.approx(0.04, abs=1e-3)
    assert joint.rate_rad_s == pytest.approx(0.1, abs=2e-3)
    assert joint.bias_variance < 0.1 * SURE_GYRO.bias_variance


@pytest.mark.parametrize("lag_s", [-0.02, 0.03])
def test_the_lag_of_the_encoder_is_learnt_from_rotations_to_and_fro(lag_s):
    """Standing first; then a rotation of 0.6 rad/s shows a lag of 30 ms as 1 deg."""
    joint = new_filter()
    run(joint, 5.0)
    swing, t = 0.6, 5.0
    for k in range(1, 3000):
        t = 5.0 + k * STEP_S
        rate = swing * np.sin(0.5 * (t - 5.0 - 0.5 * STEP_S))  # mean over the step
        joint.predict(ns(t), rate, CABIN)
        joint.add_rate(ns(t), 0.0, GYRO)
        taken_s = max(t - lag_s, 5.0)
        reading = swing / 0.5 * (1.0 - np.cos(0.5 * (taken_s - 5.0)))
        joint.add_angle(ns(t), reading, READING, joint.rotation_until(ns(t)))
    assert joint.lag_s == pytest.approx(lag_s, abs=2e-3)
    assert joint.angle_rad == pytest.approx(swing / 0.5 * (1.0 - np.cos(0.5 * (t - 5.0))), abs=2e-3)


def test_a_wild_reading_is_refused_and_moves_nothing():
    joint = new_filter()
    run(joint, 5.0)
    before = joint.angle_rad, joint.angle_variance
    wild = joint.angle_rad + 2.0 * GATE_SIGMA * np.sqrt(joint.angle_variance + READING)
    assert joint.add_angle(ns(5.0), wild, READING, joint.rotation_until(ns(5.0))) is Outcome.INNOVATION
    assert (joint.angle_rad, joint.angle_variance) == before


def test_readings_that_contradict_for_long_are_accepted():
    joint, accepted_s = new_filter(accept_after_s=2.0), None
    run(joint, 5.0)
    for k in range(1, 500):
        t = 5.0 + k * STEP_S
        joint.predict(ns(t), 0.0, CABIN)
        joint.add_rate(ns(t), 0.0, GYRO)
        if joint.add_angle(ns(t), 1.0, READING, joint.rotation_until(ns(t))) is Outcome.USED:
            accepted_s = t - 5.0
            break
    assert accepted_s == pytest.approx(2.0, abs=0.02)
    assert joint.angle_rad == pytest.approx(1.0)


def test_whole_rotations_do_not_matter():
    joint = new_filter()
    run(joint, 3.0, angle=0.5)
    assert joint.add_angle(ns(3.0), 0.5 - 4.0 * np.pi, READING, joint.rotation_until(ns(3.0))) is Outcome.USED
    assert joint.angle_rad == pytest.approx(0.5, abs=1e-3)


def test_a_late_reading_is_carried_on_by_what_the_joint_has_turned_since_and_a_very_late_one_is_late():
    joint = new_filter()
    run(joint, 3.0)
    expected = run(joint, 0.2, cabin=1.0, start_s=3.0, encoder=False)
    before = joint.angle_variance
    assert joint.add_angle(ns(3.1), 0.1, READING, joint.rotation_until(ns(3.1))) is Outcome.USED
    assert joint.angle_rad == pytest.approx(expected, abs=1e-3)
    assert joint.angle_variance < before
    assert joint.add_angle(ns(0.5), 0.0, READING, joint.rotation_until(ns(0.5))) is Outcome.LATE


def test_the_angle_is_less_sure_the_longer_there_is_no_reading_and_time_does_not_go_back():
    joint, sigmas = new_filter(), []
    run(joint, 5.0)
    for start_s in (5.0, 7.0, 9.0):
        run(joint, 2.0, start_s=start_s, encoder=False)
        sigmas.append(joint.angle_variance**0.5)
    assert sigmas[0] < sigmas[1] < sigmas[2]
    stamp, angle = joint.stamp_ns, joint.angle_rad
    joint.predict(stamp - 1, 5.0, CABIN)
    assert (joint.stamp_ns, joint.angle_rad) == (stamp, angle)
