"""The gate of one receiver: which positions pass, when the receiver is lost, when it is regained."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import EPOCH_NS

from holdfast.config.model import GateConfig
from holdfast.events import Outcome
from holdfast.integrity.receiver import HOLD_BACK, UNEXPECTED_S, Prediction, ReceiverGate, Trust, predict
from holdfast.sensors.position import position_innovation
from holdfast.sensors.sensor import Position, State

NAV = gtsam.NavState(gtsam.Rot3.Yaw(np.pi / 2), np.array([10.0, 20.0, 30.0]), np.zeros(3))
ARM = np.array([2.0, 0.0, 0.0])  # in W: 2 m to the north
FIX = np.diag([0.01, 0.04, 0.09])
GATE = GateConfig()
NOISE = np.eye(3) * 0.01**2
STEADY = np.eye(3) * 0.005**2  # (5 mm/s)^2: an odometry holds the prediction
ACCEPTED_AFTER_S = 30.0


class Antenna:
    """A sensor of positions with a lever arm."""

    def __init__(self, p_I_P=ARM):
        self.p_I_P = p_I_P

    def innovation(self, position, state):
        return position_innovation(position, state, self.p_I_P)


def fix(offset=(0.0, 0.0, 0.0), covariance=FIX, t_s=0.0):
    stamp = EPOCH_NS + round(t_s * 1e9)
    return Position(stamp, "gnss", np.array([10.0, 22.0, 30.0]) + offset, np.asarray(covariance), 0.0)


def nis(offset, covariance):
    state = State(NAV, covariance)
    return predict(Antenna().innovation(fix(offset), state), state).nis


def judged(gate, offset=(0.0, 0.0, 0.0), t_s=0.0, *, baseline_agrees=True, delay_ns=0):
    """What a fix of 1 cm noise is worth against a state known to 1 cm."""
    prediction = Prediction(np.array(offset), NOISE, NOISE, STEADY)
    measured = fix(offset, NOISE, t_s)
    return gate.judge(measured, prediction, now_ns=measured.stamp_ns + delay_ns, baseline_agrees=baseline_agrees)


def new_gate(**settings):
    return ReceiverGate(GateConfig(**settings), 4.0**2, since_ns=0)


def test_without_uncertainty_of_the_state_the_nis_counts_sigmas_of_the_fix():
    assert nis([0.1, 0.2, 0.6], np.zeros((9, 9))) == pytest.approx(1.0 + 1.0 + 4.0)


def test_the_uncertainty_of_position_is_turned_from_the_body_to_the_world():
    covariance = np.zeros((9, 9))
    covariance[3, 3] = 0.05  # along x of I, which points north
    assert nis([0.0, 0.3, 0.0], covariance) == pytest.approx(0.09 / (0.04 + 0.05))
    assert nis([0.1, 0.0, 0.0], covariance) == pytest.approx(1.0)


def test_the_uncertainty_of_heading_acts_through_the_lever_arm():
    covariance = np.zeros((9, 9))
    covariance[2, 2] = 0.03  # 2 m to the north move east and west: 2^2 * 0.03
    assert nis([0.26, 0.0, 0.0], covariance) == pytest.approx(0.0676 / (0.01 + 0.12))
    assert nis([0.0, 0.2, 0.0], covariance) == pytest.approx(1.0)


@given(st.integers(0, 10_000))
def test_the_innovation_covariance_is_that_of_the_antenna_in_samples_of_the_state(seed):
    """First order: H from differences of the antenna's position by the nine directions of the state."""
    rng = np.random.default_rng(seed)
    nav = gtsam.NavState(gtsam.Rot3.Expmap(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 5.0, 3), rng.normal(0.0, 1.0, 3))
    root = rng.normal(0.0, 0.1, (9, 9))
    P, arm, offset = root @ root.T, rng.normal(0.0, 1.0, 3), rng.normal(0.0, 0.3, 3)

    def antenna(state):
        return state.pose().transformFrom(arm)

    H = np.column_stack([(antenna(nav.retract(e)) - antenna(nav.retract(-e))) / 2e-6 for e in 1e-6 * np.eye(9)])
    expected = offset @ np.linalg.solve(H @ P @ H.T + FIX, offset)
    measured = replace(fix(), p_W_P=antenna(nav) + offset)
    found = predict(Antenna(arm).innovation(measured, State(nav, P)), State(nav, P))
    assert found.nis == pytest.approx(expected, rel=1e-5)


def test_a_fix_loses_weight_beyond_the_gate_before_it_is_refused():
    gate = new_gate()
    limit = gate.limit
    at = [
        Prediction(np.array([np.sqrt(fraction * limit), 0.0, 0.0]), np.zeros((3, 3)), np.eye(3), STEADY)
        for fraction in (0.5, 1.0, 2.0)
    ]
    assert [gate.inflation(prediction) for prediction in at] == pytest.approx([1.0, 1.0, 4.0])
    assert limit == 16.0 and HOLD_BACK == 4.0


def test_the_power_of_the_gate_is_the_jump_that_it_just_sees_in_the_worst_direction():
    prediction = Prediction(np.zeros(3), np.diag([0.0, 0.0, 0.07]), FIX, STEADY)
    power = prediction.smallest_visible_m(16.0)
    assert power == pytest.approx(4.0 * 0.4)
    seen = replace(prediction, innovation=np.array([0.0, 0.0, power]))
    assert seen.nis == pytest.approx(16.0)


@pytest.mark.parametrize("offset", [0.2, 5.0, 1e9, np.nan])
def test_a_fix_far_from_the_prediction_is_refused(offset):
    gate = new_gate()
    assert judged(gate) is Outcome.USED
    assert judged(gate, (offset, 0.0, 0.0), 0.05) in (Outcome.INNOVATION, Outcome.TOO_FAST)
    assert gate.trust is Trust.TRUSTED


def test_an_antenna_cannot_move_faster_than_the_machine_scaled_by_the_real_time_gap():
    gate = new_gate(innovation=False, max_speed_m_s=6.0)
    assert judged(gate, t_s=0.0) is Outcome.USED
    assert judged(gate, (0.5, 0.0, 0.0), 0.05) is Outcome.TOO_FAST  # 0.3 m, and 4 sigma of two fixes are 0.1 m
    assert judged(gate, (0.5, 0.0, 0.0), 0.1) is Outcome.USED  # one fix was missing


def test_a_machine_that_is_faster_than_was_configured_is_believed():
    """An aeroplane, a train: fixes that the estimate expects show that it does move so fast."""
    gate, speed_m_s = new_gate(max_speed_m_s=6.0), 45.0
    for k in range(10):
        t_s = 0.2 * k
        prediction = Prediction(np.zeros(3), NOISE, NOISE, STEADY, speed_m_s)
        assert gate.judge(fix((speed_m_s * t_s, 0.0, 0.0), NOISE, t_s), prediction, now_ns=EPOCH_NS) is Outcome.USED
    doubtful = Prediction(np.zeros(3), NOISE, NOISE, np.eye(3) * 30.0**2, speed_m_s)
    slow = new_gate(max_speed_m_s=6.0)
    assert slow.judge(fix(), doubtful, now_ns=EPOCH_NS) is Outcome.USED
    assert slow.judge(fix((5.0, 0.0, 0.0), NOISE, 0.2), doubtful, now_ns=EPOCH_NS) is Outcome.TOO_FAST


def test_the_antennas_must_be_as_far_apart_as_they_are_mounted():
    assert judged(new_gate(), baseline_agrees=False) is Outcome.BASELINE
    assert judged(new_gate(baseline=False), baseline_agrees=False) is Outcome.USED


def lose(gate, start_s=0.0):
    for k in range(GATE.lose_after):
        assert not gate.loses(EPOCH_NS)
        judged(gate, (2.0, 0.0, 0.0), start_s + 0.05 * k)
    assert gate.loses(EPOCH_NS)
    gate.become(Trust.LOST, hold_s=GATE.regain_s)


def test_so_many_bad_fixes_in_a_row_lose_the_antenna_and_a_good_one_starts_the_count_anew():
    gate = new_gate()
    judged(gate)
    for k in range(GATE.lose_after - 1):
        judged(gate, (2.0, 0.0, 0.0), 0.05 * (k + 1))
    assert judged(gate, t_s=0.3) is Outcome.USED
    lose(gate, 0.35)


def test_fixes_that_the_receiver_reports_as_bad_count_as_well():
    gate = new_gate()
    for _ in range(GATE.lose_after):
        gate.refuse(Outcome.LARGE_COVARIANCE)
    assert gate.loses(EPOCH_NS)
    assert gate.reasons == {Outcome.LARGE_COVARIANCE: GATE.lose_after}


def test_silence_loses_the_antenna_after_a_second_or_three_periods():
    fast, slow = new_gate(), new_gate()
    for gate, period_s in ((fast, 0.05), (slow, 2.0)):
        for k in range(3):
            judged(gate, t_s=k * period_s)
    assert not fast.loses(EPOCH_NS + 1_050_000_000)
    assert fast.loses(EPOCH_NS + 1_150_000_000)
    assert not slow.loses(EPOCH_NS + 9_900_000_000)
    assert slow.loses(EPOCH_NS + 10_100_000_000)


def test_an_antenna_whose_fixes_come_late_is_not_silent():
    gate = new_gate()
    for k in range(100):
        judged(gate, t_s=0.05 * k, delay_ns=2_000_000_000)
        assert not gate.loses(EPOCH_NS + 50_000_000 * k + 2_040_000_000)


def test_good_fixes_of_a_lost_antenna_wait_in_quarantine_until_they_are_enough():
    gate = new_gate()
    gate.become(Trust.LOST)  # it was silent
    for k in range(GATE.regain_after):
        assert not gate.regains()
        assert judged(gate, t_s=0.05 * k) is Outcome.QUARANTINED
    assert gate.regains()
    assert len(gate.become(Trust.TRUSTED)) == GATE.regain_after
    assert judged(gate, t_s=1.0) is Outcome.USED


def test_a_bad_fix_empties_the_quarantine():
    gate = new_gate()
    gate.become(Trust.LOST)
    for k in range(GATE.regain_after - 1):
        judged(gate, t_s=0.05 * k)
    judged(gate, (2.0, 0.0, 0.0), 0.5)
    judged(gate, t_s=0.55)
    assert len(gate.quarantine) == 1 and not gate.regains()


def test_slow_fixes_regain_by_time_instead_of_by_number():
    gate = new_gate()
    gate.become(Trust.LOST)
    judged(gate, t_s=0.0)
    judged(gate, t_s=1.0)
    assert not gate.regains()
    judged(gate, t_s=2.0)
    assert gate.regains()


def test_a_faulty_receiver_must_be_consistent_for_longer():
    gate = new_gate()
    judged(gate)
    lose(gate)
    stamps = 10.0 + 0.05 * np.arange(41)
    for t in stamps[:-1]:
        judged(gate, t_s=t)
        assert not gate.regains()
    judged(gate, t_s=stamps[-1])
    assert gate.regains()  # two seconds


def test_fixes_that_walk_do_not_agree_with_each_other_in_quarantine():
    gate = new_gate(innovation=False)
    gate.become(Trust.LOST, hold_s=GATE.regain_s)
    for t in np.arange(0.0, 4.0, 0.05):
        judged(gate, (0.08 * t, 0.0, 0.0), t)
        assert not gate.regains()


def test_fixes_may_move_against_a_prediction_that_drifts_itself():
    gates = {}
    for sigma_m_s in (0.005, 0.3):
        gates[sigma_m_s] = new_gate()
        gates[sigma_m_s].become(Trust.LOST)
        for t in np.arange(0.0, 1.0, 0.1):
            offset = np.array([0.2 * t, 0.0, 0.0])
            prediction = Prediction(offset, np.eye(3), NOISE, np.eye(3) * sigma_m_s**2)
            gates[sigma_m_s].judge(fix(offset, NOISE, t), prediction, now_ns=EPOCH_NS)
    assert gates[0.3].regains() and not gates[0.005].regains()


@pytest.mark.parametrize(("metres", "agrees"), [(15.0, True), (90.0, False)])
def test_another_sensor_may_correct_the_prediction_meanwhile_by_as_much_as_it_was_in_doubt(metres, agrees):
    """After an outage the position is known to 20 m; a Doppler velocity comes back first, and leaves 5 m of them."""
    gate = new_gate(innovation=False)
    gate.become(Trust.LOST)
    for t, innovation_m, sigma_m in ((0.0, 0.0, 20.0), (0.1, metres, 5.0)):
        prediction = Prediction(np.array([innovation_m, 0.0, 0.0]), np.eye(3) * sigma_m**2, NOISE, STEADY)
        gate.judge(fix((0.0, 0.0, 0.0), NOISE, t), prediction, now_ns=EPOCH_NS)
    assert (len(gate.quarantine) == 2) is agrees


@pytest.mark.parametrize(("metres", "agrees"), [(1.0, True), (5.0, False)])
def test_a_prediction_may_drift_meanwhile_by_as_much_as_its_covariance_grows(metres, agrees):
    """An odometry wanders by 0.5 m between two fixes, whatever the velocity is known to."""
    gate = new_gate(innovation=False)
    gate.become(Trust.LOST)
    for t, innovation_m, variance_m2 in ((0.0, 0.0, 20.0**2), (0.5, metres, 20.0**2 + 0.5**2)):
        prediction = Prediction(np.array([innovation_m, 0.0, 0.0]), np.eye(3) * variance_m2, NOISE, STEADY)
        gate.judge(fix((0.0, 0.0, 0.0), NOISE, t), prediction, now_ns=EPOCH_NS)
    assert (len(gate.quarantine) == 2) is agrees


FIVE_SIGMA = (5.0 * np.sqrt(2.0) * 0.01, 0.0, 0.0)


def test_an_antenna_that_was_wrong_is_held_to_the_gate_itself_and_not_to_twice_of_it():
    trusted, lost = new_gate(), new_gate()
    lost.become(Trust.LOST, hold_s=GATE.regain_s)
    assert judged(trusted, FIVE_SIGMA) is Outcome.USED
    assert judged(lost, FIVE_SIGMA) is Outcome.INNOVATION


def test_one_that_was_silent_and_is_not_where_it_is_expected_must_agree_with_itself_for_longer():
    gate = new_gate()
    gate.become(Trust.LOST)
    regained = []
    for t in np.arange(1.0, 1.0 + UNEXPECTED_S + 0.5, 0.5):
        assert judged(gate, FIVE_SIGMA, t) is Outcome.QUARANTINED
        regained.append(gate.regains())
    assert regained == [False] * 10 + [True]


def test_expected_positions_after_an_unexpected_one_regain_as_if_it_had_not_been():
    gate = new_gate()
    gate.become(Trust.LOST)
    judged(gate, FIVE_SIGMA, 1.0)
    regained = []
    for k in range(GATE.regain_after):
        judged(gate, (0.04, 0.0, 0.0), 1.1 + 0.1 * k)
        regained.append(gate.regains())
    assert regained == [False] * (GATE.regain_after - 1) + [True]


def test_one_that_was_silent_and_is_beyond_twice_the_gate_is_refused():
    gate = new_gate()
    gate.become(Trust.LOST)
    assert judged(gate, np.multiply(2.0, FIVE_SIGMA)) is Outcome.INNOVATION


def test_fixes_that_contradict_but_agree_with_each_other_for_long_are_accepted():
    gate = new_gate()
    judged(gate)
    lose(gate)
    rng = np.random.default_rng(1)
    accepted = None
    for t in np.arange(1.0, 40.0, 0.05):
        judged(gate, np.array([2.0, 0.0, 0.0]) + rng.normal(0.0, 0.01, 3), t)
        if gate.contradicts_for(ACCEPTED_AFTER_S):
            accepted = t
            break
    assert accepted == pytest.approx(ACCEPTED_AFTER_S, abs=2.0)
    assert gate.distance_m() == pytest.approx(2.0, abs=0.1)


def test_fixes_that_wander_while_they_contradict_are_not_accepted():
    gate = new_gate()
    judged(gate)
    lose(gate)
    for t in np.arange(1.0, 60.0, 0.05):
        judged(gate, (2.0 + 0.1 * t, 0.0, 0.0), t)
        assert not gate.contradicts_for(ACCEPTED_AFTER_S)


def test_fixes_that_wander_are_not_accepted_because_the_prediction_gets_better():
    gate = new_gate()
    judged(gate)
    lose(gate)
    for t in np.arange(1.0, 60.0, 0.05):
        offset = np.array([8.0 + 0.1 * t, 0.0, 0.0])
        gate.judge(
            fix(offset, NOISE, t), Prediction(offset, np.eye(3) * (1.0 - t / 61.0), NOISE, STEADY), now_ns=EPOCH_NS
        )
        assert not gate.contradicts_for(ACCEPTED_AFTER_S)
