"""Random schedules are valid scenarios, repeat themselves by seed, and leave no kind of fault out."""

from collections import Counter

import pytest

from holdfast.sim.configuration import configuration
from holdfast.sim.faults import FAULTS, can_happen
from holdfast.sim.schedules import MACHINES, SITES, random_schedule
from holdfast.sim.sensors import AnySheet
from holdfast.sim.simulation import simulate


@pytest.fixture(scope="module")
def schedules():
    return [random_schedule(seed) for seed in range(100)]


def test_a_seed_names_one_schedule():
    assert random_schedule(7) == random_schedule(7)
    assert random_schedule(7) != random_schedule(8)


@pytest.mark.slow
def test_every_fault_sensor_machine_and_site_has_its_turn(schedules):
    kinds = Counter(fault.kind for schedule in schedules for fault in schedule.faults)
    assert set(kinds) == set(FAULTS)
    suffering = {
        (fault.kind, schedule.sensors[name].kind)
        for schedule in schedules
        for fault in schedule.faults
        for name in fault.sensors
    }
    silent = {"scanner", "nonholonomic"}
    able = {(fault, kind) for fault in FAULTS for kind in AnySheet.kinds.keys() - silent if can_happen(fault, kind)}
    assert suffering <= able
    assert len(suffering) > 0.8 * len(able)
    assert {schedule.machine for schedule in schedules} == set(MACHINES)
    assert {schedule.site for schedule in schedules} == set(SITES)
    assert {schedule.duration_s for schedule in schedules} == {20.0}


def test_faults_are_short_and_long_and_may_overlap(schedules):
    faults = [fault for schedule in schedules for fault in schedule.faults]
    durations = [fault.end_s - fault.start_s for fault in faults]
    assert min(durations) < 0.5
    assert max(durations) > 10.0
    assert max(len(schedule.faults) for schedule in schedules) >= 5


def test_every_schedule_makes_a_configuration_whose_sensors_are_its_own(schedules):
    for schedule in schedules:
        silent = {name for name, sheet in schedule.sensors.items() if sheet.kind == "scanner"}
        assert configuration(schedule).sensors.keys() == schedule.sensors.keys() - silent


def test_a_schedule_can_be_simulated(schedules):
    for seed, schedule in enumerate(schedules[:10]):
        simulation = simulate(schedule, seed)
        assert len(simulation.delivered["imu"].stamps_ns) > 100
