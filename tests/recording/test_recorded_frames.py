"""Frames of a bag: transforms that stay, those that follow a joint, frames of messages, names of joints."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import HUMBLE, NOETIC, START_NS, drive, header, imu, joints, store_of, write_bag
from rosbags.typesys import get_types_from_msg

from holdfast.config.load import load_config
from holdfast.config.proposal import only_what_is_known
from holdfast.config.recorded_frames import RecordedFrames
from holdfast.recording.first_config import first_proposal
from holdfast.recording.recorded_frames import read_frames
from holdfast.recording.source import open_recording
from holdfast.sim.scenario import load_scenario

TFM = "tf2_msgs/msg/TFMessage"
PERIOD_NS = 50_000_000
NOETIC.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TFM))


def transform(  # noqa: PLR0917
    store: Any, stamp_ns: int, parent: str, child: str, xyz: Any = (0, 0, 0), yaw: float = 0.0
) -> Any:
    q = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
    moved = store.types["geometry_msgs/msg/Transform"](
        store.types["geometry_msgs/msg/Vector3"](*map(float, xyz)), store.types["geometry_msgs/msg/Quaternion"](*q)
    )
    return store.types["geometry_msgs/msg/TransformStamped"](header(store, stamp_ns, parent), child, moved)


def told(store: Any, topic: str, stamp_ns: int, *transforms: Any) -> Any:
    return topic, stamp_ns, store.types[TFM](list(transforms))


def frames_of(path: Path, rows: Iterator[Any] | list[Any], kind: str = "mcap") -> RecordedFrames:
    with open_recording(write_bag(path, kind, sorted(rows, key=lambda row: row[1]))) as recording:
        return read_frames(recording, 120.0)


def swinging(store: Any = HUMBLE, xyz: Any = (0.1, 0.0, 1.2)) -> Iterator[Any]:
    """A cabin that swings by 0.5 rad, its angle, and a lidar whose frame is told on /tf again and again."""
    for k in range(40):
        stamp = START_NS + k * PERIOD_NS
        angle = 0.5 * np.sin(k / 10)
        yield "/joint_states", stamp, joints(store, stamp, ("swing", "boom"), (angle, 0.1 * k))
        moving = transform(store, stamp, "base_link", "cab", xyz, angle + 0.3)
        drifting = transform(store, stamp, "odom", "base_link", (k, 0, 0))
        yield told(store, "/tf", stamp + 1, moving, drifting, transform(store, stamp, "cab", "os", (1, 0, 2)))


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_static_transforms_are_read_of_every_kind_of_bag(tmp_path: Path, kind: str) -> None:
    store = store_of(kind)
    leading = "/" * (store is NOETIC)
    rows = [
        *drive(store),
        told(store, "/tf_static", START_NS, transform(store, START_NS, f"{leading}cab", "f", (1, 2, 3))),
    ]
    frames = frames_of(tmp_path / "b", rows, kind)
    assert [link[:2] for link in frames.links] == [("cab", "f")]
    assert frames.links[0].T[:3, 3].tolist() == [1.0, 2.0, 3.0]
    assert frames.of_topic == {"/imu": "f", "/gnss/fix": "f", "/lidar/odometry": "child"}


def test_what_stays_on_tf_is_rigid_and_what_follows_a_joint_is_known_at_its_zero(tmp_path: Path) -> None:
    frames = frames_of(tmp_path / "b", swinging())
    assert [(link.parent, link.child, link.source) for link in frames.links] == [("cab", "os", "/tf (constant there)")]
    (link,) = frames.turning
    assert (link.parent, link.child) == ("base_link", "cab")
    assert link.source == "from /tf, turned back by the angle of swing"
    np.testing.assert_allclose(link.T[:3, 3], [0.1, 0.0, 1.2])
    assert np.arctan2(link.T[1, 0], link.T[0, 0]) == pytest.approx(0.3, abs=1e-3)
    assert frames.joints == {"/joint_states": ("swing", "boom")}


def test_a_transform_on_tf_beside_a_joint_that_stands_still_is_not_taken_for_rigid(tmp_path: Path) -> None:
    """A cabin that did not swing while the bag ran would otherwise be bolted to its chassis."""
    rows = []
    for k in range(20):
        stamp = START_NS + k * PERIOD_NS
        rows += [
            ("/joint_states", stamp, joints(HUMBLE, stamp, ("swing",), (0.2,))),
            told(HUMBLE, "/tf", stamp + 1, transform(HUMBLE, stamp, "base_link", "cab", (0, 0, 1), 0.2)),
        ]
    frames = frames_of(tmp_path / "b", rows)
    assert frames.links == ()
    assert [link.child for link in frames.turning] == ["cab"]


def test_one_message_on_tf_does_not_make_a_mount(tmp_path: Path) -> None:
    rows = [*drive(HUMBLE), told(HUMBLE, "/tf", START_NS, transform(HUMBLE, START_NS, "cab", "f"))]
    assert frames_of(tmp_path / "b", rows).links == ()


def test_a_rotation_that_is_none_is_told_and_not_used(tmp_path: Path) -> None:
    broken = transform(HUMBLE, START_NS, "cab", "f")
    broken.transform.rotation.w = 0.0
    frames = frames_of(tmp_path / "b", [*drive(HUMBLE), told(HUMBLE, "/tf_static", START_NS, broken)])
    assert frames.links == ()
    assert len(frames.warnings) == 1
    assert frames.warnings[0].startswith("/tf_static: 'f' in 'cab' is not used: quaternion has norm 0")


def test_static_transforms_that_come_late_are_found(tmp_path: Path) -> None:
    late = START_NS + 200 * 1_000_000_000
    rows = [*drive(HUMBLE), told(HUMBLE, "/tf_static", late, transform(HUMBLE, late, "cab", "f", (1, 2, 3)))]
    assert len(frames_of(tmp_path / "b", rows).links) == 1


def test_a_folder_of_csv_files_tells_nothing_of_frames(tmp_path: Path) -> None:
    columns = "stamp_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    (tmp_path / "imu.csv").write_text(f"{columns}\n1,0,0,0,0,0,9.8\n")
    with open_recording(tmp_path) as recording:
        assert read_frames(recording, 120.0) == RecordedFrames()


def test_the_frame_of_a_topic_is_not_one_in_which_the_machine_moves(tmp_path: Path) -> None:
    assert frames_of(tmp_path / "b", [("/imu", START_NS, imu(HUMBLE, START_NS, frame_id="odom"))]).of_topic == {}


def test_the_mounts_of_a_simulated_excavator_are_those_of_its_maker(tmp_path: Path) -> None:
    """The bag of `holdfast simulate` holds what a real one does; the maker's configuration is the judge."""
    from holdfast.config.load import parse_config, resolved_yaml
    from holdfast.config.starter import starter_yaml
    from holdfast.sim.configuration import configuration
    from holdfast.sim.recorder import write_recording
    from holdfast.sim.simulation import simulate

    scenario = load_scenario("quick", {})
    write_recording(simulate(scenario, 3), tmp_path / "recording.mcap", False, None)
    (tmp_path / "config.yaml").write_text(resolved_yaml(configuration(scenario, 3)))
    made = load_config(tmp_path / "config.yaml")
    with open_recording(tmp_path / "recording.mcap") as recording:
        proposal = first_proposal(recording)
    assert only_what_is_known(proposal) == proposal  # nothing is left to measure
    guessed = parse_config(starter_yaml(proposal))
    assert set(guessed.sensors) == set(made.sensors)
    for name in ("gnss", "gnss_right", "lidar"):
        expected, found = made.T_I(made.frame_of(name)), guessed.T_I(guessed.frame_of(name))
        np.testing.assert_allclose(found[:3, 3], expected[:3, 3], atol=1e-8)
    np.testing.assert_allclose(guessed.T_I("lidar"), made.T_I("lidar"), atol=1e-7)
    np.testing.assert_allclose(guessed.T_I("cabin"), made.T_I("cabin"), atol=1e-7)
    np.testing.assert_allclose(guessed.T("base_link", "base_imu"), made.T("base_link", "base_imu"), atol=1e-7)
    assert guessed.turn_joint is not None
    assert made.turn_joint is not None
    np.testing.assert_allclose(guessed.turn_joint.matrix(), made.turn_joint.matrix(), atol=2e-3)
