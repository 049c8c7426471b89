"""A variation changes what it names and nothing else, and leaves a valid configuration."""

import pytest

from holdfast.config.load import config_of
from holdfast.sim.configuration import configuration_data
from holdfast.sim.scenario import load_scenario
from holdfast.trial.variations import VARIATIONS, changed


@pytest.mark.parametrize("name", VARIATIONS)
def test_every_variation_but_the_default_makes_another_valid_configuration(name: str):
    given = configuration_data(load_scenario("quick"))
    config = config_of(changed(given, VARIATIONS[name]), name)
    assert (config == config_of(given, "given")) == (name == "default")


def test_none_takes_a_sensor_away_and_values_replace_those_below():
    given = {"sensors": {"imu": {"rate": 1, "topic": "/imu"}, "lidar": {}}, "graph": {"lag_s": 3}}
    found = changed(given, {"sensors": {"lidar": None, "imu": {"rate": 2}, "radar": None}})
    assert found == {"sensors": {"imu": {"rate": 2, "topic": "/imu"}}, "graph": {"lag_s": 3}}
    assert given["sensors"]["lidar"] == {}
