"""`holdfast simulate` writes an ordinary recording, its truth, and everything needed to go on from there."""

import csv
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from holdfast.cli import holdfast
from holdfast.config.load import load_config
from holdfast.errors import ConfigError
from holdfast.recording.tum import read_tum


def run(*arguments: str) -> str:
    result = CliRunner().invoke(holdfast, arguments, catch_exceptions=False, standalone_mode=False)
    assert result.exit_code == 0
    return result.output


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("quick")
    run("simulate", "quick", "-o", str(folder), "--seed", "3", "--scans")
    return folder


def test_the_same_seed_writes_the_same_bytes_and_another_seed_others(tmp_path: Path):
    for name, seed in (("one/out", "3"), ("two/out", "3"), ("other/out", "4")):
        run("simulate", "quick", "-o", str(tmp_path / name), "--seed", seed, "--duration", "4", "--scans")
    one, two, other = (digests(tmp_path / name) for name in ("one", "two", "other"))
    assert one == two
    assert len(one) >= 14
    differing = {name for name in one if one[name] != other[name]}
    assert {"out/recording.mcap", "out/truth/imu_in_world.tum", "out/truth/gnss_fixes.csv"} <= differing
    assert "out/site.ply" not in differing


def test_the_recording_is_an_ordinary_bag_of_standard_messages(quick: Path):
    standard = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([quick / "recording.mcap"]) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        assert types == {
            "/tf": "tf2_msgs/msg/TFMessage",
            "/tf_static": "tf2_msgs/msg/TFMessage",
            "/imu/data": "sensor_msgs/msg/Imu",
            "/base_imu/data": "sensor_msgs/msg/Imu",
            "/gnss/left/fix": "sensor_msgs/msg/NavSatFix",
            "/gnss/right/fix": "sensor_msgs/msg/NavSatFix",
            "/gnss/heading": "sensor_msgs/msg/Imu",
            "/joint_states": "sensor_msgs/msg/JointState",
            "/lidar/odometry": "nav_msgs/msg/Odometry",
            "/lidar/points": "sensor_msgs/msg/PointCloud2",
        }
        for connection in reader.connections:
            definition, _ = standard.generate_msgdef(connection.msgtype, ros_version=2)
            assert connection.msgdef.data == definition, connection.topic
        arrivals = [arrival for _, arrival, _ in reader.messages()]
        assert arrivals == sorted(arrivals)
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts["/imu/data"] == 2000
    assert counts["/lidar/points"] == 100
    assert counts["/gnss/left/fix"] == 320  # 4 of 20 s are an outage


def test_the_truth_stands_at_the_rate_of_the_imu(quick: Path):
    for name in ("imu", "base", "lidar"):
        truth = read_tum(quick / f"truth/{name}_in_world.tum")
        assert len(truth.stamps_ns) == 2000
        assert set(np.diff(truth.stamps_ns)) == {10_000_000}
    with (quick / "truth/velocities.csv").open() as file:
        rows = list(csv.DictReader(file))
    truth = read_tum(quick / "truth/imu_in_world.tum")
    v = np.array([[float(row[f"imu_v_W_{axis}_m_s"]) for axis in "xyz"] for row in rows])
    np.testing.assert_allclose(np.gradient(truth.positions, 0.01, axis=0)[1:-1], v[1:-1], atol=2e-3)


def test_replay_and_evaluate_run_on_it_end_to_end(quick: Path, tmp_path: Path):
    assert load_config(quick / "config.yaml").sensors["gnss_right"].kind == "gnss"
    run("replay", str(quick / "recording.mcap"), "-c", str(quick / "config.yaml"), "-o", str(tmp_path))
    verdict = tmp_path / "verdict.json"
    run("evaluate", str(tmp_path / "imu_in_world.tum"), str(quick / "truth/imu_in_world.tum"), "--json", str(verdict))
    whole = json.loads(verdict.read_text())["alignments"]["none"]["scores"]["all"]
    assert whole["pairs"] > 1800
    assert whole["ape"]["horizontal_m"]["rms"] < 0.05  # fixes of 8 mm, four seconds without them
    assert whole["ape"]["yaw_deg"]["rms"] < 1.0


def test_readme_and_settings_describe_what_was_done(quick: Path, tmp_path: Path):
    text = (quick / "README.md").read_text()
    assert f"holdfast simulate quick -o {quick.name} --seed 3 --scans" in text
    assert "12 to 16 s: outage of gnss, gnss_right, heading (no messages)" in text
    assert "| `/imu/data` | 2000 |" in text
    constants = (quick / "truth/constants.csv").read_text().splitlines()
    assert constants[0] == "sensor,constant,value"
    sensor, constant, value = constants[1].split(",")
    assert (sensor, constant) == ("joint", "zero_offset_rad")
    assert f"- zero_offset_rad of joint: {float(value):.6f}" in text
    run("simulate", str(quick / "scenario.yaml"), "-o", str(tmp_path / "again"), "--seed", "3", "--duration", "2")
    assert (quick / "plan.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "report"),
    [
        (("nonsense", "-o", "x"), "nonsense: no such scenario (allowed: arm-and-traffic, boastful-fixes"),
        (("quick", "-o", "x", "--duration", "0"), "--duration 0: must be > 1"),
        (("nowhere.yaml", "-o", "x"), "nowhere.yaml: no such file (shipped are arm-and-traffic, boastful-fixes"),
    ],
)
def test_a_mistake_gets_one_line(arguments: tuple[str, ...], report: str):
    with pytest.raises(ConfigError, match=r"^[^\n]*$") as caught:
        CliRunner().invoke(holdfast, ["simulate", *arguments], catch_exceptions=False, standalone_mode=False)
    assert report in str(caught.value)


def test_an_output_that_is_a_file_gets_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="is a file: the output must be a folder"):
        CliRunner().invoke(
            holdfast, ["simulate", "quick", "-o", str(tmp_path / "file")], catch_exceptions=False, standalone_mode=False
        )


def test_help_names_every_shipped_scenario():
    from holdfast.sim.scenario import shipped

    text = " ".join(run("simulate", "--help").split()).replace("- ", "-")  # the terminal breaks lines at hyphens
    assert all(name in text for name in shipped("scenarios"))
