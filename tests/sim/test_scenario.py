"""A scenario file describes what happens; every mistake in it gets one line."""

from pathlib import Path

import pytest

from holdfast.config.load import resolved_yaml
from holdfast.errors import ConfigError
from holdfast.sim.scenario import load_scenario, shipped
from holdfast.sim.sensors.gnss import SimulatedGnss
from holdfast.sim.sensors.odometry import SimulatedOdometry

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
def test_every_shipped_scenario_loads_and_describes_itself(name: str):
    scenario = load_scenario(name)
    assert len(scenario.description) > 30
    assert scenario.activities
    assert {"imu", "scanner"} <= scenario.sensors.keys()


def test_what_one_scenario_changes_of_a_shipped_one_does_not_reach_the_next():
    before = load_scenario("quick")
    changed = load_scenario("quick", {"duration_s": 5.0, "faults": [], "sensors": {"imu": {"rate_hz": 50.0}}})
    assert changed.sensors["imu"].rate_hz != before.sensors["imu"].rate_hz
    assert load_scenario("quick") == before


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
    gnss = scenario.sensors_of(SimulatedGnss)["gnss"]
    assert (gnss.transport.latency_s, gnss.transport.jitter_s, gnss.topic) == (0.3, 0.005, "/gnss/left/fix")
    assert (scenario.ground.seed, scenario.ground.size_m) == (9, 90.0)
    assert scenario.turn_joint is not None


def test_a_scenario_may_be_like_another_but_for_what_it_says_itself():
    rounds, boastful = load_scenario("rounds"), load_scenario("boastful-fixes")
    assert (boastful.duration_s, boastful.faults, boastful.machine) == (
        rounds.duration_s,
        rounds.faults,
        rounds.machine,
    )
    ratios = [scenario.sensors_of(SimulatedGnss)["gnss"].claim_ratio for scenario in (rounds, boastful)]
    assert ratios == [1.0, 0.4] and boastful.description != rounds.description


def test_a_machine_may_lose_a_sensor(tmp_path: Path):
    scenario = load_scenario(scenario_file(tmp_path, MINIMAL + "sensors: {gnss_right: null, heading: null}\n"))
    assert "gnss_right" not in scenario.sensors
    assert scenario.absent == ("gnss_right", "heading")


def test_a_machine_may_have_any_number_of_a_kind(tmp_path: Path):
    text = (
        MINIMAL
        + "sensors:\n"
        + "".join(f"  lidar_{n}: {{kind: odometry, topic: /lidar_{n}, frame: lidar, rate_hz: {n}}}\n" for n in (2, 3))
    )
    odometries = load_scenario(scenario_file(tmp_path, text)).sensors_of(SimulatedOdometry)
    assert {name: sheet.rate_hz for name, sheet in odometries.items()} == {"lidar": 5, "lidar_2": 2, "lidar_3": 3}


def test_a_machine_of_ones_own_lies_beside_the_scenario(tmp_path: Path):
    (tmp_path / "crane.yaml").write_text(
        "chassis: {wheelbase_m: 5, track_m: 3}\nextrinsics: [{parent: base_link, child: imu}]\n"
        "sensors: {pilot: {kind: imu, topic: /imu, frame: imu, rate_hz: 50}}\n"
    )
    scenario = load_scenario(scenario_file(tmp_path, "machine: crane.yaml\nsite: yard\nduration_s: 5\n"))
    assert list(scenario.sensors) == ["pilot"]
    assert (scenario.imu_name, scenario.imu.rate_hz) == ("pilot", 50)


def test_a_machine_of_the_old_form_is_refused_with_what_is_missing(tmp_path: Path):
    (tmp_path / "crane.yaml").write_text(
        "chassis: {wheelbase_m: 5, track_m: 3}\nextrinsics: [{parent: base_link, child: imu}]\n"
        "sensors: {imu: {topic: /imu, frame: imu, rate_hz: 50}}\n"
    )
    text = refusal(tmp_path, "machine: crane.yaml\nsite: yard\nduration_s: 5\n")
    assert "sensors.imu: kind: missing, must be one of gnss, gnss_velocity, heading, height," in text
    assert "\n" not in text


def test_the_resolved_scenario_reads_back_as_the_same_scenario(tmp_path: Path):
    for name in shipped("scenarios"):
        scenario = load_scenario(name)
        again = load_scenario(scenario_file(tmp_path, resolved_yaml(scenario)))
        assert again == scenario, name


def test_an_unknown_scenario_is_reported_with_those_that_there_are():
    with pytest.raises(ConfigError) as caught:
        load_scenario("constructoin")
    assert (
        str(caught.value)
        == f"constructoin: no such scenario (allowed: {', '.join(shipped('scenarios'))}, or a .yaml file)"
    )


@pytest.mark.parametrize(
    ("text", "report"),
    [
        (
            MINIMAL.replace("yard", "backyard"),
            "backyard: no such site (allowed: field, gallery, oberglatt, rough, wangen, yard",
        ),
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
            "mine.yaml:4 faults: freeze of entry 1 cannot happen to gnss"
            " (kinds: gnss_velocity, joint, odometry, twist)",
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
        (MINIMAL + "sensors: {gnss_right: null}\n", "sensors.heading.baseline: needs two with `kind: gnss`, not gnss"),
        (MINIMAL + "sensors: {imu: null}\n", "mine.yaml:4 sensors: needs a sensor with `kind: imu`"),
        (
            MINIMAL + "sensors: {heading: {baseline: [gnss, mast]}}\n",
            "sensors.heading.baseline: needs two with `kind: gnss`, not gnss and mast",
        ),
        (
            MINIMAL + "sensors: {radar: {kind: gns, topic: /r, frame: imu, rate_hz: 1}}\n",
            'mine.yaml:4 sensors.radar: kind = "gns": did you mean gnss? '
            "must be one of gnss, gnss_velocity, heading, height,",
        ),
    ],
)
def test_a_mistake_is_reported_with_its_line(tmp_path: Path, text: str, report: str):
    found = refusal(tmp_path, text)
    assert report in found, found
    assert "\n" not in found


def test_all_mistakes_of_the_frames_are_reported_at_once(tmp_path: Path):
    text = refusal(tmp_path, MINIMAL + "extrinsics: [{parent: roof, child: imu}]\n")
    assert "mine.yaml:4 extrinsics: parent of entry 1 must be base_link or cabin" in text
    lines = text.splitlines()
    assert len([line for line in lines if "is not among base_link, cabin, imu" in line]) == 6
