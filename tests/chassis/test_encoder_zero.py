"""The encoder's zero, learnt from what the inertial measurement units of cabin and chassis measure of one motion."""

from itertools import pairwise
from math import degrees, radians, sqrt

import numpy as np
import pytest
from two_imus import Ground, TwoImus, Wrong

from holdfast.kernel.turn_joint import MAX_STEP_RAD
from holdfast.messages import JointAngle
from holdfast.state import EncoderState

ZERO_SIGMA_RAD = radians(0.1)  # as configured by default
EXACT = {"mounting_sigma_deg": 0.0}
FLAT = Ground(rate_rad_s=0.0, force_m_s2=0.0)


def end_of(machine):
    """The last state of the chassis and by how much its angle is wrong."""
    states, angles = machine.run()
    return states[-1], states[-1].joint_angle_rad - angles[-1]


def told(machine, kind, sensor):
    return [reason for what, who, reason in machine.events if (what, who) == (kind, sensor)]


def test_a_zero_that_is_wrong_by_no_more_than_it_may_be_is_found():
    for zero_rad in (-2e-3, 2e-3):
        machine = TwoImus(1, wrong=Wrong(zero_rad), base_imu=EXACT)
        state, error = end_of(machine)
        assert abs(error) < 3.0 * state.joint_angle_sigma_rad < 3.0 * 0.7 * ZERO_SIGMA_RAD
        assert told(machine, "encoder", "joint") == ["ok"]


@pytest.mark.slow
def test_forty_machines_are_as_wrong_as_their_sigmas_say():
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        zero_rad, yaw_rad = ZERO_SIGMA_RAD * rng.standard_normal(), radians(0.05) * rng.standard_normal()
        ground = Ground(*rng.uniform((0.003, 0.05, 0.0), (0.1, 2.0, 1.0)))
        wrong, mounted = Wrong(zero_rad, (0.0, 0.0, yaw_rad)), {"mounting_sigma_deg": 0.05}
        state, error = end_of(TwoImus(seed, 30.0, ground, wrong, base_imu=mounted))
        ratios.append(error / state.joint_angle_sigma_rad)
    assert np.mean(np.abs(ratios) < 3.0) >= 0.95
    assert 0.6 < np.mean(np.square(ratios)) < 1.5  # chi square of 40: 0.61 to 1.48 in 95 %


@pytest.mark.parametrize("zero_deg", [2.0, 30.0, -170.0])
def test_a_zero_that_is_grossly_wrong_is_told_and_learnt(zero_deg):
    machine = TwoImus(2, 120.0, wrong=Wrong(radians(zero_deg)), base_imu=EXACT)
    state, error = end_of(machine)
    assert state.encoder is EncoderState.WRONG_ZERO
    assert told(machine, "encoder", "joint") == ["ok", "wrong_zero"]
    assert abs(error) < 3.0 * state.joint_angle_sigma_rad < 3.0 * radians(0.07)
    *_, newest = told(machine, "calibration", "joint")
    assert float(newest.split()[3]) == pytest.approx(zero_deg, abs=0.2)


def test_sensors_on_the_chassis_get_the_angle_with_the_zero_that_was_learnt():
    machine = TwoImus(2, wrong=Wrong(radians(2.0)), base_imu=EXACT)
    reading = JointAngle(0, 0, "joint", 0.5)
    assert machine.chassis.base.corrected(reading) is reading
    machine.run()
    assert machine.chassis.base.corrected(reading).angle_rad == pytest.approx(0.5 + radians(2.0), abs=4e-3)


def test_the_correction_comes_in_without_a_step():
    states, _ = TwoImus(2, 20.0, wrong=Wrong(radians(30.0)), base_imu=EXACT).run()
    steps = [b.joint_angle_rad - b.joint_rate_rad_s * 0.01 - a.joint_angle_rad for a, b in pairwise(states)]
    assert max(map(abs, steps)) < 3.0 * MAX_STEP_RAD  # that of the encoder's noise included
    # and while it does, the sigma says how wrong the angle is
    half = next(s for s in states if s.encoder is EncoderState.WRONG_ZERO)
    assert half.joint_angle_sigma_rad > radians(20.0)


def test_where_the_ground_shows_nothing_nothing_changes():
    machine = TwoImus(3, wrong=Wrong(2e-3), ground=FLAT)
    state, error = end_of(machine)
    assert error == pytest.approx(-2e-3, abs=3e-4)
    assert state.joint_angle_sigma_rad == pytest.approx(ZERO_SIGMA_RAD, rel=0.05)
    assert told(machine, "calibration", "joint") == []


def test_without_a_base_imu_the_zero_stays_as_it_is_configured():
    machine = TwoImus(3, wrong=Wrong(radians(2.0)), has_base=False)
    state, error = end_of(machine)
    assert error == pytest.approx(-radians(2.0), abs=1e-3)
    assert state.joint_angle_sigma_rad >= ZERO_SIGMA_RAD
    assert machine.events == [("encoder", "joint", "ok")]


def test_the_zero_is_learnt_no_better_than_the_base_imu_is_mounted():
    state, error = end_of(TwoImus(1, wrong=Wrong(2e-3), base_imu={"mounting_sigma_deg": 1.0}))
    assert error == pytest.approx(-2e-3, abs=3e-4)
    assert state.joint_angle_sigma_rad > 0.98 * ZERO_SIGMA_RAD
    yawed = TwoImus(1, wrong=Wrong(rotation_rad=(0.0, 0.0, radians(2.0))), base_imu=EXACT)
    end_of(yawed)
    *_, newest = told(yawed, "calibration", "joint")
    assert "2.0" in newest.split("or ")[1]  # what may be turned instead
    assert newest.endswith("to the yaw of base_imu")


def test_a_clock_that_is_off_and_a_base_imu_that_is_tilted_do_not_look_like_a_zero():
    for wrong in (Wrong(2e-3, clock_s=0.01), Wrong(2e-3, rotation_rad=(radians(1.0), radians(-1.0), 0.0))):
        state, error = end_of(TwoImus(4, wrong=wrong, base_imu=EXACT))
        assert abs(error) < 3.0 * state.joint_angle_sigma_rad < 3.0 * 0.7 * ZERO_SIGMA_RAD


def test_a_tilt_of_the_base_imu_is_told_under_its_name():
    machine = TwoImus(4, wrong=Wrong(rotation_rad=(radians(2.0), radians(-1.5), 0.0)))
    end_of(machine)
    *_, newest = told(machine, "calibration", "base_imu")
    roll, pitch = (float(newest.split(name)[1].split()[0].strip(",")) for name in ("roll", "pitch"))
    assert (roll, pitch) == pytest.approx((2.0, -1.5), abs=0.3)
    assert told(machine, "calibration", "imu") == told(machine, "calibration", "joint") == []


def test_gyroscopes_and_accelerometers_that_contradict_each_other_teach_nothing():
    machine = TwoImus(5, wrong=Wrong(2e-3, force_yaw_rad=radians(3.0)), base_imu=EXACT)
    state, error = end_of(machine)
    assert error == pytest.approx(-2e-3, abs=1e-3)
    assert state.joint_angle_sigma_rad > 0.98 * ZERO_SIGMA_RAD
    assert any("disagree" in reason for reason in told(machine, "calibration", "joint"))


def test_what_was_learnt_is_forgotten_when_the_clock_goes_back_and_kept_otherwise():
    machine = TwoImus(1, wrong=Wrong(2e-3), base_imu=EXACT)
    machine.run()
    zero = machine.chassis.base.records[1][0]["zero"]
    assert sqrt(zero["correction_variance"]) < 0.5 * ZERO_SIGMA_RAD
    states, _ = machine.run()  # from the beginning again
    assert degrees(states[0].joint_angle_sigma_rad) > 0.1
