"""Random machines are valid, repeat themselves by seed, and their configuration knows no noise, clock or claim."""

import numpy as np
import pytest

from holdfast.config.load import config_of
from holdfast.sim.random_machine import WRITTEN, random_machine
from holdfast.sim.schedules import ADDED
from holdfast.trial.run import trials_of


@pytest.fixture(scope="module")
def machines():
    return [random_machine(seed) for seed in range(30)]


def test_a_seed_names_one_machine(machines):
    again = random_machine(7)
    assert again.scenario == machines[7].scenario and again.configuration == machines[7].configuration
    assert again.scenario != machines[8].scenario


def test_the_configuration_is_valid_and_knows_nothing_but_where_sensors_are(machines):
    for machine in machines:
        config_of(machine.configuration, "random machine")
        assert "initialisation" not in machine.configuration
        for sensor in machine.configuration["sensors"].values():
            assert set(sensor) <= set(WRITTEN)


def test_what_is_drawn_differs_as_machines_do(machines):
    sensors = [machine.scenario.sensors for machine in machines]
    assert len({one["imu"].rate_hz for one in sensors}) == 4
    assert {True, False} == {"gnss_right" in one for one in sensors} == {"lidar" in one for one in sensors}
    assert any(one["gnss"].clock.offset_s for one in sensors) and not all(one["gnss"].clock.offset_s for one in sensors)
    claims = [one["gnss"].claim_ratio for one in sensors]
    assert min(claims) < 0.6 and max(claims) > 1.8


def test_further_sensors_come_on_top(machines):
    added = set()
    for seed, machine in enumerate(machines):
        more = random_machine(seed, further=True)
        config_of(more.configuration, "random machine")
        kept = {name: more.scenario.sensors[name] for name in machine.scenario.sensors}
        assert kept == dict(machine.scenario.sensors)
        added |= more.scenario.sensors.keys() - kept.keys()
    assert added == ADDED.keys()


@pytest.mark.slow
def test_the_defaults_hold_on_one_of_them(tmp_path):
    """Position by the fixes, no step of O, and a covariance that is no worse than three times too small in sigma."""
    machine = random_machine(1)
    (outage,) = machine.scenario.faults
    earlier = outage.model_copy(update={"start_s": 35.0, "end_s": 65.0})  # as long, 75 s earlier
    scenario = machine.scenario.model_copy(update={"duration_s": 80.0, "faults": (earlier,)})
    scores = trials_of(scenario, 1, tmp_path, [config_of(machine.configuration, "1")])[0].verdict.scores
    assert scores["horizontal_ratio"] < 1.0
    assert scores["step_m"] < 0.002 and scores["step_deg"] < 0.02
    assert max(scores[key] for key in scores if "nees" in key and not np.isnan(scores[key])) < 9.0
