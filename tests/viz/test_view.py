"""`holdfast view` without a screen: what is in the file that the viewer opens."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rosbags.highlevel import AnyReader

from holdfast.config.load import load_config
from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.recording.mcap_writer import McapWriter
from holdfast.recording.tum import read_tum
from holdfast.viz.show import draw_live

FIX = "sensor_msgs/msg/NavSatFix"
SINGLE = 1e-5  # Rerun keeps positions as float32: 1e-7 of the 100 m within which the drive stays


def content(scene):
    """What changes with time, by entity: (stamps [ns], {column: rows})."""
    found = {}
    for chunk in RrdReader(scene).stream():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            stamps, columns = found.setdefault(chunk.entity_path, ([], {}))
            stamps += batch.column("time").cast("int64").to_pylist()
            for name in batch.schema.names:
                if ":" in name and "RowId" not in name:
                    columns.setdefault(name, []).extend(batch.column(name).to_pylist())
    return found


@pytest.fixture(scope="module")
def scene(replayed, run, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "replay.rrd"
    code, printed = run("view", replayed, "-o", path)
    assert code == 0 and printed == f"written to {path}\n", printed
    return content(path)


@pytest.fixture(scope="module")
def odometries(replayed):
    with AnyReader([replayed / "estimates.mcap"]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/holdfast/odometry/world"]
        return {at: reader.deserialize(raw, c.msgtype) for c, at, raw in reader.messages(wanted)}


def test_the_track_runs_through_the_published_positions(scene, replayed):
    track = read_tum(replayed / "imu_in_world.tum")
    stamps, columns = scene["/map/holdfast/odometry/world/track"]
    published = dict(zip(track.stamps_ns.tolist(), track.positions, strict=True))
    strips = np.array(columns["LineStrips3D:strips"])[:, 0]  # one line from the position before to this one
    np.testing.assert_allclose(strips[:, 1], [published[at] for at in stamps], rtol=0, atol=SINGLE)
    np.testing.assert_array_equal(strips[1:, 0], strips[:-1, 1])
    assert np.diff(stamps).max() <= 60_000_000  # 20 times a second, from an IMU at 100 Hz
    assert stamps[-1] - stamps[0] > 0.98 * (track.stamps_ns[-1] - track.stamps_ns[0])


def test_ellipsoids_are_three_sigma_of_the_published_covariance(scene, odometries):
    stamps, columns = scene["/map/holdfast/odometry/world/uncertainty"]
    assert np.diff(stamps).max() <= 300_000_000
    for row, at in enumerate(stamps):
        P = np.asarray(odometries[at].pose.covariance).reshape(6, 6)[:3, :3]
        half = np.array(columns["Ellipsoids3D:half_sizes"][row][0])
        x, y, z, w = columns["Ellipsoids3D:quaternions"][row][0]
        R = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        np.testing.assert_allclose(R @ np.diag((half / 3.0) ** 2) @ R.T, P, rtol=0, atol=1e-5 * np.trace(P))


def test_frames_stand_below_their_parents(scene):
    body = "/map/odom/base_link"
    assert {"/map/odom", body, f"{body}/cabin", f"{body}/cabin/imu", f"{body}/base_imu"} <= scene.keys()
    assert "/map/odom/holdfast/odometry/base/track" in scene  # its poses are in the frame of the odometry


def test_time_series_hold_sigma_speed_height_and_yaw(scene, odometries):
    series = {}
    for name in ("position_sigma_m", "speed_m_s", "height_m", "yaw_deg"):
        stamps, columns = scene[f"/plots/{name}/holdfast/odometry/world"]
        series[name] = dict(zip(stamps, np.ravel(columns["Scalars:scalars"]), strict=True))
    for at, sigma in series["position_sigma_m"].items():
        message = odometries[at]
        assert sigma == pytest.approx(np.sqrt(np.trace(np.reshape(message.pose.covariance, (6, 6))[:3, :3])))
        v, q = message.twist.twist.linear, message.pose.pose.orientation
        assert series["speed_m_s"][at] == pytest.approx(np.linalg.norm((v.x, v.y, v.z)))
        assert series["height_m"][at] == message.pose.pose.position.z
        yaw = np.arctan2(2 * (q.x * q.y + q.z * q.w), 1 - 2 * (q.y**2 + q.z**2))
        assert series["yaw_deg"][at] == pytest.approx(np.degrees(yaw))


def test_what_smooth_wrote_shows_its_causal_run(replayed, run, tmp_path):
    """Its tables were taken for a recording of CSV files, whose columns nobody knew."""
    (tmp_path / "best").mkdir()
    (tmp_path / "best" / "biases.csv").write_text("stamp_ns,bias_x_m_s2\n")
    (tmp_path / "best" / "causal").symlink_to(replayed)
    code, printed = run("view", tmp_path / "best", "-o", tmp_path / "best.rrd")
    assert code == 0, printed
    assert "note: the causal run is drawn, not the optimum over the recording\n" in printed
    assert "/map/holdfast/odometry/world/track" in content(tmp_path / "best.rrd")


def test_every_event_is_in_the_log_at_its_time(scene, replayed):
    events = [json.loads(line) for line in (replayed / "events.jsonl").read_text().splitlines()]
    stamps, columns = scene["/log/events"]
    assert sorted(stamps) == sorted(event["stamp_ns"] for event in events)
    texts = [text for (text,) in columns["TextLog:text"]]
    assert all(any(event["reason"] in text for text in texts) for event in events)


def test_a_bag_of_sensors_shows_its_fixes_where_they_are(drive, run, tmp_path):
    assert run("view", drive / "recording.mcap", "-o", tmp_path / "bag.rrd")[0] == 0
    found = content(tmp_path / "bag.rrd")
    stamps, columns = found["/map/gnss/left/fix/track"]
    with AnyReader([drive / "recording.mcap"]) as reader:
        wanted = [c for c in reader.connections if c.topic.endswith("/fix")]
        fixes = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages(wanted)]
    world = LocalFrame(Geodetic(fixes[0][1].latitude, fixes[0][1].longitude, fixes[0][1].altitude))
    left = [world.to_enu(Geodetic(m.latitude, m.longitude, m.altitude)) for t, m in fixes if t == "/gnss/left/fix"]
    np.testing.assert_allclose(np.array(columns["Points3D:positions"])[:, 0], left, rtol=0, atol=SINGLE)
    assert len(stamps) == len(left)
    lidar = load_config(drive / "config.yaml").sensors["lidar"]
    assert any(entity.endswith(f"{lidar.topic}/track") for entity in found)


@pytest.mark.parametrize(("arguments", "code", "words"), [
    (("nowhere.mcap", "-o", "scene.rrd"), 3, "nowhere.mcap: no such file or folder"),
    (("nowhere.mcap", "-o", "scene.mp4"), 2, "--output scene.mp4: must be"),
    (("nowhere.mcap", "--connect", "laptop"), 2, "--connect laptop: must be"),
    (("nowhere.mcap", "-o", "scene.rrd", "--connect", "laptop"), 2, "give only one"),
])  # fmt: skip
def test_a_mistake_of_the_user_is_one_line(run, arguments, code, words):
    found, printed = run("view", *arguments)
    assert found == code
    assert len(printed.splitlines()) == 1 and words in printed, printed


def test_a_viewer_that_does_not_run_is_one_line(drive, run):
    found, printed = run("view", drive / "recording.mcap", "--connect", "rerun+http://127.0.0.1:1/proxy")
    assert found == 2
    assert len(printed.splitlines()) == 1 and "127.0.0.1:1/proxy: no viewer listens there" in printed, printed


def test_a_viewer_that_goes_away_while_it_is_sent_to_is_one_line(drive, run, monkeypatch):
    def gone(*_, **__):
        raise RuntimeError("gRPC connection severed")

    monkeypatch.setattr("rerun.RecordingStream.flush", gone)
    found, printed = run("view", drive / "recording.mcap", "-o", drive.parent / "gone.rrd")
    assert found == 2
    assert len(printed.splitlines()) == 1 and "not all could be drawn (gRPC connection severed)" in printed, printed


def test_a_live_stream_without_its_viewer_complains_in_one_line_and_ends():
    complaints = []
    feed = SimpleNamespace(batches=lambda _: [], complain=complaints.append)
    draw_live(feed, "rerun+http://127.0.0.1:1/proxy")
    assert len(complaints) == 1 and complaints[0].startswith("--view rerun+http://127.0.0.1:1/proxy: no viewer")


def test_a_file_that_cannot_be_written_is_one_line(drive, run, tmp_path):
    code, printed = run("view", drive / "recording.mcap", "-o", tmp_path / "nowhere" / "scene.rrd")
    assert code == 2
    assert len(printed.splitlines()) == 1 and "scene.rrd" in printed, printed


def test_fixes_of_a_log_are_about_its_datum_from_the_first_on(drive, run, tmp_path):
    datum = load_config(drive / "config.yaml").frames.datum
    with AnyReader([drive / "recording.mcap"]) as reader, McapWriter(tmp_path / "log.mcap") as log:
        wanted = [c for c in reader.connections if c.topic == "/gnss/left/fix"]
        rows = [(at, bytes(raw), reader.deserialize(raw, c.msgtype)) for c, at, raw in reader.messages(wanted)]
        published = rows[0][2]
        for number, (at, raw, _) in enumerate(rows):
            log.write("/gnss/left/fix", raw, FIX, at)
            if number == 3:  # the node publishes its datum after the first fixes
                published.latitude, published.longitude = datum.latitude_deg, datum.longitude_deg
                published.altitude = datum.altitude_m
                log.write("/holdfast/datum", published, FIX, at)
    assert run("view", tmp_path / "log.mcap", "-o", tmp_path / "log.rrd")[0] == 0
    found = content(tmp_path / "log.rrd")
    world = LocalFrame(Geodetic(datum.latitude_deg, datum.longitude_deg, datum.altitude_m))
    fixes = [m for _, _, m in rows[1:]]
    expected = [world.to_enu(Geodetic(m.latitude, m.longitude, m.altitude)) for m in fixes]
    positions = np.array(found["/map/gnss/left/fix/track"][1]["Points3D:positions"])[:, 0]
    assert len(positions) == len(rows)
    np.testing.assert_allclose(positions[1:], expected, rtol=0, atol=SINGLE)
    assert np.linalg.norm(positions[0] - positions[1]) < 1.0  # the machine stands
