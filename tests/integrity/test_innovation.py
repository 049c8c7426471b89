"""The innovation test with hysteresis: what enters, when a sensor is lost, when it is regained."""

from dataclasses import dataclass

import pytest

from holdfast.config.sensors import JudgedConfig
from holdfast.events import Outcome
from holdfast.integrity.innovation import Change, InnovationGate

SECOND_NS = 1_000_000_000
SETTINGS = JudgedConfig(kind="any", gate_sigma=3.0, lose_after=3, regain_after=4)
GOOD, BAD = 1.0, 100.0


@dataclass(frozen=True, eq=False)
class Measured:
    stamp_ns: int
    sensor: str = "wheels"


def judge(gate, t_s, nis=GOOD, delay_s=0.0):
    return gate.judge(Measured(round(t_s * SECOND_NS)), nis, round((t_s + delay_s) * SECOND_NS))


def review(gate, t_s):
    return gate.review(round(t_s * SECOND_NS))


def lose(gate, start_s=0.0):
    for k in range(SETTINGS.lose_after):
        assert review(gate, start_s) is Change.NONE
        judge(gate, start_s + 0.1 * k, BAD)
    assert review(gate, start_s + 0.3) is Change.LOST
    return gate


@pytest.mark.parametrize(
    ("nis", "outcome"),
    [(0.0, Outcome.USED), (9.0, Outcome.USED), (9.01, Outcome.INNOVATION), (float("nan"), Outcome.INNOVATION)],
)
def test_a_measurement_enters_up_to_the_gate(nis, outcome):
    assert judge(InnovationGate(SETTINGS), 0.0, nis) is outcome


def test_so_many_refused_in_a_row_lose_the_sensor_and_a_good_one_starts_the_count_anew():
    gate = InnovationGate(SETTINGS)
    for t, nis in enumerate([BAD, BAD, GOOD, BAD, BAD]):
        judge(gate, 0.1 * t, nis)
        assert review(gate, 0.1 * t) is Change.NONE
    judge(gate, 0.5, BAD)
    assert review(gate, 0.5) is Change.LOST
    assert gate.is_lost and gate.reason() == "3 innovation"
    assert review(gate, 0.5) is Change.NONE  # once


def test_while_the_imu_is_silent_nothing_shows_that_a_refused_sensor_is_right_again():
    gate = lose(InnovationGate(SETTINGS))
    for k in range(1, 40):
        judge(gate, 1.0 + 0.1 * k, delay_s=-0.1 * k)
        assert review(gate, 1.0) is Change.NONE
    for k in range(21):
        assert gate.is_lost
        judge(gate, 6.0 + 0.1 * k)
        change = review(gate, 6.0 + 0.1 * k)
    assert change is Change.REGAINED
    assert min(one.stamp_ns for one in gate.take_quarantined()) == 6 * SECOND_NS


def test_what_cannot_be_compared_is_neither_good_nor_bad_nor_silence():
    gate = InnovationGate(SETTINGS)
    for k in range(20):
        assert judge(gate, 0.1 * k, Outcome.NO_JOINT_ANGLE) is Outcome.NO_JOINT_ANGLE
        assert review(gate, 0.1 * k) is Change.NONE


def test_a_faulty_sensor_is_regained_by_so_many_good_ones_over_two_seconds():
    gate = lose(InnovationGate(SETTINGS))
    for k in range(20):
        assert judge(gate, 1.0 + 0.1 * k) is Outcome.QUARANTINED
        assert review(gate, 1.0 + 0.1 * k) is Change.NONE
    judge(gate, 3.0)
    assert review(gate, 3.0) is Change.REGAINED
    assert [held.stamp_ns for held in gate.take_quarantined()][::20] == [SECOND_NS, 3 * SECOND_NS]
    assert gate.take_quarantined() == [] and not gate.is_lost
    assert judge(gate, 3.1) is Outcome.USED


def test_a_bad_one_empties_the_quarantine():
    gate = lose(InnovationGate(SETTINGS))
    for k in range(20):
        judge(gate, 1.0 + 0.1 * k)
    judge(gate, 3.0, BAD)
    judge(gate, 3.1)
    assert review(gate, 3.1) is Change.NONE
    assert len(gate.take_quarantined()) == 1


@pytest.mark.parametrize(("period_s", "patience_s"), [(0.05, 1.0), (1.0, 3.0)])
def test_silence_loses_a_sensor_after_a_second_or_three_periods(period_s, patience_s):
    gate = InnovationGate(SETTINGS)
    for k in range(4):
        judge(gate, k * period_s)
    last_s = 3 * period_s
    assert review(gate, last_s + patience_s) is Change.NONE
    assert review(gate, last_s + patience_s + 0.01) is Change.LOST
    assert gate.reason() == "silent"


def test_a_sensor_that_was_only_silent_is_regained_by_the_number_of_good_ones_alone():
    gate = InnovationGate(SETTINGS)
    judge(gate, 0.0, BAD)  # long ago, and used again since
    judge(gate, 0.1)
    assert review(gate, 5.0) is Change.LOST
    for k in range(SETTINGS.regain_after):
        assert review(gate, 5.0 + 0.1 * k) is Change.NONE
        judge(gate, 5.0 + 0.1 * k)
    assert review(gate, 5.4) is Change.REGAINED


def test_a_sensor_whose_measurements_come_late_is_not_silent():
    gate = InnovationGate(SETTINGS)
    for k in range(100):
        judge(gate, 0.1 * k, delay_s=3.0)
        assert review(gate, 0.1 * k + 3.05) is Change.NONE


def test_a_sensor_that_never_measured_is_not_lost_nor_is_a_constraint_ever_silent():
    assert review(InnovationGate(SETTINGS), 1000.0) is Change.NONE
    constraint = InnovationGate(SETTINGS, can_fall_silent=False)
    judge(constraint, 0.0)
    assert review(constraint, 1000.0) is Change.NONE


def test_what_is_held_back_elsewhere_is_noted_so_that_it_is_not_silent():
    gate = InnovationGate(SETTINGS)
    judge(gate, 0.0)
    gate.note(Measured(5 * SECOND_NS), 5 * SECOND_NS)
    assert review(gate, 5.5) is Change.NONE


def test_a_sensor_that_is_held_stays_out_however_well_it_fits_and_is_regained_when_it_is_not():
    gate = InnovationGate(SETTINGS)
    gate.hold(is_wrong=True)
    for k in range(20):
        assert judge(gate, k) is Outcome.CONTRADICTED
        assert review(gate, k) is Change.NONE and gate.is_lost
    gate.hold(is_wrong=False)
    changes = []
    for k in range(20, 40):
        judge(gate, k)
        changes.append(review(gate, k))
    assert Change.REGAINED in changes and not gate.is_lost
