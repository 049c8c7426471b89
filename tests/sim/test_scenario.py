"""A scenario file says what happens; every mistake in it gets one line."""

from pathlib import Path

import pytest

from holdfast.config.load import resolved_yaml
from holdfast.errors import ConfigError
from holdfast.sim.scenario import load_scenario, shipped

MINIMAL = "machine: excavator_low\nsite: yard\nduration_s: 5\n"


def scenario_file(folder: Path, text: str) -> str:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_scenario(scenario_file(folder, text))
    return str(caught.value)


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_every_shipped_scenario_loads_and_says_what_it_is(name: str):
    scenario = load_scenario(name)
    assert len(scenario.description) > 30
    assert scenario.activities
    assert {"imu", "gnss", "lidar", "scanner"} <= scenario.sensors.present().keys()


def test_the_scenarios_of_the_paper_have_its_outages_and_places():
    construction, navigation = load_scenario("construction"), load_scenario("navigation")
    assert (construction.duration_s, navigation.duration_s) == (600, 600)
    assert {(f.start_s, f.end_s) for f in construction.faults} == {(105, 150)}
    assert {(f.start_s, f.end_s) for f in navigation.faults} == {(220, 380)}
    assert construction.datum.latitude_deg == 47.4801402
    assert navigation.datum.latitude_deg == 47.234593265
    assert construction.extrinsics != navigation.extrinsics


def test_machine_and_site_supply_what_the_scenario_does_not_say(tmp_path: Path):
    text = MINIMAL + "sensors:\n  gnss: {transport: {latency_s: 0.3}}\nground: {seed: 9}\n"
    scenario = load_scenario(scenario_file(tmp_path, text))
    assert scenario.sensors.gnss is not None
    assert scenario.sensors.gnss.transport.latency_s == 0.3
    assert scenario.sensors.gnss.transport.jitter_s == 0.005
    assert scenario.sensors.gnss.topic == "/gnss/left/fix"
    assert (scenario.ground.seed, scenario.ground.size_m) == (9, 90.0)
    assert scenario.turn_joint is not None


def test_a_machine_may_lose_a_sensor(tmp_path: Path):
    scenario = load_scenario(scenario_file(tmp_path, MINIMAL + "sensors: {gnss_right: null, heading: null}\n"))
    assert "gnss_right" not in scenario.sensors.present()


def test_a_machine_of_ones_own_lies_beside_the_scenario(tmp_path: Path):
    (tmp_path / "crane.yaml").write_text(
        "chassis: {wheelbase_m: 5, track_m: 3}\nextrinsics: [{parent: base_link, child: imu}]\n"
        "sensors: {imu: {topic: /imu, frame: imu, rate_hz: 50}}\n"
    )
    scenario = load_scenario(scenario_file(tmp_path, "machine: crane.yaml\nsite: yard\nduration_s: 5\n"))
    assert list(scenario.sensors.present()) == ["imu"]


def test_the_resolved_scenario_reads_back_as_the_same_scenario(tmp_path: Path):
    for name in shipped("scenarios"):
        scenario = load_scenario(name)
        again = load_scenario(scenario_file(tmp_path, resolved_yaml(scenario)))
        assert again == scenario, name


def test_an_unknown_scenario_is_told_with_those_that_there_are():
    with pytest.raises(ConfigError) as caught:
        load_scenario("constructoin")
    assert (
        str(caught.value)
        == f"constructoin: no such scenario (allowed: {', '.join(shipped('scenarios'))}, or a .yaml file)"
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (MINIMAL.replace("yard", "backyard"), "backyard: no such site (allowed: oberglatt, rough, wangen, yard"),
        (MINIMAL.replace("excavator_low", "tank"), "tank: no such machine (allowed: dumper, excavator_low"),
        (MINIMAL + "duration: 5\n", "mine.yaml:4 duration: unknown key, did you mean duration_s?"),
        (
            MINIMAL + "activities:\n  - {stand_s: 2, slew_to_deg: 5}\n",
            "mine.yaml:5 activities[0]: an activity has one of",
        ),
        (MINIMAL + "activities:\n  - {repeat: 3}\n", "mine.yaml:5 activities[0]: repeat needs `of`"),
        (
            MINIMAL + "activities:\n  - {drive_to: [[1, 2]]}\n",
            "mine.yaml:5 activities[0].drive_to: unknown key, did you mean",
        ),
        (
            MINIMAL + "faults:\n  - {kind: freeze, sensors: [gnss], start_s: 1, end_s: 2}\n",
            "mine.yaml:5 faults[0].sensors: freeze cannot happen to gnss (allowed: joint)",
        ),
        (
            MINIMAL + "faults:\n  - {kind: outage, sensors: [gnss], start_s: 3, end_s: 2}\n",
            "mine.yaml:5 faults[0].end_s: 2 lies before start_s 3",
        ),
        (
            MINIMAL
            + "sensors: {heading: null}\nfaults:\n  - {kind: silence, sensors: [heading], start_s: 1, end_s: 2}\n",
            "the machine has no heading",
        ),
        (MINIMAL + "sensors: {gnss: {rate_hz: 0}}\n", "mine.yaml:4 sensors.gnss.rate_hz = 0: must be > 0 [Hz]"),
        (MINIMAL + "sensors: {gnss: {frame: mast}}\n", "sensors.gnss.frame: 'mast' is not among base_imu, base_link"),
        (MINIMAL + "extrinsics: [{parent: roof, child: imu}]\n", "parent of entry 1 must be base_link or cabin"),
    ],
)
def test_a_mistake_is_told_with_its_place(tmp_path: Path, text: str, said: str):
    told = refusal(tmp_path, text)
    assert said in told, told
    assert "\n" not in told
