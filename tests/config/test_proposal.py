"""Mounts that a recording holds end up in the configuration; what it does not hold, or contradicts, is told."""

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st
from test_starter import EVERYTHING, Info

from holdfast.config.load import parse_config
from holdfast.config.model import Config
from holdfast.config.proposal import Proposal, only_what_is_known, propose
from holdfast.config.recorded_frames import RecordedFrames, RecordedLink, faultless, is_fixed_to_earth
from holdfast.config.starter import minimal_yaml, starter_yaml, workable
from holdfast.messages import Array
from holdfast.recording.decode import IMU, ODOMETRY, TWIST
from holdfast.recording.kinds import KINDS
from holdfast.recording.kinds.gnss import FIX
from holdfast.recording.kinds.joint import JOINT_STATE

TOPICS = {
    "imu": Info("/imu", IMU),
    "gnss": Info("/left/fix", FIX),
    "gnss_right": Info("/right/fix", FIX),
    "lidar": Info("/lidar/odom", ODOMETRY),
    "wheels": Info("/tracks/twist", TWIST),
    "joint": Info("/joint_states", JOINT_STATE),
    "base_imu": Info("/base/imu", IMU),
}
NAMED = {"/imu": "imu_link", "/left/fix": "ant_l", "/right/fix": "ant_r", "/lidar/odom": "os", "/base/imu": "imu_b"}


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw_deg: float = 0.0) -> Array:
    T, yaw = np.eye(4), np.radians(yaw_deg)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T


CABIN = (
    RecordedLink("cab", "imu_link", pose(0.5, 0.0, 1.0, 90.0), "/tf_static"),
    RecordedLink("cab", "ant_l", pose(-1.0, 1.0, 2.0), "/tf_static"),
    RecordedLink("cab", "ant_r", pose(-1.0, -1.0, 2.0), "/tf_static"),
    RecordedLink("cab", "mast", pose(1.0, 0.0, 2.0), "/tf_static"),
    RecordedLink("mast", "os", pose(0.0, 0.0, 0.5, 180.0), "/tf_static"),
)
CHASSIS = (RecordedLink("base_link", "imu_b", pose(0.2), "/tf_static"),)
TURNING = (RecordedLink("base_link", "cab", pose(0.1, 0.0, 1.2), "from /tf, turned back by the angle of swing"),)


def proposed(*sensors: str, named: dict[str, str] | None = None, **frames: object) -> Proposal:
    known = RecordedFrames(of_topic=NAMED if named is None else named, **frames)  # type: ignore[arg-type]
    return propose("x.bag", [TOPICS[sensor] for sensor in sensors or TOPICS], KINDS.values(), None, known)


def config_of(proposal: Proposal) -> Config:
    """Both forms of the file say the same."""
    config = parse_config(starter_yaml(proposal))
    assert parse_config(minimal_yaml(proposal)) == config
    return config


def test_a_bag_that_holds_its_mounts_gives_a_finished_file() -> None:
    proposal = proposed(links=(*CABIN, *CHASSIS), turning=TURNING, joints={"/joint_states": ("swing",)})
    machine = only_what_is_known(proposal)
    assert [sensor.name for sensor in machine.sensors if sensor.why_not] == [
        "twist"
    ]  # nobody says where the tracks are
    text = starter_yaml(machine)
    assert "TODO" not in text.replace(HEAD_LINE, "")
    config = config_of(machine)
    np.testing.assert_allclose(config.T("cab", "ant_l")[:3, 3], [-1.0, 1.0, 2.0], atol=1e-8)
    np.testing.assert_allclose(config.T("cab", "os"), pose(1.0, 0.0, 2.5, 180.0), atol=1e-8)
    np.testing.assert_allclose(config.T_I("ant_r")[:3, 3], [-1.0, 1.5, 1.0], atol=1e-8)
    assert config.turn_joint is not None
    assert (config.turn_joint.parent, config.turn_joint.child) == ("base_link", "cab")
    assert config.turn_joint.translation_m == (0.1, 0.0, 1.2)
    assert config.joint is not None
    assert config.joint[1].joint_name == "swing"
    assert config.is_beyond_joint("imu_b")


HEAD_LINE = "# marked TODO, and run `holdfast config check` on this file."


def test_each_mount_says_where_it_is_from() -> None:
    text = starter_yaml(proposed("imu", "lidar", links=CABIN))
    (line,) = [line for line in text.splitlines() if line.endswith(" - os")]
    assert line.strip().startswith("translation_m: [")
    assert line.endswith("# from /tf_static: imu_link - cab - mast - os")
    assert (
        "    frame: os  # text: its frame in `extrinsics`; by default named as the sensor; as its messages say" in text
    )
    assert "roll, pitch, yaw = 0, 0, 90 deg" in text


def test_without_transforms_the_placeholders_stay() -> None:
    for frames in (RecordedFrames(), RecordedFrames(of_topic=NAMED)):
        text = starter_yaml(propose("x.bag", EVERYTHING.values(), KINDS.values(), None, frames))
        assert text == starter_yaml(propose("x.bag", EVERYTHING.values(), KINDS.values()))
        assert "PLACEHOLDERS" in text


def test_a_tree_in_two_parts_is_told_in_one_line_and_its_sensors_stay_to_be_measured() -> None:
    lonely = RecordedLink("pole", "ant_l", pose(0.0, 0.0, 0.1), "/tf_static")
    proposal = proposed("imu", "gnss", "lidar", links=(*CABIN[:1], *CABIN[3:], lonely))
    assert proposal.warnings == ("no rigid transform of the recording leads from 'imu_link' to 'ant_l'",)
    text = starter_yaml(proposal)
    assert f"  # WARNING: {proposal.warnings[0]}" in text
    assert text.count("# TODO measure: x forward") == 1
    assert config_of(proposal).T_I("ant_l").tolist() == np.eye(4).tolist()


def test_a_frame_that_no_transform_joins_is_told() -> None:
    proposal = proposed("imu", "gnss", links=CABIN[:1])
    assert proposal.warnings == ("gnss: its messages name the frame 'ant_l', which no transform joins",)
    assert config_of(proposal).frame_of("gnss") == "gnss"


def test_two_antennas_that_name_one_frame_are_not_put_into_one_place() -> None:
    named = {**NAMED, "/right/fix": "ant_l"}
    proposal = proposed("imu", "gnss", "gnss_right", links=CABIN, named=named)
    assert len(proposal.warnings) == 1
    config = config_of(proposal)
    assert (config.frame_of("gnss"), config.frame_of("gnss_right")) == ("ant_l", "gnss_right")


def test_joints_of_wheels_are_no_turn_joint() -> None:
    car = (
        RecordedLink("base_link", "imu_link", pose(0.3), "/tf_static"),
        RecordedLink("base_link", "ant_l", pose(), "s"),
    )
    proposal = proposed("imu", "gnss", "joint", links=car, joints={"/joint_states": ("wheel_l", "wheel_r")})
    config = config_of(proposal)
    assert (config.joint, config.turn_joint) == (None, None)
    assert config.has_base()
    assert "nothing turns between them" in starter_yaml(proposal)


@pytest.mark.parametrize(
    ("names", "chosen"), [(("a",), "a"), (("boom", "swing_joint", "arm"), "swing_joint"), (("boom", "arm"), None)]
)
def test_the_turn_joint_is_found_by_its_name(names: tuple[str, ...], chosen: str | None) -> None:
    proposal = proposed("imu", "joint", joints={"/joint_states": names})
    joint = config_of(proposal).joint
    assert joint is not None
    assert joint[1].joint_name == chosen
    assert ("TODO choose: boom, arm" in starter_yaml(proposal)) == (chosen is None)


def test_a_chassis_of_another_name_is_the_base() -> None:
    car = (RecordedLink("chassis", "imu_link", pose(0.3), "/tf_static"),)
    config = config_of(proposed("imu", links=car))
    assert config.frames.base == "chassis"
    assert config.has_base()


def test_a_sensor_in_another_tree_than_the_imu_does_not_spoil_the_file() -> None:
    """Below a base that nothing joins to the IMU, not even a turn joint."""
    apart = RecordedLink("base_link", "os", pose(1.0), "/tf_static")
    config = config_of(proposed("imu", "lidar", links=(*CABIN[:1], apart)))
    assert config.reaches("os")


@pytest.mark.parametrize("joint", [(), ("joint",)])
def test_an_imu_that_is_the_root_of_the_tree_keeps_its_mounts(joint: tuple[str, ...]) -> None:
    below = (RecordedLink("imu_link", "ant_l", pose(1.0), "/tf_static"),)
    known = only_what_is_known(proposed("imu", "gnss", *joint, links=below))
    assert config_of(known).T_I("ant_l")[:3, 3].tolist() == [1.0, 0.0, 0.0]


FRAMES = st.sampled_from([*NAMED.values(), "base_link", "cab", "imu", "gnss", "odd name, [x]: #"])
LINKS = st.lists(
    st.builds(
        RecordedLink, FRAMES, FRAMES, st.builds(pose, st.floats(-5, 5), yaw_deg=st.floats(-180, 180)), st.just("/tf")
    )
)


@given(LINKS, LINKS, st.dictionaries(st.sampled_from([one.topic for one in TOPICS.values()]), FRAMES), st.data())
def test_whatever_the_tree_is_like_the_file_loads(
    links: list[RecordedLink], turning: list[RecordedLink], named: dict[str, str], data: st.DataObject
) -> None:
    sensors = data.draw(st.sets(st.sampled_from(sorted(TOPICS)[:-1])))
    good, warnings = faultless([link for link in links if link.parent != link.child])
    frames = {"links": tuple(good), "turning": tuple(turning), "warnings": tuple(warnings), "named": named}
    names = "imu", *sorted(sensors - {"imu"})
    proposal = workable(proposed(*names, **frames), proposed(*names, named={}))  # type: ignore[arg-type]
    config_of(proposal)
    event(f"{len([one for one in proposal.warnings if 'make no machine' in one])} of frames that make no machine")
    known = config_of(only_what_is_known(proposal))
    assert known.imu.topic == "/imu"


def test_without_mounts_a_replay_can_use_the_imu_and_one_antenna() -> None:
    known = only_what_is_known(proposed())
    assert [sensor.name for sensor in known.used] == ["imu", "gnss"]
    config = config_of(known)
    assert list(config.sensors) == ["imu", "gnss"]
    assert config.turn_joint is None
    assert starter_yaml(known).count("the recording does not say how it is mounted") == len(TOPICS) - 2


def test_where_nothing_but_an_unmounted_odometry_is_left_it_is_used() -> None:
    assert list(config_of(only_what_is_known(proposed("imu", "lidar"))).sensors) == ["imu", "lidar"]


# --- transforms that contradict each other ---------------------------------------------------------------------------


def test_a_frame_with_two_parents_is_below_none_of_them() -> None:
    links, warnings = faultless([*CABIN, RecordedLink("base_link", "ant_l", pose(), "/tf")])
    assert [link.child for link in links] == ["imu_link", "ant_r", "mast", "os"]
    assert warnings == [
        "/tf_static and /tf: frame 'ant_l' has the parents 'cab' and 'base_link': it is used below none of them"
    ]


def test_a_frame_that_is_given_twice_is_used_where_both_agree() -> None:
    again = RecordedLink("cab", "ant_l", pose(-1.0, 1.0004, 2.0), "/tf_static")
    assert faultless([*CABIN, again]) == (list(CABIN), [])
    elsewhere = RecordedLink("cab", "ant_l", pose(-1.0, 1.2, 2.0, 3.0), "/tf_static")
    links, warnings = faultless([*CABIN, elsewhere])
    assert "ant_l" not in [link.child for link in links]
    assert warnings == ["/tf_static: 'ant_l' in 'cab' is given twice, 0.200 m and 3.0 deg apart: it is not used"]


def test_transforms_in_a_circle_are_not_used() -> None:
    circle = [RecordedLink(a, b, pose(1.0), "/tf_static") for a, b in (("a", "b"), ("b", "c"), ("c", "a"))]
    links, warnings = faultless([*CABIN, *circle])
    assert links == list(CABIN)
    assert warnings == ["the transforms of a, b, c go round in a circle: they are not used"]


def test_frames_in_which_machines_move_hold_no_mounts() -> None:
    assert all(map(is_fixed_to_earth, ("map", "odom", "odom_combined", "robot/odom", "utm", "lidar_init")))
    assert not any(map(is_fixed_to_earth, ("base_link", "mapper_lidar", "odometer", "imu_link")))
