"""`holdfast config`: what it prints, where to and with which exit code; what a configuration asks of a recording."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from holdfast.cli import main
from holdfast.config.load import load_config, parse_config
from holdfast.config.model import Config
from holdfast.config.schema import place
from holdfast.recording import source
from holdfast.recording.source import Subscription, TopicInfo
from holdfast.recording.subscriptions import KINDS, subscriptions

MACHINE = """\
sensors:
  imu: {topic: /imu}
  gnss: {topic: /gnss}
  heading: {topic: /heading}
  joint: {topic: /joints, joint_name: swing}
extrinsics: [{parent: imu, child: gnss, translation_m: [3, 0, 4]}]
frames: {datum: {latitude_deg: 47.5, longitude_deg: 8.5, altitude_m: 480}}
"""

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["holdfast", "config", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


class FakeRecording:
    """Has topics and nothing else."""

    def __init__(self, *topics: TopicInfo) -> None:
        self.topics = topics
        self.closed = False

    def __enter__(self) -> "FakeRecording":
        return self

    def __exit__(self, *_: object) -> None:
        self.closed = True


@pytest.fixture
def record(monkeypatch: pytest.MonkeyPatch) -> Callable[..., FakeRecording]:
    def record(*topics: TopicInfo) -> FakeRecording:
        recording = FakeRecording(*topics)
        monkeypatch.setattr(source, "open_recording", lambda _path: recording)
        return recording

    return record


IMU = TopicInfo("/imu/data", "sensor_msgs/msg/Imu", 100)
FIX = TopicInfo("/gnss/fix", "sensor_msgs/msg/NavSatFix", 10)


def test_check_shows_what_a_good_file_comes_to(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    file.write_text(MACHINE)
    code, out, err = run("check", file)
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        f"{file}: ok",
        "  sensor   topic     frame  lever arm",
        "  imu      /imu      imu    0.000 m",
        "  gnss     /gnss     gnss   5.000 m",
        "  heading  /heading  -      -",
        "  joint    /joints   -      -",
        "  publishes map -> odom, datum: 47.5, 8.5, 480.0",
        "warning: sensors.joint: is not used, because there is no turn_joint",
    ]


def test_check_warns_and_still_succeeds(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    file.write_text(MACHINE.replace("[3, 0, 4]", "[0, 0, 0]"))
    code, out, _ = run("check", file)
    assert code == 0
    assert "warning: sensors.gnss: the lever arm from 'imu' to 'gnss' is exactly zero" in out


def test_check_lists_every_mistake_on_stderr_and_exits_with_2(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    file.write_text(MACHINE.replace("topic: /gnss", "topik: /gnss").replace("480", "high"))
    code, out, err = run("check", file)
    assert (code, out) == (2, "")
    assert [line.removeprefix("error: ").split(" ")[:2] for line in err.splitlines()] == [
        [f"{file}:3", "sensors.gnss.topic:"],
        [f"{file}:3", "sensors.gnss.topik:"],
        [f"{file}:7", "frames.datum.altitude_m"],
    ]
    assert run("check", tmp_path / "absent.yaml")[0] == 2


def test_schema_is_json_with_units(run: Run) -> None:
    code, out, _ = run("schema")
    assert code == 0
    schema = json.loads(out)
    assert "[rad/s/sqrt(Hz)]" in schema["$defs"]["ImuConfig"]["properties"]["gyroscope_noise_density"]["description"]


def test_init_writes_a_file_that_check_accepts(run: Run, record: Callable[..., FakeRecording], tmp_path: Path) -> None:
    recording, file = record(IMU, FIX), tmp_path / "machine.yaml"
    code, out, err = run("init", "drive.bag", "-o", file)
    assert (code, err) == (0, "")
    assert str(file) in out
    assert recording.closed
    config = load_config(file)
    assert subscriptions(config) == [
        Subscription(topic="/imu/data", sensor="imu", kind="imu"),
        Subscription(topic="/gnss/fix", sensor="gnss", kind="gnss"),
    ]
    assert run("check", file)[0] == 0


def test_init_without_a_file_prints_the_configuration_and_nothing_else(
    run: Run, record: Callable[..., FakeRecording]
) -> None:
    record(IMU, FIX)
    code, out, _ = run("init", "drive.bag")
    assert code == 0
    assert parse_config(out).sensors.imu.topic == "/imu/data"


def test_init_overwrites_only_by_force(run: Run, record: Callable[..., FakeRecording], tmp_path: Path) -> None:
    record(IMU)
    file = tmp_path / "machine.yaml"
    file.write_text("precious")
    code, _, err = run("init", "drive.bag", "-o", file)
    assert (code, file.read_text()) == (2, "precious")
    assert err == f"error: {file}: exists already: give another name, or --force to overwrite it\n"
    assert run("init", "drive.bag", "-o", file, "--force")[0] == 0
    assert load_config(file).sensors.imu.topic == "/imu/data"


def test_init_where_nothing_can_be_written_is_a_usage_mistake(
    run: Run, record: Callable[..., FakeRecording], tmp_path: Path
) -> None:
    record(IMU)
    code, _, err = run("init", "drive.bag", "-o", tmp_path / "absent" / "machine.yaml")
    assert code == 2
    assert "cannot be written (No such file or directory)" in err


def test_init_of_a_recording_without_an_imu_exits_with_3_and_writes_nothing(
    run: Run, record: Callable[..., FakeRecording], tmp_path: Path
) -> None:
    record(FIX)
    file = tmp_path / "machine.yaml"
    code, out, err = run("init", "drive.bag", "-o", file)
    assert (code, out) == (3, "")
    assert err.startswith("error: drive.bag: no IMU in it") and err.count("\n") == 1
    assert not file.exists()


def test_init_of_no_recording_exits_with_3(run: Run, tmp_path: Path) -> None:
    assert run("init", tmp_path / "absent.bag")[0] == 3


def test_every_configured_sensor_is_subscribed_under_its_name() -> None:
    assert subscriptions(parse_config(MACHINE)) == [
        Subscription(topic="/imu", sensor="imu", kind="imu"),
        Subscription(topic="/gnss", sensor="gnss", kind="gnss"),
        Subscription(topic="/heading", sensor="heading", kind="heading"),
        Subscription(topic="/joints", sensor="joint", kind="joint", joint_name="swing"),
    ]


def test_every_sensor_of_the_model_has_a_kind() -> None:
    sensors = place(("sensors",))
    assert sensors is not None
    assert {child.section for _, child in sensors.children()} == set(KINDS)


def test_both_antennas_are_subscribed_as_gnss() -> None:
    text = MACHINE.replace("  heading:", "  gnss_right: {topic: /right, frame: right}\n  heading:")
    text = text.replace("extrinsics: [", "extrinsics: [{parent: imu, child: right}, ")
    config: Config = parse_config(text)
    assert Subscription(topic="/right", sensor="gnss_right", kind="gnss") in subscriptions(config)
