"""`holdfast lidar-odometry`: bags in, bags out."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from bags import HUMBLE, imu, store_of, write_bag
from cloud_bags import DELAY_NS, SWEEPS, THING, convert, messages, read, sweeps, turning
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from yard import START_NS, error, message

from holdfast.config.load import parse_config
from holdfast.errors import ConfigError, RecordingError
from holdfast.lidar_odometry import registration, runner
from holdfast.lidar_odometry.registration import Registered
from holdfast.lidar_odometry.replayed import ReplayedScans
from holdfast.recording.bag_file import Channel
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.raw import RawChannel, RawCopier
from holdfast.recording.source import Subscription, open_recording
from holdfast.recording.subscriptions import subscriptions

pytest.importorskip("small_gicp")


@pytest.fixture(scope="module", params=["bag", "db3", "mcap"])
def converted(request, tmp_path_factory):
    """A bag of every kind, and what the command made of it."""
    folder = tmp_path_factory.mktemp(request.param)
    bag = write_bag(folder / "in", request.param, messages(store_of(request.param)))
    return bag, convert(bag, folder / "new" / "out.mcap")


def test_poses_take_the_place_of_the_clouds(converted):
    _, out = converted
    with open_recording(out) as recording:
        counts = {info.topic: (info.type, info.count) for info in recording.topics}
    assert counts == {
        "/imu": ("sensor_msgs/msg/Imu", SWEEPS * 20),
        "/things": (THING, 1),
        "/lidar/odometry": ("nav_msgs/msg/Odometry", SWEEPS),
    }
    arrivals = [at for _, at, _ in read(out)]
    assert arrivals == sorted(arrivals)


def test_what_is_copied_is_the_same_message_at_the_same_time(converted):
    bag, out = converted
    for topic in ("/imu", "/things"):
        before, after = read(bag, topic), read(out, topic)
        assert [at for _, at, _ in after] == [at for _, at, _ in before]
        for (_, _, a), (_, _, b) in zip(before, after, strict=True):
            assert (a.header.stamp.sec, a.header.stamp.nanosec) == (b.header.stamp.sec, b.header.stamp.nanosec)
            assert a.header.frame_id == b.header.frame_id
    [(_, _, thing)] = read(out, "/things")
    assert (thing.load, thing.who) == (1250.5, ["left", "right"])
    assert read(out, "/imu")[5][2].angular_velocity.z == 0.1


def test_poses_are_true_at_their_stamps_and_arrive_late(converted):
    _, out = converted
    poses = [(at, m) for _, at, m in read(out, "/lidar/odometry")]
    assert [at for at, _ in poses] == [START_NS + k * 200_000_000 + DELAY_NS + 80_000_000 for k in range(SWEEPS)]
    with open_recording(out) as recording:
        lidar = list(recording.read([Subscription("/lidar/odometry", "lidar", "odometry")]))
    middle_ns = round(sweeps()[0].middle_s * 1e9)
    assert [pose.stamp_ns for pose in lidar] == [START_NS + k * 200_000_000 + middle_ns for k in range(SWEEPS)]
    first = Registered(lidar[0].stamp_ns, np.eye(4))
    for pose in lidar:
        x, y, z, w = pose.quaternion
        T = gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), pose.position).matrix()
        residual = error(Registered(pose.stamp_ns, T), first, turning)
        assert np.abs(residual[:3]).max() < 2e-3
        assert np.abs(residual[3:]).max() < 0.05  # the first sweep cannot be deskewed
    _, last = poses[-1]
    assert (last.header.frame_id, last.child_frame_id) == ("lidar_odom", "lidar")


def test_the_first_covariance_is_unknown_and_the_others_are_small_and_positive(converted):
    covariances = [m.pose.covariance.reshape(6, 6) for _, _, m in read(converted[1], "/lidar/odometry")]
    assert not covariances[0].any()
    for covariance in covariances[1:]:
        sigmas = np.sqrt(np.linalg.eigvalsh(covariance))
        assert (sigmas > 1e-6).all()
        assert np.sqrt(covariance.diagonal()[:3]).max() < 0.01
        assert np.sqrt(covariance.diagonal()[3:]).max() < 0.001


def test_a_covariance_is_turned_to_the_axes_of_the_frame():
    from holdfast.ros.cdr import OdometryEncoder

    T = np.eye(4)
    T[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]  # x of L is y of the frame
    covariance = np.diag([1e-6, 2e-6, 3e-6, 1e-2, 2e-2, 3e-2])
    raw = runner.encode(Registered(START_NS, T, covariance), OdometryEncoder("a", "b"))
    ros = HUMBLE.deserialize_cdr(raw, "nav_msgs/msg/Odometry").pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(ros.diagonal(), [2e-2, 1e-2, 3e-2, 2e-6, 1e-6, 3e-6])


@pytest.fixture(scope="module")
def plain(bag, tmp_path_factory):
    """What the command makes of the bag without further options."""
    return convert(bag, tmp_path_factory.mktemp("plain") / "out.mcap", "--replace")


def test_the_same_bag_gives_the_same_bytes(bag, plain, tmp_path):
    assert convert(bag, tmp_path / "out.mcap", "--replace").read_bytes() == plain.read_bytes()


def test_options_of_the_output(bag, tmp_path):
    out = convert(bag, tmp_path / "out.mcap", "--output-topic", "/new", "--keep-scans", "--latency-s", 0.5)
    rows = read(out)
    assert {topic for topic, _, _ in rows} == {"/imu", "/things", "/points", "/lidar/odometry", "/new"}
    assert [at for _, at, _ in rows] == sorted(at for _, at, _ in rows)
    clouds = [at for topic, at, _ in rows if topic == "/points"]
    assert [at - 500_000_000 for topic, at, _ in rows if topic == "/new"] == clouds
    [(_, _, cloud), *_] = read(out, "/points")
    np.testing.assert_array_equal(cloud.data, message(HUMBLE, sweeps()[0]).data)


def test_the_gyroscope_of_a_configuration_is_used(bag, plain, tmp_path, capsys):
    text = "sensors: {{imu: {{kind: imu, topic: {}}}, lidar: {{kind: odometry, topic: /lidar/odometry}}}}\n"
    text += "extrinsics: [{{parent: imu, child: lidar, translation_m: [0, 0, 0]}}]"
    config = tmp_path / "config.yaml"
    config.write_text(text.format("/imu"))
    helped = convert(bag, tmp_path / "helped.mcap", "--replace", "-c", config)
    assert capsys.readouterr().err == ""
    assert plain.read_bytes() != helped.read_bytes()
    config.write_text(text.format("/nothing"))
    with pytest.raises(RecordingError, match="has no topic '/nothing'"):
        convert(bag, tmp_path / "none.mcap", "--replace", "-c", config)


def test_a_replay_sees_the_poses_that_the_command_writes_to_the_bit_and_at_the_same_times(bag, tmp_path):
    text = """
sensors:
  imu: {kind: imu, topic: /imu}
  lidar: {kind: scans, topic: /points, latency_s: 0.13, scan_voxel_m: 0.3}
extrinsics: [{parent: imu, child: lidar, translation_m: [0, 0, 0]}]
"""
    (tmp_path / "config.yaml").write_text(text)
    out = convert(bag, tmp_path / "out.mcap", "--replace", "-c", tmp_path / "config.yaml", "--latency-s", 0.13)
    with open_recording(out) as recording:
        written = list(recording.read([Subscription("/lidar/odometry", "lidar", "odometry")]))
    config = parse_config(text)
    with open_recording(bag) as recording, ReplayedScans(config, recording.read(subscriptions(config))) as scanned:
        replayed = list(scanned)
        assert scanned.warnings() == []
    arrivals = [message.arrival_ns for message in replayed]
    assert arrivals == sorted(arrivals)
    poses = [message for message in replayed if message.sensor == "lidar"]
    assert len(replayed) - len(poses) == SWEEPS * 20
    assert len(poses) == len(written) == SWEEPS
    for pose, other in zip(poses, written, strict=True):
        assert (pose.stamp_ns, pose.arrival_ns) == (other.stamp_ns, other.arrival_ns)
        np.testing.assert_array_equal(pose.position, other.position)
        np.testing.assert_allclose(pose.quaternion, other.quaternion, atol=1e-15)
        if pose.covariance is not None:
            np.testing.assert_allclose(pose.covariance, other.covariance, atol=1e-15)


def test_of_two_odometries_the_one_of_the_output_topic_names_the_mounting(bag, tmp_path):
    config = tmp_path / "config.yaml"
    text = """
sensors:
  imu: {kind: imu, topic: /imu}
  lidar: {kind: odometry, topic: %s}
  camera: {kind: odometry, topic: /camera/odometry}
extrinsics:
  - {parent: imu, child: lidar}
  - {parent: imu, child: camera, rotation_rpy_deg: [0, 0, 90]}
"""
    config.write_text(text % "/lidar/odometry")
    one = convert(bag, tmp_path / "one.mcap", "--replace", "-c", config)
    config.write_text(text.replace("[0, 0, 90]", "[0, 0, 0]") % "/lidar/odometry")
    assert convert(bag, tmp_path / "other.mcap", "--replace", "-c", config).read_bytes() == one.read_bytes()
    config.write_text(text % "/other/odometry")
    with pytest.raises(ConfigError, match=r"the topic /lidar/odometry is needed .*lidar, camera"):
        convert(bag, tmp_path / "none.mcap", "--replace", "-c", config)


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ([], ConfigError, "has a topic '/lidar/odometry' already: give another --output-topic or --replace"),
        (["--replace", "--topic", "/imu"], RecordingError, "is sensor_msgs/msg/Imu (allowed: sensor_msgs/msg/Point"),
        (["--replace", "--topic", "/pionts"], RecordingError, "did you mean '/points'?"),
        (["--output-topic", "/points"], ConfigError, "has a topic '/points' already: give another --output-topic"),
        (["--output-topic", "bad topic"], ConfigError, "--output-topic: 'bad topic' is no name of a topic (allowed: "),
        (["--replace", "--min-range-m", 500], RecordingError, "0 points lie beyond 500 m"),
        (["--method", "kiss-icp", "-c", "x.yaml"], ConfigError, "kiss-icp takes no IMU"),
    ],
)
def test_a_mistake_is_one_clear_line(bag, tmp_path, options, kind, words):
    with pytest.raises(kind) as raised:
        convert(bag, tmp_path / "out.mcap", *options)
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_bag_needs_one_topic_of_clouds(tmp_path):
    none = write_bag(tmp_path / "none", "mcap", [("/imu", START_NS, imu(HUMBLE, START_NS))])
    with pytest.raises(RecordingError, match=r"has no topic of sensor_msgs/msg/PointCloud2; it has /imu"):
        convert(none, tmp_path / "out.mcap")
    rows = [(topic, START_NS, message(HUMBLE, sweeps()[0])) for topic in ("/front", "/rear")]
    two = write_bag(tmp_path / "two", "mcap", rows)
    with pytest.raises(ConfigError, match="give --topic one of /front, /rear"):
        convert(two, tmp_path / "out.mcap")


def test_nothing_is_overwritten_unasked(bag, tmp_path):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(ConfigError, match="exists already: --force overwrites it"):
        convert(bag, out, "--replace")
    with pytest.raises(ConfigError, match="has a topic"):  # found before anything is overwritten
        convert(bag, out, "--force")
    assert out.read_bytes() == b"precious"
    convert(bag, out, "--replace", "--force")
    assert len(read(out, "/lidar/odometry")) == SWEEPS
    with pytest.raises(ConfigError, match="which is read: give another output"):
        convert(bag, bag, "--replace", "--force")
    with pytest.raises(ConfigError, match=r"must end in \.mcap"):
        convert(bag, tmp_path / "out.bag", "--replace")


def test_clouds_that_cannot_be_used_are_counted_and_the_others_are(tmp_path, capsys):
    rows = messages(HUMBLE)
    clouds = [number for number, row in enumerate(rows) if row[0] == "/points"]
    raw = {clouds[2]: b"\x00\x01\x00\x00 no cloud"}
    topic, arrival, _ = rows[clouds[4]]
    rows[clouds[4]] = (topic, arrival, rows[clouds[3]][2])  # the same cloud twice
    broken = write_bag(tmp_path / "in", "mcap", rows, raw=raw)
    out = convert(broken, tmp_path / "out.mcap")
    assert len(read(out, "/lidar/odometry")) == SWEEPS - 2
    [warning] = capsys.readouterr().err.splitlines()
    assert "2 messages of /points" in warning


def test_a_missing_library_is_named_with_the_command_that_installs_it(bag, tmp_path, monkeypatch):
    monkeypatch.setattr(registration, "find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=r"needs genz_icp: pip install genz-icp$"):
        convert(bag, tmp_path / "out.mcap", "--method", "genz-icp")
    assert not (tmp_path / "out.mcap").exists()


def test_what_nobody_could_read_later_is_left_out_and_named(tmp_path):
    undefined = MessageDefinition(MessageDefinitionFormat.NONE, "")
    channels = [
        RawChannel(tmp_path, False, Channel(number, topic, type_name, undefined, "", 1))
        for number, (topic, type_name) in enumerate([("/imu", "sensor_msgs/msg/Imu"), ("/things", THING)])
    ]
    with McapWriter(tmp_path / "out.mcap") as writer:
        copier = RawCopier(writer, channels)
        for channel in channels:
            copier.copy(START_NS, channel, bytes(HUMBLE.serialize_cdr(imu(HUMBLE, START_NS), "sensor_msgs/msg/Imu")))
    [line] = copier.left_out
    assert line.startswith(f"/things ({THING}): ")
    assert [topic for topic, _, _ in read(tmp_path / "out.mcap")] == ["/imu"]


def test_stamps_may_begin_at_zero(tmp_path, capfd):
    rows = [
        ("/points", k * 200_000_000, message(HUMBLE, replace(sweeps()[k], stamp_ns=k * 200_000_000))) for k in range(2)
    ]
    out = convert(write_bag(tmp_path / "in", "mcap", rows), tmp_path / "out.mcap")
    assert len(read(out, "/lidar/odometry")) == 2
    assert capfd.readouterr().err == ""
