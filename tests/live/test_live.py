"""`holdfast live` as a user starts it, with a machine on the same network: faults, controls, files, the end."""

import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from network import LOOPBACK, Machine, drive, messages, network
from ruamel.yaml import YAML

from holdfast.live.idl import STORE

IMU, FIX, JOINTS, ODOMETRY = (
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/JointState",
    "nav_msgs/msg/Odometry",
)
TOPICS = {
    "/imu/data": IMU,
    "/base_imu/data": IMU,
    "/gnss/left/fix": FIX,
    "/gnss/right/fix": FIX,
    "/gnss/heading": IMU,
    "/joint_states": JOINTS,
    "/lidar/odometry": ODOMETRY,
}
MACHINE = {
    "sensors": {"imu": {"kind": "imu", "topic": "/imu/data"}, "gnss": {"kind": "gnss", "topic": "/gnss/fix"}},
    "extrinsics": [{"parent": "imu", "child": "gnss", "translation_m": [1.0, 0.0, 1.0]}],
}
ARRAY = "diagnostic_msgs/msg/DiagnosticArray"


@pytest.fixture
def joined(domain):
    """Joins the domain from this process; leaves it at the end."""
    networks = []

    def join():
        networks.append(network(domain))
        return networks[-1]

    yield join
    for one in networks:
        one.close()


def first_message(topic):
    return next(message for _, _, _, _, message in messages(drive() / "recording.mcap", [topic]))


def cdr(message, name):
    now = time.time_ns()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
    return bytes(STORE.serialize_cdr(message, name))


def statuses(samples):
    """The newest diagnostics among samples, by name."""
    arrays = [STORE.deserialize_cdr(s.data, s.type_name) for s in samples if s.topic == "/diagnostics"]
    return {status.name: status for status in arrays[-1].status}


def values(status):
    return {entry.key: entry.value for entry in status.values}


def test_wrong_types_and_missing_topics_are_reported_in_one_line_and_so_is_their_end(live, domain):
    process = live(silent_after_s=1.0)
    with network(domain) as first:
        wrong = Machine(first, {"/imu/data": FIX, "/gnss/left/fix_raw": FIX})
        line = process.wait_for("warning: /imu/data: is published as sensor_msgs/msg/NavSatFix")
        assert line.endswith("must be sensor_msgs/msg/Imu")
        assert "did you mean /gnss/left/fix_raw" in process.wait_for("warning: /gnss/left/fix: nobody publishes it")
        del wrong
    with network(domain) as second:  # the driver comes back, mended
        publish = second.advertise("/imu/data", IMU)
        message = first_message("/imu/data")
        end = time.monotonic() + 20.0
        while not any("/imu/data: is well again" in line for line in process.lines()) and time.monotonic() < end:
            publish(cdr(message, IMU))
            time.sleep(0.05)
    process.wait_for("/imu/data: is well again", 1.0)
    lines = [line for line in process.lines() if "/gnss/right/fix: nobody" in line]
    assert len(lines) == 1  # once, not every second
    assert process.end(signal.SIGTERM) == 128 + signal.SIGTERM


def test_messages_that_make_no_sense_are_counted_and_reported_and_never_fatal(live, joined):
    process = live()
    process.wait_for("publishing")
    net = joined()
    net.subscribe("/diagnostics", ARRAY, reliable=True)
    machine = Machine(net, TOPICS)
    nowhere, rotten, ancient = (first_message(t) for t in ("/joint_states", "/lidar/odometry", "/imu/data"))
    nowhere.name = ["boom", "stick"]
    rotten.pose.pose.orientation.w = rotten.pose.pose.orientation.x = 0.0
    rotten.pose.pose.orientation.y = rotten.pose.pose.orientation.z = 0.0
    broken = first_message("/imu/data")
    broken.angular_velocity.x = float("nan")
    ancient.header.stamp.sec = 1
    samples = []
    for _ in range(30):  # three seconds: the publishers are found, and diagnostics come
        machine.publishers["/joint_states"](cdr(nowhere, JOINTS))
        machine.publishers["/lidar/odometry"](cdr(rotten, ODOMETRY))
        machine.publishers["/imu/data"](cdr(broken, IMU))
        machine.publishers["/base_imu/data"](bytes(STORE.serialize_cdr(ancient, IMU)))
        samples += machine.receive(time.monotonic() + 0.1)
    assert "'cabin_turn' is not among boom, stick" in process.wait_for("warning: /joint_states")
    assert "norm 0" in process.wait_for("warning: /lidar/odometry")
    assert "behind this machine's clock" in process.wait_for("warning: /base_imu/data: stamps are")
    reported = statuses(samples)
    for topic in ("/joint_states", "/lidar/odometry"):
        assert reported[f"holdfast: {topic}"].level in (1, b"\x01")
        assert 0 < int(values(reported[f"holdfast: {topic}"])["malformed"]) <= 30
    assert 0 < int(values(reported["holdfast"])["imu not_finite"]) <= 30
    machine.play(0.0, 3.0)
    process.wait_for("initialised")  # and nothing of it has done harm
    assert process.end() == 130


@pytest.mark.slow
def test_a_drive_with_controls_a_full_disk_and_ctrl_c(live, joined, tmp_path):
    log, scene, learnt = tmp_path / "log.mcap", tmp_path / "scene.rrd", tmp_path / "learnt.json"
    process = live("--record", log, "--view", scene, "--learnt", learnt, commands=True)
    process.wait_for("publishing")
    net = joined()
    machine = Machine(net, TOPICS)
    net.subscribe("/holdfast/odometry/base", ODOMETRY, reliable=True)
    net.subscribe("/tf", "tf2_msgs/msg/TFMessage", reliable=True)
    received = machine.play(0.0, 4.0)
    process.wait_for("initialised")
    frames = [STORE.deserialize_cdr(s.data, s.type_name) for s in received if s.topic == "/tf"][-1].transforms
    assert [(t.header.frame_id, t.child_frame_id) for t in frames] == [
        ("map", "odom"),
        ("odom", "base_link"),
        ("base_link", "cabin"),
    ]

    latched = {"/holdfast/datum": FIX, "/tf_static": "tf2_msgs/msg/TFMessage", "/rosout": "rcl_interfaces/msg/Log"}
    for topic, name in latched.items():  # for those who come late
        net.subscribe(topic, name, reliable=True, latched=True)
    late = machine.receive(time.monotonic() + 2.0)
    samples = {s.topic: STORE.deserialize_cdr(s.data, s.type_name) for s in late}
    logged = [STORE.deserialize_cdr(s.data, s.type_name).msg for s in late if s.topic == "/rosout"]
    assert any("the world's origin is" in text for text in logged) and any("initialised" in text for text in logged)
    configured = YAML(typ="safe").load((drive() / "config.yaml").read_text())["frames"]["datum"]
    datum = samples["/holdfast/datum"]
    assert (datum.latitude, datum.longitude, datum.altitude) == tuple(configured.values())
    mounts = {t.child_frame_id: t.header.frame_id for t in samples["/tf_static"].transforms}
    assert mounts["imu"] == "cabin" and mounts["base_imu"] == "base_link"

    limit_recorder(process.process.pid, log)
    set_datum = net.advertise("/holdfast/set_datum", FIX)
    machine.receive(time.monotonic() + 1.0)
    moved = first_message("/gnss/left/fix")
    moved.latitude, moved.longitude, moved.altitude = 47.41, 8.51, 500.0
    set_datum(cdr(moved, FIX))
    process.wait_for("the world's origin is 47.41000000, 8.51000000, 500.000 m")
    moved.latitude = float("nan")
    set_datum(cdr(moved, FIX))
    process.wait_for("is no position on the Earth; nothing is changed")

    received = machine.play(4.0, 8.0)  # it stands and drives on; the disk fills up meanwhile
    process.wait_for("the recording ends here")
    assert len([line for line in process.lines() if "the recording ends here" in line]) == 1
    bases = [s for s in received if s.topic == "/holdfast/odometry/base"]
    assert len(bases) > 50  # the estimator goes on
    assert process.end() == 130
    assert json.loads(learnt.read_text())["learnt"]["odometries"]["lidar"]
    recorded = [topic for _, topic in read_cut(log)]
    assert {"/imu/data", "/holdfast/odometry/world", "/holdfast/datum", "/tf_static"} <= set(recorded)
    assert entities(scene) >= {"/map/odom", "/map/odom/base_link/cabin", "/map/holdfast/odometry/world/track"}


def limit_recorder(parent, log):
    """Let the process that writes the log have no more room, as on a full disk."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            files = [entry.readlink() for entry in (folder / "fd").iterdir()]
        except OSError:
            continue
        if int(fields[1]) == parent and log in files:
            resource.prlimit(int(folder.name), resource.RLIMIT_FSIZE, (log.stat().st_size + 1000,) * 2)
            return
    raise AssertionError("nobody writes the log")


def read_cut(path):
    from holdfast.recording.source import open_recording

    with open_recording(path) as recording:
        return [(header.arrival_ns, header.topic) for header in recording.read_headers()]


def entities(scene):
    from rerun.chunk import RrdReader

    return {chunk.entity_path for chunk in RrdReader(scene).stream()}


def test_without_a_single_message_it_says_so_and_exits_with_4(live):
    process = live("--duration", 2)
    assert process.process.wait(60) == 4
    assert process.lines()[-1].startswith("error: the estimator never started: ")


@pytest.mark.parametrize("mistake", [
    ((), {"interface": "nowhere0"}, "live.interface = nowhere0: this machine has"),
    ((), {"domain_id": 233}, "live.domain_id = 233: must be <= 232"),
    ((), {"namespace": "machine"}, "live.namespace"),
    ((), {"sensors": {"gnss": {"kind": "gnss", "topic": "/imu/data"}}},
     "sensors.gnss.topic: /imu/data is that of another sensor"),
    (("--record", "/nowhere/log.mcap"), {}, "--record /nowhere/log.mcap: cannot be written"),
    (("--view", "scene.mp4"), {}, "--view scene.mp4: must be"),
    (("--duration", "-1"), {}, "--duration -1: must be > 0"),
])  # fmt: skip
def test_a_mistake_of_the_user_is_one_line_and_exit_code_2(domain, tmp_path, mistake, capfd):
    arguments, settings, words = mistake[0], dict(mistake[1]), mistake[2]
    from holdfast.cli import main

    sensors = MACHINE["sensors"] | settings.pop("sensors", {})
    content = MACHINE | {"sensors": sensors, "live": LOOPBACK | {"domain_id": domain} | settings}
    (tmp_path / "live.yaml").write_text(json.dumps(content))
    with pytest.MonkeyPatch.context() as patched, pytest.raises(SystemExit) as stopped:
        patched.setattr("sys.argv", ["holdfast", "live", "-c", str(tmp_path / "live.yaml"), *arguments])
        main()
    assert stopped.value.code == 2
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 1 and words in lines[0], lines


def test_the_end_that_a_service_manager_asks_for_is_told_as_ctrl_c_is(live):
    process = live()
    process.wait_for("publishing")
    assert process.end(signal.SIGTERM) == 128 + signal.SIGTERM
    assert process.lines()[-1] == "interrupted"


@pytest.mark.parametrize("after_s", [0.6, 1.2, 1.8])
def test_ctrl_c_while_it_starts_is_one_word_and_no_traceback_of_any_process(live, tmp_path, after_s):
    process = live("--record", tmp_path / "log.mcap")
    time.sleep(after_s)
    assert process.end() == 130
    output = "\n".join(process.lines())
    assert "Traceback" not in output and "KeyboardInterrupt" not in output, output
    assert process.lines()[-1] == "interrupted"


@pytest.mark.parametrize(("missing", "arguments", "extra"), [
    ("cyclonedds", ("live", "-c", "CONFIG"), "dds"),
    ("rerun", ("live", "-c", "CONFIG", "--view"), "viz"),
    ("rerun", ("view", "RECORDING"), "viz"),
])  # fmt: skip
def test_a_missing_extra_is_named_with_the_command_that_installs_it(missing, arguments, extra, domain, tmp_path):
    content = MACHINE | {"live": LOOPBACK | {"domain_id": domain}}
    (tmp_path / "live.yaml").write_text(json.dumps(content))
    places = {"CONFIG": str(tmp_path / "live.yaml"), "RECORDING": str(drive() / "recording.mcap")}
    code = f"import sys; sys.modules[{missing!r}] = None; from holdfast.cli import main; main()"
    command = [sys.executable, "-c", code, *(places.get(argument, argument) for argument in arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[0].endswith(f"pip install -e '.[{extra}]' in the checkout of Holdfast")
    assert len(done.stderr.splitlines()) == 1
