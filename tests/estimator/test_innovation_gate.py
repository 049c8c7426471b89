"""The gate judges a fix by its normalised innovation squared, and never locks GNSS out."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion import Drive, estimates, fix_at, fixes, imu, in_order, machine, miss, ns, run

from holdfast.estimator.gate import HOLD_BACK, MAX_IN_A_ROW, InnovationGate, innovation_nis
from holdfast.state import Outcome

NAV = gtsam.NavState(gtsam.Rot3.Yaw(np.pi / 2), np.array([10.0, 20.0, 30.0]), np.zeros(3))
ARM = np.array([2.0, 0.0, 0.0])  # in W: 2 m to the north
FIX = np.diag([0.01, 0.04, 0.09])


def nis(offset, covariance):
    return innovation_nis(NAV, covariance, ARM, np.array([10.0, 22.0, 30.0]) + offset, FIX)


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
    assert innovation_nis(nav, P, arm, antenna(nav) + offset, FIX) == pytest.approx(expected, rel=1e-5)


def test_a_fix_within_the_gate_counts_in_full_and_beyond_it_less_with_the_square_of_the_excess():
    gate = InnovationGate(3.0)
    assert gate.inflation(0.0) == gate.inflation(9.0) == 1.0
    assert gate.inflation(18.0) == pytest.approx(4.0)
    assert gate.inflation(9.0 * HOLD_BACK) == pytest.approx(HOLD_BACK**2)
    assert gate.inflation(9.0 * HOLD_BACK + 0.01) is None


def test_after_five_contradictions_in_a_row_the_estimate_is_suspect():
    gate = InnovationGate(3.0)
    suspect = []
    for _ in range(2 * MAX_IN_A_ROW):
        assert gate.inflation(1e6) is None
        suspect.append(gate.blames_estimate())
    assert suspect == ([False] * (MAX_IN_A_ROW - 1) + [True]) * 2


def test_a_good_fix_starts_the_count_anew():
    gate = InnovationGate(3.0)
    for _ in range(MAX_IN_A_ROW):
        assert gate.inflation(1e6) is None
    assert gate.inflation(1.0) == 1.0
    assert gate.inflation(1e6) is None


def test_a_nis_that_is_not_a_number_is_held_back():
    assert InnovationGate(3.0).inflation(float("nan")) is None


def test_a_fix_that_its_successors_contradict_is_taken_out_again(monkeypatch):
    """The gate is made to believe everything; one fix in the drive is 30 sigma off."""
    monkeypatch.setattr(InnovationGate, "inflation", lambda *_: 1.0)
    drive = Drive()
    rng = np.random.default_rng(5)
    good = fixes(drive, 0.0, 8.0, 5.0, rng)
    index = next(k for k, fix in enumerate(good) if fix.stamp_ns > ns(6.0))
    wrong = fix_at(drive, (good[index].stamp_ns - ns(0.0)) * 1e-9, np.array([0.3, 0.0, 0.0]))
    messages = in_order(imu(drive, 0.0, 8.0, 100.0, rng), good[:index], [wrong], good[index + 1 :])
    estimator, outputs = run(machine(lidar=False), messages)
    assert estimator.counts["gnss", Outcome.CONTRADICTED] == 1
    (event,) = [e for e in estimator.events if e.reason == Outcome.CONTRADICTED]
    assert event.stamp_ns == wrong.stamp_ns
    assert miss(drive, estimates(outputs)[-1])[0] < 0.05  # five sigma of one fix
