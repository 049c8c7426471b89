"""A preset changes defaults and nothing else: what the file says wins, and its mistakes keep their lines."""

from typing import Any

import pytest

from holdfast.config.document import yaml_text
from holdfast.config.load import parse_config, resolved_yaml
from holdfast.config.presets import PRESETS
from holdfast.config.sensors import GnssConfig
from holdfast.errors import ConfigError

SENSORS = """\
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /left, frame: left}
  gnss_right: {kind: gnss, topic: /right, frame: right}
extrinsics:
  - {parent: imu, child: left, translation_m: [0, 1, 0]}
  - {parent: imu, child: right, translation_m: [0, -1, 0]}
"""


def faults(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "f.yaml")
    return str(caught.value).splitlines()


def test_the_default_preset_is_ours_and_says_nothing_that_the_model_does_not() -> None:
    assert parse_config(SENSORS).preset == "holdfast"
    assert parse_config("preset: holdfast\n" + SENSORS) == parse_config(SENSORS)


def test_the_paper_preset_has_the_rules_of_the_paper() -> None:
    config = parse_config("preset: paper\n" + SENSORS)
    assert (config.graph.nodes, config.graph.main_odometry, config.graph.fallback_odometry) == (
        "imu",
        "relative",
        "frozen",
    )
    assert config.graph.dual
    assert config.graph.lag_s == 6.0
    assert config.frames.odometry_policy == "at_recovery"
    assert not (config.gate.innovation or config.gate.baseline or config.gate.drift_monitor)
    assert (config.gate.lose_after, config.gate.regain_after) == (20, 20)
    assert config.gate.max_speed_m_s * 0.05 == pytest.approx(0.3)  # metres from fix to fix at 20 Hz
    for antenna in config.sensors_of(GnssConfig).values():
        assert antenna.max_sigma_m**2 == pytest.approx(0.1, rel=2e-3)


def test_the_paper_preset_keeps_our_weights() -> None:
    ours, paper = parse_config(SENSORS), parse_config("preset: paper\n" + SENSORS)
    assert paper.graph.position_integration_sigma == ours.graph.position_integration_sigma
    assert paper.imu == ours.imu
    assert paper.sensors_of(GnssConfig)["gnss"].min_sigma_m == ours.sensors_of(GnssConfig)["gnss"].min_sigma_m


def leaves(data: dict[str, Any], path: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    found = {}
    for key, value in data.items():
        found |= leaves(value, (*path, key)) if isinstance(value, dict) else {(*path, key): value}
    return found


@pytest.mark.parametrize("name", PRESETS)
def test_every_value_of_a_preset_is_allowed_and_differs_from_the_default(name: str) -> None:
    sections, of_kinds = PRESETS[name]
    default, config = parse_config(SENSORS), parse_config(f"preset: {name}\n{SENSORS}")
    values = leaves(sections) | {("sensors", "gnss", key): value for key, value in of_kinds.get("gnss", {}).items()}
    for path, value in values.items():
        ours, theirs = default, config
        for key in path:
            ours, theirs = (one[key] if isinstance(one, dict) else getattr(one, key) for one in (ours, theirs))
        assert theirs == value, path
        assert ours != value, f"{path} says what the model says already"


OPPOSITES = {
    ("graph", "nodes"): "measurement",
    ("graph", "lag_s"): 2.5,
    ("gate", "drift_monitor"): True,
    ("gate", "lose_after"): 7,
    ("frames", "odometry_policy"): "always",
}


@pytest.mark.parametrize("path", OPPOSITES, ids=".".join)
def test_what_the_file_says_wins_and_the_rest_of_the_preset_stays(path: tuple[str, str]) -> None:
    section, key = path
    paper = parse_config("preset: paper\n" + SENSORS)
    config = parse_config(f"preset: paper\n{SENSORS}{section}:\n  {key}: {yaml_text(OPPOSITES[path])}\n")
    changed = getattr(paper, section).model_copy(update={key: OPPOSITES[path]})
    assert config == paper.model_copy(update={section: changed})


def test_an_antenna_may_have_its_own_bound() -> None:
    config = parse_config("preset: paper\n" + SENSORS.replace("frame: left", "frame: left, max_sigma_m: 2"))
    assert {name: gnss.max_sigma_m for name, gnss in config.sensors_of(GnssConfig).items()} == {
        "gnss": 2.0,
        "gnss_right": 0.316,
    }


@pytest.mark.parametrize("bare", ["graph:\n", "gate:\n", "frames:\n", "standstill:\n"])
def test_a_bare_heading_keeps_the_preset(bare: str) -> None:
    assert parse_config("preset: paper\n" + SENSORS + bare) == parse_config("preset: paper\n" + SENSORS)


def test_a_preset_adds_no_sensor() -> None:
    assert parse_config("preset: paper\nsensors:\n  imu: {kind: imu, topic: /imu}\n").sensors.keys() == {"imu"}


def test_faults_point_at_the_lines_of_the_file() -> None:
    text = "preset: paper\n" + SENSORS + "gate:\n  lose_after: 0\ngraph:\n  lagg_s: 3\n  nodes: often\n"
    assert faults(text) == [
        "f.yaml:10 gate.lose_after = 0: must be >= 1",
        "f.yaml:12 graph.lagg_s: unknown key, did you mean lag_s?",
        'f.yaml:13 graph.nodes = "often": must be one of measurement, imu',
    ]


@pytest.mark.parametrize("text", [SENSORS + "graph: 5\n", SENSORS + "gate: [1]\n", "sensors: 5\n"])
def test_a_section_that_is_none_is_refused_as_without_a_preset(text: str) -> None:
    assert faults("preset: paper\n" + text) == faults("preset: holdfast\n" + text)


@pytest.mark.parametrize("name", ["papr", "[1, 2]", "{a: 1}", "7"])
def test_an_unknown_preset_is_refused_with_the_known_ones(name: str) -> None:
    (fault,) = faults(f"preset: {name}\n{SENSORS}")
    assert fault.startswith("f.yaml:1 preset = ")
    assert fault.endswith("must be one of holdfast, paper")


@pytest.mark.parametrize("given_only", [True, False])
def test_the_resolved_file_of_a_preset_reads_back_as_the_same_configuration(given_only: bool) -> None:
    for extra in ("", "graph: {nodes: measurement}\n", "gate:\n"):
        config = parse_config("preset: paper\n" + SENSORS + extra)
        assert parse_config(resolved_yaml(config, given_only=given_only)) == config
