"""`holdfast config`: what it prints, where to and with which exit code; what a configuration asks of a recording."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "recording"))
from bags import HUMBLE, START_NS, drive, write_bag
from test_recorded_frames import told, transform

from holdfast.api.run import resolved
from holdfast.cli import main
from holdfast.config.load import load_config, parse_config
from holdfast.errors import ConfigError
from holdfast.recording.source import Subscription
from holdfast.recording.subscriptions import subscriptions

MACHINE = """\
sensors:
  imu: {kind: imu, topic: /imu}
  gnss: {kind: gnss, topic: /gnss}
  heading: {kind: heading, topic: /heading}
  joint: {kind: joint, topic: /joints, joint_name: swing}
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


Record = Callable[..., Path]


@pytest.fixture
def record(tmp_path: Path) -> Record:
    def record(*topics: str) -> Path:
        rows = [row for row in drive(HUMBLE) if row[0] in topics]
        return write_bag(tmp_path / "drive", "mcap", rows)

    return record


TWO_ANTENNAS = """\
sensors:
  imu: {kind: imu, topic: /imu}
  left: {kind: gnss, topic: /left}
  right: {kind: gnss, topic: /right}
extrinsics:
  - {parent: imu, child: left, translation_m: [0, 0.01, 1]}
  - {parent: imu, child: right, translation_m: [0, 0, 1]}
"""


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


def test_check_refuses_two_antennas_at_one_place(run: Run, tmp_path: Path) -> None:
    """`config init` cannot know where they are; a heading between them divided by zero."""
    file = tmp_path / "machine.yaml"
    file.write_text(TWO_ANTENNAS)
    code, out, err = run("check", file)
    assert (code, out) == (2, "")
    assert err == (
        f"error: {file}: extrinsics: the antennas of left and right are 0.010 m apart, must be >= 0.05 m: "
        "measure the translation_m of left and right\n"
    )
    file.write_text(TWO_ANTENNAS.replace("0.01", "1.8"))
    assert run("check", file)[0] == 0


@pytest.mark.parametrize("more", ["", ", encoder: {kind: joint, topic: /joint}", ", slip: {kind: nonholonomic}"])
def test_check_refuses_an_imu_beside_which_nothing_can_start_the_estimate(run: Run, tmp_path: Path, more: str) -> None:
    file = tmp_path / "machine.yaml"
    file.write_text(f"sensors: {{imu: {{kind: imu, topic: /imu}}{more}}}\nextrinsics: [{{parent: imu, child: slip}}]\n")
    code, out, err = run("check", file)
    assert (code, out) == (2, "")
    assert err == (
        f"error: {file}: sensors: nothing beside the IMU can start the estimate: add a sensor of positions or poses, "
        "such as `kind: gnss`, `kind: pose` or `kind: odometry`\n"
    )


def test_check_accepts_an_imu_with_an_odometry_alone(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "machine.yaml"
    file.write_text(
        "sensors: {imu: {kind: imu, topic: /imu}, lidar: {kind: odometry, topic: /odometry}}\n"
        "extrinsics: [{parent: imu, child: lidar, translation_m: [1, 0, 0]}]\n"
    )
    assert run("check", file)[0] == 0


@pytest.mark.parametrize("command", ["replay", "smooth", "live"])
def test_what_check_calls_impossible_is_refused_by_whatever_estimates(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Antennas 0.1 um apart were estimated with, without a word."""
    file = tmp_path / "machine.yaml"
    file.write_text(TWO_ANTENNAS.replace("0.01", "0.0000001"))
    where = [] if command == "live" else [str(tmp_path / "recording.mcap"), "-o", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["holdfast", command, *where, "-c", str(file)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {file}: extrinsics: the antennas of left and right are 0.000 m apart, must be")
    with pytest.raises(ConfigError, match=r"the antennas of left and right are 0\.000 m apart"):
        resolved(load_config(file))


def test_schema_is_json_with_units(run: Run) -> None:
    code, out, _ = run("schema")
    assert code == 0
    schema = json.loads(out)
    assert "[rad/s/sqrt(Hz)]" in schema["$defs"]["ImuConfig"]["properties"]["gyroscope_noise_density"]["description"]


def test_init_writes_a_file_that_check_accepts(run: Run, record: Record, tmp_path: Path) -> None:
    bag, file = record("/imu", "/gnss/fix"), tmp_path / "machine.yaml"
    code, out, err = run("init", bag, "-o", file)
    assert (code, err) == (0, "")
    assert str(file) in out
    config = load_config(file)
    assert subscriptions(config) == [
        Subscription(topic="/imu", sensor="imu", kind="imu"),
        Subscription(topic="/gnss/fix", sensor="gnss", kind="gnss"),
    ]
    assert run("check", file)[0] == 0


def test_init_without_a_file_prints_the_configuration_and_nothing_else(run: Run, record: Record) -> None:
    code, out, _ = run("init", record("/imu", "/gnss/fix"))
    assert code == 0
    assert parse_config(out).imu.topic == "/imu"


def test_a_minimal_file_has_ten_lines_and_says_the_same(run: Run, record: Record, tmp_path: Path) -> None:
    bag, long, short = record("/imu", "/gnss/fix", "/lidar/odometry"), tmp_path / "long.yaml", tmp_path / "short.yaml"
    assert run("init", bag, "-o", long)[0] == 0
    assert run("init", bag, "--minimal", "-o", short)[0] == 0
    assert load_config(short) == load_config(long)
    assert len(short.read_text().splitlines()) <= 10
    assert len(long.read_text().splitlines()) > 100
    assert short.read_text().count("TODO measure") == 2


def test_init_tells_what_contradicts_itself_in_the_bag(run: Run, tmp_path: Path) -> None:
    places = [transform(HUMBLE, START_NS, "cab", "f", (x, 0, 0)) for x in (0.0, 1.0)]
    rows = [told(HUMBLE, "/tf_static", START_NS, *places), *drive(HUMBLE)]
    code, out, err = run("init", write_bag(tmp_path / "bag", "mcap", rows))
    assert (code, err) == (
        0,
        "warning: /tf_static: 'f' in 'cab' is given twice, 1.000 m and 0.0 deg apart: it is not used\n",
    )
    assert parse_config(out).sensors


def test_init_overwrites_only_by_force(run: Run, record: Record, tmp_path: Path) -> None:
    bag = record("/imu")
    file = tmp_path / "machine.yaml"
    file.write_text("precious")
    code, _, err = run("init", bag, "-o", file)
    assert (code, file.read_text()) == (2, "precious")
    assert err == f"error: {file}: exists already: give another name, or --force to overwrite it\n"
    assert run("init", bag, "-o", file, "--force")[0] == 0
    assert load_config(file).imu.topic == "/imu"


def test_init_where_nothing_can_be_written_is_a_usage_mistake(run: Run, record: Record, tmp_path: Path) -> None:
    code, _, err = run("init", record("/imu"), "-o", tmp_path / "absent" / "machine.yaml")
    assert code == 2
    assert "cannot be written (its folder does not exist)" in err


def test_init_of_a_recording_without_an_imu_exits_with_3_and_writes_nothing(
    run: Run, record: Record, tmp_path: Path
) -> None:
    bag = record("/gnss/fix")
    file = tmp_path / "machine.yaml"
    code, out, err = run("init", bag, "-o", file)
    assert (code, out) == (3, "")
    assert err.startswith(f"error: {bag}: no IMU in it") and err.count("\n") == 1
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


def test_sensors_of_one_kind_are_subscribed_each_under_its_name_and_a_constraint_is_not() -> None:
    more = "  mast: {kind: gnss, topic: /right, frame: right}\n  slip: {kind: nonholonomic, frame: imu}\n  heading:"
    text = MACHINE.replace("  heading:", more).replace("extrinsics: [", "extrinsics: [{parent: imu, child: right}, ")
    found = {one.sensor: one for one in subscriptions(parse_config(text))}
    assert found.keys() == {"imu", "gnss", "mast", "heading", "joint"}
    assert found["mast"] == Subscription(topic="/right", sensor="mast", kind="gnss")


OLD = """\
# my machine
sensors:
  imu: {topic: /imu}   # the good one
  lidar:
    # below the roof
    topic: /icp
  gnss:
extrinsics: [{parent: imu, child: lidar}]
graph: {main_lidar: relative}
gate:
  witness: false
"""
NEW = """\
# my machine
sensors:
  imu: {kind: imu, topic: /imu}   # the good one
  lidar:
    # below the roof
    kind: odometry
    topic: /icp
extrinsics: [{parent: imu, child: lidar}]
graph: {main_odometry: relative}
gate:
  drift_monitor: false
"""


@pytest.fixture
def old(tmp_path: Path) -> Path:
    file = tmp_path / "old.yaml"
    file.write_text(OLD)
    return file


def test_upgrade_prints_the_file_in_the_form_of_now_and_reports_every_change(run: Run, old: Path) -> None:
    code, out, err = run("upgrade", old)
    assert (code, out, old.read_text()) == (0, NEW, OLD)
    assert err.splitlines() == [
        f"{old}: sensors.imu: now `kind: imu`",
        f"{old}: sensors.lidar: now `kind: odometry`",
        f"{old}: sensors.gnss: now `left out`",
        f"{old}: graph.main_lidar: now `main_odometry`",
        f"{old}: gate.witness: now `drift_monitor`",
    ]


def test_upgrade_writes_where_it_is_told_and_overwrites_only_by_force(run: Run, old: Path, tmp_path: Path) -> None:
    new = tmp_path / "new.yaml"
    assert run("upgrade", old, "-o", new)[:2] == (0, "")
    assert new.read_text() == NEW
    assert run("upgrade", old, "-o", new)[0] == 2
    assert run("upgrade", old, "-o", new, "--force")[0] == 0
    assert run("upgrade", old, "-o", new, "--in-place")[0] == 2
    assert old.read_text() == OLD
    assert run("upgrade", old, "--in-place")[0] == 0
    assert old.read_text() == NEW


def test_upgrade_leaves_a_file_of_the_form_of_now_as_it_is(run: Run, old: Path) -> None:
    old.write_text(NEW)
    code, out, err = run("upgrade", old)
    assert (code, out) == (0, NEW)
    assert err == f"{old}: is of the form of now, nothing to change\n"


def test_upgrade_of_a_file_with_mistakes_lists_them(run: Run, old: Path) -> None:
    old.write_text(OLD.replace("topic: /icp", "topik: /icp"))
    code, out, err = run("upgrade", old)
    assert (code, out) == (2, "")
    assert f"error: {old}:6 sensors.lidar.topik: unknown key, did you mean topic?" in err


def test_an_old_file_is_one_clean_line_of_warning_in_every_command(old: Path) -> None:
    command = [sys.executable, "-c", "from holdfast.cli import main; main()", "config", "check", str(old)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == (
        f"warning: {old}: is of the old form (sensors.imu: now `kind: imu`); "
        f"`holdfast config upgrade {old}` rewrites it\n"
    )
