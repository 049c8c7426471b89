"""A real ROS 2 node plays a drive to us and hears what we publish: rclpy with Fast DDS, in two distributions."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from network import drive, messages, plain
from ruamel.yaml import YAML

from holdfast.cli import holdfast
from holdfast.live.idl import STORE
from holdfast.recording.tum import read_tum

SECONDS = 6.0
NODE = Path(__file__).parent / "peer" / "node.py"
TOPICS = {
    "/holdfast/odometry/world": "nav_msgs/msg/Odometry",
    "/holdfast/odometry/odom": "nav_msgs/msg/Odometry",
    "/holdfast/odometry/base": "nav_msgs/msg/Odometry",
    "/holdfast/path": "nav_msgs/msg/Path",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/holdfast/datum": "sensor_msgs/msg/NavSatFix",
}


def played():
    """What the peer plays of the drive."""
    rows = [row for row in messages(drive() / "recording.mcap") if row[1] not in ("/tf", "/tf_static")]
    return [
        [(at - rows[0][0]) * 1e-9, topic, name, raw.hex()]
        for at, topic, name, raw, _ in rows
        if (at - rows[0][0]) * 1e-9 < SECONDS
    ]


def converse(python, domain, folder, play):
    """Let the peer play a drive, and return what it sent and received."""
    task = {"play": play, "linger_s": 1.5, "then": [["/holdfast/reset", "std_msgs/msg/Empty", {}]]}
    task["receive"] = [[topic, name, topic.endswith("datum")] for topic, name in TOPICS.items()]
    (folder / "task.json").write_text(json.dumps(task))
    environment = {"PATH": os.environ["PATH"], "HOME": str(folder), "ROS_DOMAIN_ID": str(domain)}
    done = subprocess.run(
        [python, NODE, folder / "task.json", folder / "found.json"],
        env=environment | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=90,
    )
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "found.json").read_text())


def by_stamp(found):
    return {(m["header"]["stamp"]["sec"], m["header"]["stamp"]["nanosec"]): m for m in found}


@pytest.mark.slow
@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_a_ros_node_and_holdfast_agree_on_every_field(distribution, ros_python, live, domain, tmp_path):
    python = ros_python(distribution)
    log = tmp_path / "log.mcap"
    process = live("--record", log, commands=True)
    process.wait_for("publishing")
    found = converse(python, domain, tmp_path, played())
    process.wait_for("/holdfast/reset: the estimator begins anew")
    assert process.end() == 130, process.lines()
    recorded = {}
    for _, topic, _, _, message in messages(log):
        recorded.setdefault(topic, []).append(plain(message))

    for topic, sent in found["sent"].items():
        received = by_stamp(recorded[topic])
        # its publishers are best-effort, as those of drivers are: on a busy machine the network may lose a few
        assert len(received) > 0.98 * len(sent), topic
        known = by_stamp(sent)
        for stamp, message in received.items():
            assert message == known[stamp], topic

    for topic in ("/holdfast/odometry/world", "/holdfast/odometry/odom", "/holdfast/odometry/base"):
        arrived = by_stamp(found["received"][topic])
        assert len(arrived) > 100 * (SECONDS - 4.0), topic  # it starts within 3 s of standstill
        assert arrived == {stamp: m for stamp, m in by_stamp(recorded[topic]).items() if stamp >= min(arrived)}, topic
        assert arrived.keys() <= by_stamp(found["sent"]["/imu/data"]).keys()  # header stamps are those of the IMU
    for topic in ("/holdfast/path", "/holdfast/datum", "/diagnostics"):
        arrived = [single_bytes(message) for message in found["received"][topic]]
        assert arrived
        assert all(message in recorded[topic] for message in arrived), topic
    assert {topic: found["topics"].get(topic) for topic in TOPICS} == {topic: [name] for topic, name in TOPICS.items()}
    assert any(m["status"][0]["message"] == "nominal" for m in found["received"]["/diagnostics"])
    arrived = found["received"]["/holdfast/odometry/world"]
    stamps = [m["header"]["stamp"]["sec"] * 10**9 + m["header"]["stamp"]["nanosec"] for m in arrived]
    positions = [[m["pose"]["pose"]["position"][axis] for axis in "xyz"] for m in arrived]
    assert_near_truth(stamps, np.array(positions), found["offset_ns"])
    assert (
        CliRunner().invoke(holdfast, ["replay", str(log), "-c", process.config, "-o", str(tmp_path / "out")]).exit_code
        == 0
    )
    replayed = read_tum(tmp_path / "out" / "imu_in_world.tum")  # the log is a recording like any other
    assert_near_truth(replayed.stamps_ns, replayed.positions, found["offset_ns"])


def single_bytes(message):
    """The octets of diagnostics are a list of one number in rclpy, and a number elsewhere."""
    for status in message.get("status", []) if "status" in message and isinstance(message["status"], list) else []:
        (status["level"],) = status["level"]
    return message


def assert_near_truth(stamps_ns, positions, offset_ns):
    """Fixes have a sigma of 8 mm horizontally: what is estimated stays within 5 cm of the truth."""
    truth = read_tum(drive() / "truth" / "imu_in_world.tum")
    at = np.asarray(stamps_ns) - offset_ns - truth.stamps_ns[0]
    for axis in range(2):
        true = np.interp(at, truth.stamps_ns - truth.stamps_ns[0], truth.positions[:, axis])
        assert np.abs(positions[:, axis] - true).max() < 0.05


CLOUD = "sensor_msgs/msg/PointCloud2"


def with_thin_clouds(folder):
    """What a peer plays of a drive with scans: of each cloud every fourth point, and no odometry."""
    simulate = ["simulate", "quick", "--scans", "--duration", "8", "-o", str(folder)]
    assert CliRunner().invoke(holdfast, simulate).exit_code == 0
    rows, play = list(messages(folder / "recording.mcap")), []
    for at, topic, name, raw, message in rows:
        if topic in ("/tf", "/tf_static", "/lidar/odometry"):
            continue
        if name == CLOUD:
            points = message.data.reshape(-1, message.point_step)[::4]
            message.data, message.width, message.row_step = points.ravel(), len(points), points.size
            raw = bytes(STORE.serialize_cdr(message, name))  # noqa: PLW2901
        play.append([(at - rows[0][0]) * 1e-9, topic, name, raw.hex()])
    return play


@pytest.mark.slow
def test_clouds_that_a_ros_node_publishes_become_an_odometry(ros_python, live, domain, tmp_path):
    pytest.importorskip("small_gicp")
    python, play = ros_python("jazzy"), with_thin_clouds(tmp_path / "quick")
    config = YAML(typ="safe").load((tmp_path / "quick" / "config.yaml").read_text())
    config["sensors"]["lidar"] |= {"kind": "scans", "topic": "/lidar/points"}
    process = live(config=config, commands=True)
    process.wait_for("publishing")
    found = converse(python, domain, tmp_path, play)
    process.wait_for("initialised")
    told = [
        {entry["key"]: entry["value"] for entry in status["values"]}
        for array in found["received"]["/diagnostics"]
        for status in array["status"]
        if status["name"] == "holdfast: odometry of lidar"
    ]
    sent = len(found["sent"]["/lidar/points"])
    assert int(told[-1]["received"]) >= 0.8 * sent  # its publisher is best-effort
    assert int(told[-1]["poses"]) >= 3 and told[-1]["refused"] == "0"
    used = next(status for status in found["received"]["/diagnostics"][-1]["status"] if status["name"] == "holdfast")
    assert int({entry["key"]: entry["value"] for entry in used["values"]}["lidar used"]) >= 1
    assert process.end() == 130
