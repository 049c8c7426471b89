"""What a replay writes: complete, readable by others, and of one mind."""

import itertools
import json

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from small_drive import (
    EPOCH_NS,
    FILES,
    SECONDS,
    STAND_S,
    T_I_B,
    events,
    holdfast,
    pose,
    poses,
    stamp,
    summary,
    write_config,
)

from holdfast.config.model import GnssConfig
from holdfast.recording.tum import read_tum

ROUNDING = 1e-9  # the TUM files have 9 decimals


def track(folder, name):
    return poses(read_tum(folder / f"{name}.tum"))


def messages(folder, topic):
    """The messages of a topic by stamp."""
    with AnyReader([folder / "estimates.mcap"]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [(at, reader.deserialize(raw, c.msgtype)) for c, at, raw in reader.messages(connections)]


def stamp_of(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def array(point):
    return np.array([point.x, point.y, point.z] + ([point.w] if hasattr(point, "w") else []))


def covariance(part):
    return np.asarray(part.covariance).reshape(6, 6)


def assert_same_pose(position, quaternion_xyzw, T, tolerance=ROUNDING):
    np.testing.assert_allclose(position, T.translation(), rtol=0, atol=tolerance)
    expected = T.rotation().toQuaternion().coeffs()
    assert min(abs(quaternion_xyzw - expected).max(), abs(quaternion_xyzw + expected).max()) <= tolerance


def assert_poses_close(A, B, tolerance):
    assert np.abs(A.matrix() - B.matrix()).max() <= tolerance


def test_every_file_of_the_contract_is_written(replayed):
    assert {file.name for file in replayed.iterdir()} == FILES | {"base_in_world.tum", "base_in_odom.tum"}


def test_published_tracks_have_one_pose_per_imu_sample_from_the_start_on(replayed):
    stamps = list(track(replayed, "imu_in_world"))
    started = next(event["stamp_ns"] for event in events(replayed) if event["kind"] == "initialised")
    assert started - EPOCH_NS < STAND_S * 1e9
    expected = [EPOCH_NS + k * 10_000_000 for k in range(round(SECONDS * 100)) if EPOCH_NS + k * 10_000_000 > started]
    assert stamps == expected
    for name in ("imu_in_odom", "base_in_world", "base_in_odom"):
        assert list(track(replayed, name)) == expected


def test_estimates_follow_the_known_motion(replayed):
    # GNSS of 2-3 cm, 5 times a second, and a lidar of 2 mm: a factor 3 above the noise of a fix is a blunder
    for name in ("imu_in_world", "optimized_in_world", "smoothed_in_world"):
        for at, T_W_I in track(replayed, name).items():
            error = pose((at - EPOCH_NS) * 1e-9).between(T_W_I)
            assert np.linalg.norm(error.translation()[:2]) < 0.09, (name, at)
            assert abs(error.translation()[2]) < 0.15, (name, at)


def test_odometry_frame_starts_at_the_world_and_never_jumps(replayed):
    stamps, T = zip(*track(replayed, "imu_in_odom").items(), strict=True)
    steps = [a.between(b) for a, b in itertools.pairwise(T)]
    true_steps = [
        pose((a - EPOCH_NS) * 1e-9).between(pose((b - EPOCH_NS) * 1e-9)) for a, b in itertools.pairwise(stamps)
    ]
    for step, true_step in zip(steps, true_steps, strict=True):
        # 10 ms at a wrong speed of 0.1 m/s and a gyro noise of 1e-3 rad/s, both with a margin of more than two
        assert np.linalg.norm(step.translation() - true_step.translation()) < 2.5e-3
        assert np.linalg.norm(true_step.rotation().logmap(step.rotation())) < 1e-4


def test_world_to_odometry_times_odometry_to_imu_is_world_to_imu(replayed, without_base, bag_drive, tmp_path):
    holdfast("replay", bag_drive, "-c", without_base, "-o", tmp_path)
    world, odom = track(tmp_path, "imu_in_world"), track(tmp_path, "imu_in_odom")
    corrections = []
    for _, message in messages(tmp_path, "/tf"):
        T_W_O, T_O_I = (t.transform for t in message.transforms)
        at = stamp_of(message.transforms[0].header)
        product = pose_of(T_W_O.translation, T_W_O.rotation) * odom[at]
        assert_poses_close(product, world[at], 50 * ROUNDING)  # 30 m from the origin, turned by 1e-9 rad
        assert_same_pose(array(T_O_I.translation), array(T_O_I.rotation), odom[at])
        corrections.append(np.linalg.norm(array(T_W_O.translation)))
    assert len(corrections) == len(world)
    assert max(corrections) > 1e-3  # corrections went into T_W_O, or the above tests nothing


def pose_of(point, quaternion):
    import gtsam

    return gtsam.Pose3(gtsam.Rot3.Quaternion(quaternion.w, quaternion.x, quaternion.y, quaternion.z), array(point))


@pytest.mark.parametrize(("topic", "name", "frame"), [
    ("/holdfast/odometry/world", "imu_in_world", "map"),
    ("/holdfast/odometry/odom", "imu_in_odom", "odom"),
])  # fmt: skip
def test_ros_odometry_is_the_tum_track_with_frames_named(replayed, topic, name, frame):
    expected, found = track(replayed, name), messages(replayed, topic)
    assert [stamp_of(message.header) for _, message in found] == list(expected)
    for logged, message in found:
        at = stamp_of(message.header)
        assert logged == at
        assert (message.header.frame_id, message.child_frame_id) == (frame, "imu")
        assert_same_pose(array(message.pose.pose.position), array(message.pose.pose.orientation), expected[at])


def test_transforms_lead_from_map_over_odom_to_the_base(replayed):
    odom, found = track(replayed, "base_in_odom"), messages(replayed, "/tf")
    assert [stamp_of(message.transforms[0].header) for _, message in found] == list(odom)
    for _, message in found:
        links = [(t.header.frame_id, t.child_frame_id, stamp_of(t.header)) for t in message.transforms]
        at = links[0][2]
        assert links == [("map", "odom", at), ("odom", "base_link", at)]
        body = message.transforms[1].transform
        assert_same_pose(array(body.translation), array(body.rotation), odom[at])


def test_base_is_the_imu_moved_by_the_extrinsics(replayed):
    for frame in ("world", "odom"):
        body, base = track(replayed, f"imu_in_{frame}"), track(replayed, f"base_in_{frame}")
        assert body.keys() == base.keys()
        for at in body:
            assert_poses_close(body[at] * T_I_B, base[at], 20 * ROUNDING)


def test_base_tracks_appear_only_when_the_extrinsics_reach_the_base(bag_drive, without_base, tmp_path):
    holdfast("replay", bag_drive, "-c", without_base, "-o", tmp_path, "--duration", 4)
    assert {file.name for file in tmp_path.iterdir()} == FILES
    _, message = messages(tmp_path, "/tf")[0]
    assert [t.child_frame_id for t in message.transforms] == ["odom", "imu"]


def test_covariances_are_symmetric_positive_and_the_same_in_both_frames(replayed):
    world, odom = messages(replayed, "/holdfast/odometry/world"), messages(replayed, "/holdfast/odometry/odom")
    for (_, in_world), (_, in_odom) in zip(world[::10], odom[::10], strict=True):
        for part in (in_world.pose, in_world.twist, in_odom.pose, in_odom.twist):
            P = covariance(part)
            np.testing.assert_allclose(P, P.T, rtol=0, atol=1e-9 * abs(P).max())
            assert np.linalg.eigvalsh(0.5 * (P + P.T))[0] > 0.0
        R_W_I = pose_of(in_world.pose.pose.position, in_world.pose.pose.orientation).rotation().matrix()
        R_O_I = pose_of(in_odom.pose.pose.position, in_odom.pose.pose.orientation).rotation().matrix()
        rotation = np.kron(np.eye(2), R_W_I @ R_O_I.T)
        P_W, P_O = covariance(in_world.pose), covariance(in_odom.pose)
        np.testing.assert_allclose(P_W, rotation @ P_O @ rotation.T, rtol=0, atol=1e-9 * abs(P_W).max())
        np.testing.assert_array_equal(covariance(in_world.twist), covariance(in_odom.twist))


def test_published_uncertainty_is_that_of_the_position(replayed):
    # a fix has a sigma of 2 to 5 cm; some seconds of fixes and scans are better than one, and no better than 2 mm
    for _, message in messages(replayed, "/holdfast/odometry/world")[500::100]:
        sigmas = np.sqrt(np.diag(covariance(message.pose)))
        assert (sigmas[:3] > 0.002).all()
        assert (sigmas[:3] < 0.05).all()
        assert sigmas[5] < np.radians(2.0)  # the heading that was given at the start


def test_twist_is_in_the_body(replayed):
    from small_drive import R_V_I, distance

    for _, message in messages(replayed, "/holdfast/odometry/world")[::50]:
        t = (stamp_of(message.header) - EPOCH_NS) * 1e-9
        speed = distance(t)[1]
        np.testing.assert_allclose(array(message.twist.twist.linear), R_V_I.unrotate([speed, 0, 0]), rtol=0, atol=0.15)
        np.testing.assert_allclose(
            array(message.twist.twist.angular), R_V_I.unrotate([0, 0, speed / 6.0]), rtol=0, atol=0.01
        )


def test_diagnostics_come_once_a_second_and_count(replayed):
    found = messages(replayed, "/diagnostics")
    assert abs(len(found) - SECONDS) <= 1
    status = found[-1][1].status[0]
    assert status.message == "nominal" and status.level == 0
    reported = {value.key: value.value for value in status.values}
    assert reported["fused"].split()[0] == "imu"
    final = {key: int(value) for key, value in reported.items() if key.startswith("imu ")}
    counts = summary(replayed)["counts"]
    assert 0.9 * counts["imu"]["used"] < final["imu used"] <= counts["imu"]["used"]
    assert found[-1][1].status[0].message == "nominal"
    assert found[-1][1].status[0].level in (0, b"\x00")


def test_optimised_and_smoothed_nodes_lie_on_the_timeline_of_the_measurements(replayed):
    for name in ("optimized_in_world", "smoothed_in_world"):
        stamps = np.array(list(track(replayed, name)))
        assert (np.diff(stamps) > 0).all()
        assert stamps[0] >= EPOCH_NS
        assert stamps[-1] <= stamp(SECONDS)
    # scans at 10 Hz and fixes at 5 Hz from the start on; the smoothed ones end a window (3 s) before
    assert len(track(replayed, "optimized_in_world")) > 10 * (SECONDS - STAND_S)
    assert len(track(replayed, "smoothed_in_world")) > 10 * (SECONDS - STAND_S - 3.0)


def test_summary_counts_every_message_of_the_recording(replayed):
    content = summary(replayed)
    counts = content["counts"]
    assert sum(counts["imu"].values()) == SECONDS * 100
    assert sum(counts["lidar"].values()) == SECONDS * 10
    assert sum(counts["gnss"].values()) == SECONDS * 5
    assert counts["gnss"]["used"] > 0.8 * SECONDS * 5
    assert content["finished"] is True
    assert content["initialised"] is True
    assert content["waiting_for"] is None
    assert content["warnings"] == []
    assert content["datum"]["latitude_deg"] == 47.4
    assert (
        content["config"]["sensors"]["gnss"]["gate_sigma"] == GnssConfig(kind="gnss", topic="gnss").gate_sigma
    )  # as resolved
    assert set(content["versions"]) >= {"holdfast", "gtsam", "numpy"}
    kinds = [event["kind"] for event in events(replayed)]
    assert content["events"] == {kind: kinds.count(kind) for kind in sorted(set(kinds))}


def test_summary_times_every_sample_and_update(replayed):
    timing = summary(replayed)["timing"]
    assert timing["recorded_s"] == pytest.approx(SECONDS, abs=0.1)
    assert timing["real_time_factor"] == pytest.approx(timing["recorded_s"] / timing["wall_s"])
    for name in ("imu_us", "update_ms"):
        at = timing[name]
        assert 0 < at["median"] <= at["p90"] <= at["p99"] <= at["max"]
    assert timing["update_ms"]["count"] >= len(track(replayed, "optimized_in_world"))


def test_events_name_stamp_kind_and_reason(replayed):
    found = events(replayed)
    assert [event["kind"] for event in found].count("initialised") == 1
    for event in found:
        assert set(event) == {"stamp_ns", "kind", "sensor", "reason", "data"}
        assert EPOCH_NS <= event["stamp_ns"] <= stamp(SECONDS)
        assert event["reason"]


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["csv_drive", "bag_drive"])
def test_replaying_twice_gives_the_same_bytes(drive, with_base, tmp_path, request):
    folders = [tmp_path / "once", tmp_path / "twice"]
    for folder in folders:
        done = holdfast("replay", request.getfixturevalue(drive), "-c", with_base, "-o", folder, "--duration", 12)
        assert done.code == 0
    once, twice = ({file.name: file.read_bytes() for file in folder.iterdir()} for folder in folders)
    summaries = [json.loads(content.pop("summary.json")) for content in (once, twice)]
    assert once.keys() == twice.keys()
    assert [name for name in once if once[name] != twice[name]] == []
    for content in summaries:
        assert content.pop("timing")
        assert content.pop("command").startswith("holdfast replay ")  # names the folder
    assert summaries[0] == summaries[1]


def test_csv_folder_and_bag_give_the_same_estimates(replayed, csv_drive, with_base, tmp_path):
    holdfast("replay", csv_drive, "-c", with_base, "-o", tmp_path)
    ours, theirs = track(tmp_path, "imu_in_world"), track(replayed, "imu_in_world")
    assert ours.keys() == theirs.keys()
    for at in ours:
        assert_poses_close(ours[at], theirs[at], 1e-8)


def test_results_of_an_earlier_replay_are_replaced(bag_drive, with_base, tmp_path):
    for seconds in (8, 5):
        assert holdfast("replay", bag_drive, "-c", with_base, "-o", tmp_path, "--duration", seconds).code == 0
    assert max(track(tmp_path, "imu_in_world")) < stamp(5.0)
    assert summary(tmp_path)["timing"]["recorded_s"] < 5.0


def test_start_and_duration_cut_the_stream_by_arrival(bag_drive, with_base, tmp_path):
    done = holdfast("replay", bag_drive, "-c", with_base, "-o", tmp_path, "--start", 0.5, "--duration", 6)
    assert done.code == 0
    # the first message arrives IMU_DELAY_NS after EPOCH_NS, and that is second 0
    assert sum(summary(tmp_path)["counts"]["imu"].values()) == 600
    assert sum(summary(tmp_path)["counts"]["gnss"].values()) == 30
    stamps = list(track(tmp_path, "imu_in_world"))
    assert stamp(0.5) < stamps[0]
    assert stamps[-1] == stamp(6.49)


def test_names_of_frames_come_from_the_configuration(bag_drive, tmp_path):
    config = write_config(tmp_path / "config.yaml", base=True)
    text = json.loads(config.read_text())
    text["frames"] |= {"world": "site", "odometry": "smooth", "base": "lidar"}
    config.write_text(json.dumps(text))
    assert holdfast("replay", bag_drive, "-c", config, "-o", tmp_path / "out", "--duration", 5).code == 0
    _, message = messages(tmp_path / "out", "/tf")[0]
    assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
        ("site", "smooth"),
        ("smooth", "lidar"),
    ]
