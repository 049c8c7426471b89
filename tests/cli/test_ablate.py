"""`holdfast ablate` runs one scenario under many configurations into one table."""

import csv
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from holdfast.cli import holdfast
from holdfast.config.load import config_of, parse_config
from holdfast.errors import ConfigError
from holdfast.evaluation.measures import MEASURES
from holdfast.sim.configuration import configuration, configuration_data
from holdfast.sim.scenario import load_scenario
from holdfast.trial.variations import VARIATIONS, changed

SHORT = """\
machine: excavator_low
site: yard
duration_s: 9
activities:
  - stand_s: 2.0
  - drive_to_m: [[4.0, 1.0]]
faults:
  - {kind: outage, sensors: [gnss, gnss_right, heading], start_s: 6.5, end_s: 8.0}
"""


def run(*arguments: str) -> str:
    result = CliRunner().invoke(holdfast, ["ablate", *arguments], catch_exceptions=False, standalone_mode=False)
    assert result.exit_code == 0
    return result.output


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("scenario") / "short.yaml"
    file.write_text(SHORT, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def ablated(tmp_path_factory: pytest.TempPathFactory, scenario: Path) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp("ablated") / "out"
    chosen = ["--only", "no-lidar", "--only", "default"]
    return run(str(scenario), "-o", str(folder), "--seeds", "2", "--jobs", "2", *chosen), folder


@pytest.mark.slow
def test_the_table_on_the_screen_has_a_line_per_variation_that_fits_a_terminal(ablated: tuple[str, Path]):
    # on a busy machine it takes more than ten seconds, and tells its progress before
    title, head, *lines = [line for line in ablated[0].splitlines() if not line.startswith("ablating")]
    assert "2 seeds" in title
    assert head.split()[0] == "variation"
    assert [line.split()[0] for line in lines[:2]] == ["default", "no-lidar"]
    assert max(map(len, [head, *lines[:2]])) <= 120


def test_the_tables_in_files_hold_means_and_every_seed(ablated: tuple[str, Path]):
    _, folder = ablated
    with (folder / "table.csv").open(encoding="utf-8") as file:
        means = {row["variation"]: row for row in csv.DictReader(file)}
    entries = json.loads((folder / "table.json").read_text(encoding="utf-8"))
    assert [(entry["variation"], entry["seed"]) for entry in entries] == [
        ("default", 0),
        ("default", 1),
        ("no-lidar", 0),
        ("no-lidar", 1),
    ]
    for name, row in means.items():
        scores = [entry["scores"]["outage_horizontal_rms_m"] for entry in entries if entry["variation"] == name]
        assert float(row["outage_horizontal_rms_m"]) == pytest.approx(sum(scores) / 2)
        assert row["seeds"] == "2"


def test_without_lidar_no_measure_of_it_is_given_and_the_estimate_is_another(ablated: tuple[str, Path]):
    entries = json.loads((ablated[1] / "table.json").read_text(encoding="utf-8"))
    default, without = entries[0]["scores"], entries[2]["scores"]
    assert default["outage_horizontal_rms_m"] != without["outage_horizontal_rms_m"]
    assert entries[2]["changes"] == {"sensors": {"lidar": None}}


def test_the_recordings_stay_and_can_be_replayed(ablated: tuple[str, Path], tmp_path: Path):
    seed = ablated[1] / "seed-1"
    replay = ["replay", str(seed / "recording.mcap"), "-c", str(seed / "config.yaml"), "-o", str(tmp_path / "out")]
    assert CliRunner().invoke(holdfast, replay, catch_exceptions=False).exit_code == 0


@pytest.mark.parametrize("name", VARIATIONS)
def test_every_variation_is_a_valid_configuration_that_differs_from_the_default(name: str):
    given = configuration_data(load_scenario("quick"))
    default, other = (config_of(changed(given, VARIATIONS[n]), n) for n in ("default", name))
    assert (default == other) == (name == "default")


def test_the_default_is_the_configuration_that_goes_with_the_scenario():
    scenario = load_scenario("quick")
    assert config_of(changed(configuration_data(scenario), {}), "x") == configuration(scenario)


def test_the_paper_variation_is_the_preset():
    given = configuration_data(load_scenario("quick"))
    config = config_of(changed(given, VARIATIONS["paper"]), "x")
    assert config.graph == parse_config("preset: paper\nsensors: {imu: {kind: imu, topic: /i}}").graph


def test_an_overlay_replaces_single_values_and_takes_sensors_away():
    given = {"a": {"b": 1, "c": {"d": 2}}, "e": {"f": 3}}
    assert changed(given, {"a": {"c": {"d": 5}}, "e": None}) == {"a": {"b": 1, "c": {"d": 5}}}
    assert given == {"a": {"b": 1, "c": {"d": 2}}, "e": {"f": 3}}


def test_the_help_names_every_variation():
    text = " ".join(run("--help").split()).replace("- ", "-")  # click breaks lines at hyphens
    assert [name for name in VARIATIONS if name not in text] == []


def test_every_column_is_a_measure():
    from holdfast.cli.ablate import KEYS

    assert set(KEYS) <= {measure.key for measure in MEASURES}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere", "-o", "x"], "nowhere: no such scenario (allowed: arm-and-traffic, boastful-fixes"),
        (["quick", "-o", "x", "--only", "no-imu"], "--only no-imu: no such variation (allowed: default, paper"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], words: str):
    with pytest.raises(ConfigError) as caught:
        run(*arguments)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path, scenario: Path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"file/out: cannot be written \(Not a directory\)"):
        run(str(scenario), "-o", str(tmp_path / "file" / "out"), "--only", "default")


def test_a_variation_that_never_starts_is_named_beside_the_others(tmp_path: Path):
    file = tmp_path / "blind.yaml"
    silence = "{kind: silence, sensors: [imu], start_s: 0.3, end_s: 2.0}"
    file.write_text(f"{SHORT.replace('duration_s: 9', 'duration_s: 2')}  - {silence}\n", encoding="utf-8")
    output = run(str(file), "-o", str(tmp_path / "out"), "--only", "default")
    assert "default, seed 0: never started: " in output
    (entry,) = json.loads((tmp_path / "out" / "table.json").read_text(encoding="utf-8"))
    assert entry["scores"] == {}
