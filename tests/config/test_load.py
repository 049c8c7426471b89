"""Every mistake is named with line, place and remedy, all at once; nothing that a person can type is a traceback."""

import math
import re
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from holdfast.config.kinds import AnySensor
from holdfast.config.load import load_config, parse_config, resolved_yaml
from holdfast.config.model import Config
from holdfast.config.schema import ROOT, Place, type_text
from holdfast.config.sensors import GnssConfig, OdometryConfig
from holdfast.errors import ConfigError

MINIMAL = "sensors:\n  imu:\n    kind: imu\n    topic: /imu\n"
FULL = """\
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /gnss}
  gnss_right: {kind: gnss, topic: /gnss2, frame: right}
  lidar: {kind: odometry, topic: /lidar}
  heading: {kind: heading, topic: /heading}
  joint: {kind: joint, topic: /joint}
extrinsics:
  - {parent: imu, child: gnss, translation_m: [1, 2, 3], rotation_rpy_deg: [0, 0, 90]}
  - {parent: gnss, child: lidar}
  - {parent: imu, child: right, translation_m: [1, -2, 3]}
frames: {datum: {latitude_deg: 1, longitude_deg: 2, altitude_m: 3}}
"""


def faults(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "f.yaml")
    return str(caught.value).splitlines()


def imu(*lines: str) -> str:
    return MINIMAL + "".join(f"    {line}\n" for line in lines)


def test_two_lines_are_a_configuration_and_everything_else_has_a_default() -> None:
    config = parse_config(MINIMAL)
    assert config == Config.model_validate({"sensors": {"imu": {"kind": "imu", "topic": "/imu"}}})


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("gyroscope_noise_density: -0.1", "gyroscope_noise_density = -0.1: must be > 0 [rad/s/sqrt(Hz)]"),
        ("gyroscope_noise_density: 2", "gyroscope_noise_density = 2: must be <= 1 [rad/s/sqrt(Hz)]"),
        ("gyroscope_noise_densty: 1", "gyroscope_noise_densty: unknown key, did you mean gyroscope_noise_density?"),
        ("max_gap_s: '0.1'", 'max_gap_s = "0.1": must be a number [s]: write it without quotes'),
        ("max_gap_s: soon", 'max_gap_s = "soon": must be a number [s]'),
        ("max_gap_s: true", "max_gap_s = true: must be a number [s]"),
        ("max_gap_s:", "max_gap_s = null: must be a number [s]"),
        ("max_gap_s: [1]", "max_gap_s = [1]: must be a number [s]"),
        ("max_gap_s: .nan", "max_gap_s = .nan: must be finite [s]"),
        ("max_gap_s: -.inf", "max_gap_s = -.inf: must be finite [s]"),
        (f"max_gap_s: {'9' * 400}", "max_gap_s = .inf: must be finite [s]"),
        ("frame: 7", "frame = 7: must be text: put it in quotes"),
        ("max_gap_s: !seconds 1", "max_gap_s: tag !seconds is not supported"),
        ("max_gap_s: 1\n    max_gap_s: 0.5", "max_gap_s: is given twice (first in line 5)"),
    ],
)
def test_a_wrong_line_is_named_with_its_place_and_what_is_allowed(line: str, fault: str) -> None:
    number = 5 + line.count("\n")
    assert faults(imu(line)) == [f"f.yaml:{number} sensors.imu.{fault}"]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (
            "sensors:\n  imu: {kind: imu}\n",
            "2 sensors.imu.topic: missing, must be text: topic in the rec",
        ),
        ("sensors:\n  imu:\n", "2 sensors.imu.topic: missing"),
        ("sensors:\n  front:\n", "2 sensors.front: must be a section with `kind:` and more"),
        ("sensors:\n  imu: {kind: imuu}\n", '2 sensors.imu: kind = "imuu": did you mean imu? must be one of imu, gnss'),
        ("sensors:\n", "1 sensors = null: must be names, each with a section"),
        ("graph: {lag_s: 3}\n", "1 sensors: missing, must be names, each with a section"),
        (
            MINIMAL + "  gnss: {kind: gnss, topic: /g, min_status: rtk}\n",
            '5 sensors.gnss.min_status = "rtk": must be one of fix, s',
        ),
        (MINIMAL + "  gnss: {kind: gnss, topic: ''}\n", '5 sensors.gnss.topic = "": must not be empty'),
        (MINIMAL + "  gnss: /fix\n", "5 sensors.gnss: must be a section with `kind:` and more (allowed: imu, gnss"),
        (
            MINIMAL + "  sonar: {}\n",
            "5 sensors.sonar: kind: missing, must be one of imu, gnss, heading",
        ),
        (MINIMAL + "graph: fast\n", '5 graph = "fast": must be a section'),
        (MINIMAL + "standstill: {enabled: off}\n", '5 standstill.enabled = "off": must be true or false: YAML 1.2'),
        (MINIMAL + "extrinsics: {a: b}\n", '5 extrinsics = {"a": "b"}: must be a list of sections'),
        (
            MINIMAL + "extrinsics:\n- parent: a\n  child: b\n  translation_m: [1, 2]\n",
            "8 extrinsics[0].translation_m = [1, 2]: must have 3 entries",
        ),
        (
            MINIMAL + "extrinsics:\n- parent: a\n  child: b\n  translation_m: [1, 2, 3, 4]\n",
            "8 extrinsics[0].translation_m = [1, 2, 3, 4]: must have 3 entries",
        ),
        (
            MINIMAL + "extrinsics:\n- parent: a\n  child: b\n  translation_m:\n  - 1\n  - 2\n  - x\n",
            '11 extrinsics[0].translation_m[2] = "x": must be a number',
        ),
        (
            MINIMAL + "extrinsics:\n- parent: a\n  child: b\n  rotation_matrix: [[1,0,0],[0,1,0],[0,0,2]]\n",
            "8 extrinsics[0]: rotation_matrix is not a rotation",
        ),
        (
            MINIMAL + "  lidar: {kind: odometry, topic: /l}\nextrinsics: []\n",
            "no transforms lead from 'imu' to 'lidar'",
        ),
    ],
)
def test_faults_of_sections_lists_and_validators_have_their_line(text: str, fault: str) -> None:
    found = faults(text)
    assert len(found) == 1
    assert fault in found[0]
    assert found[0].startswith("f.yaml:")


def test_all_faults_come_at_once_in_the_order_of_the_file() -> None:
    text = (
        imu("max_gap_s: x", "topick: /x", "gyroscope_range: {value: 1, unit: kg}") + "graph: {lag_s: 0, nodes: all}\n"
    )
    assert [line.split(" ")[0] + " " + line.split(" ")[1].rstrip(":") for line in faults(text)] == [
        "f.yaml:5 sensors.imu.max_gap_s",
        "f.yaml:6 sensors.imu.topick",
        "f.yaml:7 sensors.imu.gyroscope_range.unit",
        "f.yaml:8 graph.lag_s",
        "f.yaml:8 graph.nodes",
    ]


def test_numbers_are_read_as_yaml_1_2_reads_them() -> None:
    config = parse_config(imu("max_gap_s: 1e-2", "time_offset_s: 010", "accelerometer_range: 2.5e+1", "frame: on"))
    assert config.imu.max_gap_s == 0.01
    assert config.imu.time_offset_s == 10.0
    assert config.imu.accelerometer_range == 25.0
    assert config.imu.frame == "on"


@pytest.mark.parametrize(
    ("line", "field", "expected"),
    [
        ("{value: 0.3, unit: deg/sqrt(h)}", "gyroscope_noise_density", math.radians(0.3) / 60),
        ("{value: 0.005, unit: deg/s/sqrt(Hz)}", "gyroscope_noise_density", math.radians(0.005)),
        ("{value: 80, unit: ug/sqrt(Hz)}", "accelerometer_noise_density", 80e-6 * 9.80665),
        ("{value: 0.06, unit: m/s/sqrt(h)}", "accelerometer_noise_density", 0.001),
        ("{value: 20, unit: mg}", "accelerometer_bias_sigma", 0.1961330),
        ("{value: 10, unit: deg/h}", "gyroscope_bias_sigma", math.radians(10) / 3600),
        ("{value: 40, unit: ms}", "max_gap_s", 0.04),
        ("{value: 500, unit: deg/s}", "gyroscope_range", math.radians(500)),
    ],
)
def test_a_quantity_is_converted_to_the_unit_of_its_field(line: str, field: str, expected: float) -> None:
    config = parse_config(imu(f"{field}: {line}"))
    assert getattr(config.imu, field) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("{value: 3, unit: parsec}", ".unit: unknown unit 'parsec', allowed are rad/s/sqrt(Hz), deg/s/sqrt(Hz), "),
        ("{value: 3, unit: mg}", ".unit: unit of another kind 'mg', allowed are rad/s/sqrt(Hz), "),
        ("{value: '3', unit: deg/sqrt(h)}", '.value: must be a number [deg/sqrt(h)], not "3"'),
        ("{value: true, unit: deg/sqrt(h)}", ".value: must be a number [deg/sqrt(h)], not true"),
        ("{value: 3}", ": must be a number [rad/s/sqrt(Hz)] or {value: number, unit: rad/s/sqrt(Hz)}"),
        ("{value: 3, unit: rad, u: 1}", ": must be a number [rad/s/sqrt(Hz)] or {value: number"),
        ("{value: -3, unit: deg/sqrt(h)}", " = -3 deg/sqrt(h): must be > 0 [rad/s/sqrt(Hz)]"),
    ],
)
def test_a_quantity_that_cannot_be_is_refused_once_with_the_units_that_can(line: str, fault: str) -> None:
    found = faults(imu(f"gyroscope_noise_density: {line}"))
    assert len(found) == 1
    assert found[0].startswith(f"f.yaml:5 sensors.imu.gyroscope_noise_density{fault}")


def test_anchors_serve_repeated_values_and_may_be_used_again() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        config = parse_config(imu("max_gap_s: &a 0.1", "time_offset_s: &a 0.2", "accelerometer_bias_sigma: *a"))
    assert config.imu.accelerometer_bias_sigma == 0.2


def test_a_section_in_part_keeps_the_defaults_of_its_place_and_a_bare_heading_keeps_them_all() -> None:
    text = (
        MINIMAL
        + "  lidar:\n    kind: odometry\n    topic: /l\n    robust_loss: {threshold: 4}\n"
        + "extrinsics: [{parent: imu, child: lidar}]\n"
    )
    loss = parse_config(text + "graph:\n").sensors_of(OdometryConfig)["lidar"].robust_loss
    assert (loss.kind, loss.threshold) == ("huber", 4.0)
    assert parse_config(text + "graph:\n") == parse_config(text)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "f.yaml:1 is empty"),
        ("# only a comment\n", "f.yaml:1 is empty"),
        ("- a\n", "f.yaml:1 has a list at the top"),
        ("\njust text\n", "f.yaml:2 has a single value at the top"),
        ("sensors:\n  imu: a: b\n", "f.yaml:2:9 is not YAML: mapping values are not allowed here"),
        ("sensors:\n\timu: 1\n", "f.yaml:2:1 is not YAML: found character '\\t'"),
        ("a: [1\n", "f.yaml:2:1 is not YAML"),
        ("--- 1\n--- 2\n", "f.yaml:2:1 is not YAML: but found another document"),
        ("a: 1\nb: \x01\n", "f.yaml:2 is not YAML: control character"),
        ('a: "\\U00110000"\n', "f.yaml:1 is not YAML"),
        ('a: "\\ud800"\n', "f.yaml:1 a: has a broken character"),
        ("a: &x [*x]\n", "f.yaml:1 is nested too deeply, or an alias contains itself"),
        ("[" * 1500, "f.yaml:1 is nested too deeply"),
        ("? [a]\n: 1\n", "f.yaml:1 has a key that is not a word"),
        (
            "".join(
                f"{c}: &{c} [{(f'*{p},' if p else '1,') * 9}]\n"
                for p, c in zip(["", *"abcdef"], "abcdefg", strict=True)
            ),
            "f.yaml:1 has more than 20000 values",
        ),
    ],
)
def test_what_is_no_configuration_at_all_is_refused_in_one_line(text: str, fault: str) -> None:
    assert faults(text)[0].startswith(fault)


@pytest.mark.parametrize("text", [
    "a: [" + "1, " * 1_000_000 + "]",
    "".join(f"k{k}: 1\n" for k in range(300_000)),
])  # fmt: skip
def test_three_megabytes_of_yaml_are_refused_at_once(tmp_path: Path, text: str) -> None:
    (tmp_path / "f.yaml").write_text(text)
    began = time.perf_counter()
    with pytest.raises(ConfigError, match=r"f\.yaml: is too large to be a configuration"):
        load_config(tmp_path / "f.yaml")
    assert time.perf_counter() - began < 1.0  # it took 100 s


def test_deep_nesting_is_refused_at_its_line() -> None:
    text = "\n".join(" " * k + "a:" for k in range(60))
    assert faults(text) == ["f.yaml:52 is nested too deeply, or an alias contains itself"]


@pytest.mark.parametrize("text", [
    "k" * 100_000 + ": 1",
    "a: !" + "x" * 100_000,
    "sensors: {imu: {kind: " + "x" * 100_000 + "}}",
    "sensors: {imu: {kind: imu, topic: a, gyroscope_noise_density: {value: 1, unit: " + "x" * 100_000 + "}}}",
    "".join(f"k{k}: 1\n" for k in range(10_000)),
])  # fmt: skip
def test_a_fault_quotes_at_most_a_line_of_the_file(text: str) -> None:
    found = faults(text)
    assert len(found) <= 51 and all(len(line) < 700 for line in found)


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "no such file"), (b"\xff\xfe\x00", "is not UTF-8 text (byte 0)"), ("folder", "is a folder")],
)
def test_what_cannot_be_read_is_a_config_error(tmp_path: Path, content: bytes | str | None, reason: str) -> None:
    file = tmp_path / "machine.yaml"
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif content == "folder":
        file.mkdir()
    with pytest.raises(ConfigError, match=re.escape(f"{file}: {reason}")):
        load_config(file)


def test_a_file_with_a_byte_order_mark_and_windows_lines_is_read(tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + MINIMAL.replace("\n", "\r\n").encode())
    assert load_config(file) == parse_config(MINIMAL)


def numeric_fields(at: Place, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for kind, section in at.kinds.items():
        yield from numeric_fields(Place(section, None), (*path, kind))
    for name, child in () if at.kinds else at.children():
        if name == "sensors":
            yield from numeric_fields(Place(AnySensor, None), (*path, name))
        elif child.section is not None:
            yield from numeric_fields(child, (*path, name))
        elif type_text(child.annotation) == "number":
            yield (*path, name)


FIELDS = list(numeric_fields(ROOT))
SCALARS = st.one_of(
    st.floats().map(lambda x: repr(x).replace("inf", ".inf").replace("nan", ".nan")),
    st.integers().map(str),
    st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"], exclude_characters="#'\""), max_size=8),
    st.sampled_from(
        ["", "~", "true", "on", "0x1F", "1_000", "1:30", "2020-01-01", "'1'", "[1, 2]", "{value: 1, unit: m}"]
    ),
    st.builds("{{value: {}, unit: {}}}".format, st.floats(-1e3, 1e3), st.sampled_from(["deg", "s", "g", "x", "rad/s"])),
)


def machine_with(kind: str) -> str:
    """What a sensor of a kind, and of its name, needs beside its own keys."""
    imu = "" if kind == "imu" else "  main: {kind: imu, topic: /i}\n"
    parent = "base_link" if kind == "base_imu" else "main"
    return f"    kind: {kind}\n{imu}extrinsics: [{{parent: {parent}, child: {kind}}}]\n"


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(FIELDS), SCALARS)
def test_any_scalar_at_any_number_loads_or_is_named_with_place_and_line(path: tuple[str, ...], scalar: str) -> None:
    parents = "".join(f"{'  ' * depth}{name}:\n" for depth, name in enumerate(path[:-1]))
    indent = "  " * (len(path) - 1)
    text = f"{parents}{indent}{path[-1]}: {scalar}\n"
    line = len(path)
    rest = indent + "topic: /t\n" + (machine_with(path[1]) if path[0] == "sensors" else "")
    try:
        parse_config(text + rest, "f.yaml")
    except ConfigError as error:
        lines = str(error).splitlines()
        syntax = re.match(rf"f.yaml:({line}|{line + 1}):\d+ is not YAML", lines[0]) or f"from line {line})" in lines[0]
        missing = [fault for fault in lines if ": missing" in fault or "topic" in fault]
        own = [fault for fault in lines if fault.startswith(f"f.yaml:{line} {'.'.join(path)}")]
        assert syntax or own or len(missing) == len(lines), str(error)
    else:
        assert path[0] == "sensors"


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=40))
def test_no_text_is_a_traceback(text: str) -> None:
    assert all(re.match(r"f\.yaml:\d+(:\d+)? .", line) for line in faults(text))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=12, max_size=12))
def test_a_matrix_of_any_numbers_is_refused_without_a_traceback(numbers: list[float]) -> None:
    rotation = [[2.0, *numbers[1:3]], numbers[3:6], numbers[6:9]]
    text = (
        f"extrinsics: [{{parent: a, child: b, translation_m: {numbers[9:]}, rotation_matrix: {rotation}}}]\n{MINIMAL}"
    )
    assert faults(text) == [
        "f.yaml:1 extrinsics[0]: rotation_matrix is not a rotation: rows must be orthonormal, determinant +1"
    ]


def test_the_resolved_file_reads_back_as_the_same_configuration() -> None:
    for text in (MINIMAL, FULL, imu("frame: 'on: #1'", 'topic2: "a"').replace("topic2", "#topic2")):
        config = parse_config(text)
        assert parse_config(resolved_yaml(config)) == config
    assert "    gyroscope_noise_density: 0.0002\n" in resolved_yaml(parse_config(MINIMAL))


@given(st.text(max_size=20).filter(lambda text: text.strip() != ""))
@settings(max_examples=100, deadline=None)
def test_any_name_survives_the_resolved_file(name: str) -> None:
    config = Config.model_validate({"sensors": {"imu": {"kind": "imu", "topic": name}}})
    assert parse_config(resolved_yaml(config)) == config


def test_a_validator_may_name_several_places_one_per_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from holdfast.config import faults as module
    from holdfast.config.document import read_document
    from holdfast.config.schema import ROOT

    document = read_document(MINIMAL + "graph:\n  lag_s: 2\n", "f.yaml")
    module._note_validator(document, ROOT, (), "graph.lag_s: too short\nsensors.imu: too few\nwhat the sensors say")
    assert [(fault.line, fault.where, fault.what) for fault in document.faults] == [
        (6, "graph.lag_s", "too short"),
        (2, "sensors.imu", "too few"),
        (1, "", "what the sensors say"),
    ]


def test_every_section_of_the_model_is_reached_by_the_walk() -> None:
    def models(at: Place) -> Iterator[str]:
        for section in at.kinds.values() or filter(None, [at.section]):
            yield section.__name__
            for _, child in Place(section, None).children():
                yield from models(child)
        if (entry := at.child(0)) is not None:
            yield from models(entry)

    assert set(models(ROOT)) == set(Config.model_json_schema()["$defs"]) | {"Config"}


def test_a_list_of_three_sigmas_is_three_numbers() -> None:
    """Once refused: a validator that rebuilt the section took the lists of the file for no tuples."""
    text = MINIMAL + "  gnss: {kind: gnss, topic: /g, frame: imu, default_sigma_m: [1, 1, 2]}\n"
    gnss = parse_config(text).sensors_of(GnssConfig)["gnss"]
    assert gnss.default_sigma_m == (1, 1, 2)
