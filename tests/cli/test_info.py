"""`holdfast info` on the command line."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from holdfast.recording.mcap_writer import McapWriter

DATA = Path(__file__).parents[3] / "shared" / "data"
HEADER = "stamp_ns,arrival_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"


def info(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from holdfast.cli import main; main()", "info", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rows = [
        f"{k * 10_000_000},{k * 10_000_000 + 2_000_000},{k * 7 % 5},0,0,{k * k % 11},0,9.8\n"
        for k in range(200)
        if not 100 <= k < 150
    ]
    (tmp_path / "imu.csv").write_text(HEADER + "".join(rows))
    return tmp_path


def test_a_pipe_gets_plain_text_with_one_sentence_per_problem(folder: Path) -> None:
    done = info(folder)
    assert done.returncode == 0
    assert done.stderr == ""
    assert "\x1b" not in done.stdout
    assert done.stdout.isascii()
    lines = done.stdout.splitlines()
    assert "topic  type                 count  rate [Hz]" in lines[1]
    assert lines[2].split()[:4] == ["imu", "sensor_msgs/msg/Imu", "150", "100.00"]
    assert lines[-2] == "1 problem(s):"
    assert lines[-1].startswith("- imu: 1 gap(s) longer than 5 periods, the longest 0.510 s at 1.0 s;")


def test_json_is_for_machines(folder: Path) -> None:
    done = info(folder, "--json", "--start", "0.5", "--duration", "0.2")
    assert done.returncode == 0
    report = json.loads(done.stdout)
    (topic,) = report["topics"]
    assert (topic["topic"], topic["count"], topic["gaps"]) == ("imu", 20, 0)
    assert topic["latency_mean_s"] == pytest.approx(0.002)
    assert report["start_ns"] == 2_000_000
    assert report["problems"] == []
    assert report["damage"] is None


def test_a_recording_that_cannot_be_read_ends_in_one_line_and_code_3(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"rubbish")
    for path in (tmp_path / "a.bag", tmp_path / "nowhere", tmp_path.parent / "nowhere.mcap"):
        done = info(path)
        assert done.returncode == 3
        assert done.stdout == ""
        assert done.stderr.startswith(f"error: {path}: ")
        assert done.stderr.count("\n") == 1


def test_damage_further_in_ends_in_code_3_after_what_could_be_read(folder: Path) -> None:
    with (folder / "imu.csv").open("a") as file:
        file.write("oops,1,2,3,4,5,6,7\n5,1,2,3,4,5,6,7\n")
    done = info(folder)
    assert done.returncode == 3
    assert "imu    sensor_msgs/msg/Imu    150" in done.stdout
    assert "imu.csv:152: column stamp_ns is 'oops'" in done.stderr


@pytest.mark.parametrize(
    ("option", "value", "must_be"),
    [
        ("--duration", "nan", "> 0"),
        ("--duration", "inf", "> 0"),
        ("--duration", "-1", "> 0"),
        ("--duration", "0", "> 0"),
        ("--start", "-1", ">= 0"),
        ("--start", "nan", ">= 0"),
    ],
)
def test_a_window_that_cannot_be_read_is_refused_as_replay_does(folder, option, value, must_be) -> None:
    """An endless duration was a traceback, a negative one a fault of the recording."""
    done = info(folder, option, value, "--json")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == f"error: {option} {value}: must be {must_be} and <= 1e+09\n"


def test_a_mistyped_option_ends_in_code_2(folder: Path) -> None:
    assert info(folder, "--durration", "3").returncode == 2


def test_an_unclosed_mcap_says_how_far_it_reads(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "o.mcap")
    writer.write("/text", writer.types["std_msgs/msg/String"](data="hello"), "std_msgs/msg/String", 10**9)
    writer.flush()
    done = info(tmp_path / "o.mcap")
    writer.close()
    assert done.returncode == 0
    assert "is cut off or was never closed; read up to the cut: 1 message(s)" in done.stdout
    assert "no topic has readable sensor_msgs/msg/Imu messages" in done.stdout


def test_the_drive_in_the_gtsam_wheel_shows_its_eight_hidden_drop_outs() -> None:
    report = json.loads(info("kitti", "--json").stdout)
    imu = next(topic["imu"] for topic in report["topics"] if topic["topic"] == "/imu")
    assert imu["lines"] == 8
    assert imu["longest_line_s"] == pytest.approx(1.65, abs=0.02)


@pytest.mark.slow
@pytest.mark.skipif(not DATA.exists(), reason="the recordings are not beside this checkout")
def test_the_traps_of_the_real_recordings_are_found() -> None:
    kitti = json.loads(info(DATA / "kitti_00" / "bag", "--json").stdout)
    topics = {topic["topic"]: topic for topic in kitti["topics"]}
    assert topics["/imu"]["gaps"] == 8
    assert topics["/lidar/odometry"]["count"] == 4541
    walk = json.loads(info(DATA / "rtk_walk" / "bag", "--json").stdout)
    topics = {topic["topic"]: topic for topic in walk["topics"]}
    assert topics["/imu"]["imu"]["repeats"] == 6958
    assert topics["/gnss/fix"]["gnss"]["statuses"] == {"fix": 187, "gbas": 349}
    assert [problem for problem in walk["problems"] if "repeat the one before" in problem]
