"""A starter loads as it is, gives its reasons, and its commented defaults are the model's."""

import re
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.config.assignment import Assignment, Rule, assign
from holdfast.config.kinds import KINDS as SECTIONS
from holdfast.config.load import parse_config
from holdfast.config.proposal import propose
from holdfast.config.sensors import GnssConfig, ImuConfig
from holdfast.config.starter import minimal_yaml, starter_yaml
from holdfast.errors import RecordingError
from holdfast.recording.decode import IMU, ODOMETRY, POINT, POSE, POSE_COVARIANCE, TWIST, TWIST_COVARIANCE
from holdfast.recording.kinds import KINDS
from holdfast.recording.kinds.gnss import FIX
from holdfast.recording.kinds.heading import QUATERNION
from holdfast.recording.kinds.joint import JOINT_STATE


@dataclass(frozen=True)
class Info:
    topic: str
    type: str
    count: int | None = 100


@dataclass(frozen=True)
class Sonar:
    name: str = "sonar"
    types: tuple[str, ...] = ("sonar/Range",)
    rules: tuple[Rule, ...] = (Rule("sonar", every=True),)


EVERYTHING = {
    "imu": Info("/imu/data", IMU),
    "gnss": Info("/gnss_left/fix", FIX),
    "gnss_right": Info("/gnss_right/fix", FIX),
    "gnss_velocity": Info("/gnss_right/velocity", TWIST_COVARIANCE),
    "heading": Info("/gnss/heading", QUATERNION),
    "lidar": Info("/lidar/odom", ODOMETRY),
    "camera": Info("/vio/odom", ODOMETRY),
    "wheels": Info("/wheel/odom", ODOMETRY),
    "twist": Info("/tracks/twist", TWIST),
    "pose": Info("/amcl_pose", POSE_COVARIANCE),
    "prism": Info("/total_station/point", POINT),
    "height": Info("/laser/height", POINT),
    "joint": Info("/joint_states", JOINT_STATE),
    "base_imu": Info("/base/imu", IMU),
}


def assigned(*topics: Info) -> Assignment:
    return assign(topics, KINDS.values())


def chosen(*topics: Info) -> dict[str, str]:
    return {guess.sensor: guess.topic.topic for guess in assigned(*topics).guesses}


def reason(sensor: str, *topics: Info) -> str:
    return next(guess.reason for guess in assigned(*topics).guesses if guess.sensor == sensor)


def starter(*topics: Info) -> str:
    return starter_yaml(propose("x.bag", topics, KINDS.values()))


def test_one_topic_of_each_kind_finds_its_sensor() -> None:
    assert chosen(*EVERYTHING.values()) == {name: info.topic for name, info in EVERYTHING.items()}


def test_the_order_of_the_topics_changes_nothing() -> None:
    assert starter(*reversed(EVERYTHING.values())) == starter(*EVERYTHING.values())


def test_an_imu_of_the_chassis_is_not_the_main_one_unless_it_is_alone() -> None:
    base, cabin = Info("/base/imu", IMU, 900), Info("/imu", IMU, 100)
    assert chosen(base, cabin) == {"imu": "/imu", "base_imu": "/base/imu"}
    assert chosen(base) == {"imu": "/base/imu"}
    assert "AGAINST" in reason("imu", base)


def test_a_third_imu_is_there_to_be_uncommented_beside_the_primary_one() -> None:
    text = starter(Info("/imu/data", IMU), Info("/ouster/imu", IMU))
    assert parse_config(text).sensors_of(ImuConfig).keys() == {"imu"}
    whole = re.sub(r"^  # (imu_2:\n|  (?:kind|topic): )", r"  \1", text, flags=re.MULTILINE)
    config = parse_config(whole)
    assert (config.imu_name, config.sensors["imu_2"].topic) == ("imu", "/ouster/imu")


def test_an_orientation_named_heading_is_the_heading_and_not_the_imu() -> None:
    assert chosen(Info("/gnss/heading", IMU, 900), Info("/imu", IMU)) == {"heading": "/gnss/heading", "imu": "/imu"}


@pytest.mark.parametrize("names", [("/gnss_l", "/gnss_r"), ("/main/fix", "/aux/fix"), ("/gnss_Left", "/gnss_Right")])
def test_two_antennas_are_left_and_right_by_name(names: tuple[str, str]) -> None:
    left, right = names
    assert chosen(Info(right, FIX, 900), Info(left, FIX)) == {"gnss": left, "gnss_right": right}


def test_every_antenna_is_proposed_whatever_its_name() -> None:
    names = ("/receiver/a", "/receiver/b", "/receiver/c")
    found = chosen(*(Info(name, FIX, 100 - k) for k, name in enumerate(names)))
    assert found == {"gnss": "/receiver/a", "gnss_2": "/receiver/b", "gnss_3": "/receiver/c"}


def test_the_only_antenna_is_the_first_even_if_it_is_called_rover() -> None:
    assert chosen(Info("/rover/fix", FIX)) == {"gnss": "/rover/fix"}


def test_a_fix_that_another_estimator_made_is_left_over() -> None:
    found = assigned(Info("/gps/fix", FIX), Info("/gps/fix_filtered", FIX, 900))
    assert [guess.topic.topic for guess in found.guesses] == ["/gps/fix"]
    assert [(topic.topic, kinds) for topic, kinds in found.unused] == [("/gps/fix_filtered", ("gnss",))]


def test_odometries_are_named_by_what_makes_them_and_commands_are_none() -> None:
    topics = ("/icp_odometry", "/stereo/odom", "/wheel_odom", "/state", "/goal", "/ekf/odom", "/odometry/gps")
    assert chosen(*(Info(topic, ODOMETRY) for topic in topics)) == {
        "lidar": "/icp_odometry",
        "lidar_2": "/state",
        "camera": "/stereo/odom",
        "wheels": "/wheel_odom",
    }


def test_an_odometry_is_proposed_once_although_its_twist_could_serve() -> None:
    assert chosen(Info("/wheel/odom", ODOMETRY)) == {"wheels": "/wheel/odom"}


def test_a_command_is_no_twist() -> None:
    assert chosen(Info("/cmd_vel", TWIST), Info("/speed", TWIST)) == {"twist": "/speed"}


@pytest.mark.parametrize(
    ("fix", "velocity", "type_name"),
    [
        ("/gnss/fix", "/gnss/velocity", TWIST_COVARIANCE),
        ("/fix", "/fix_velocity", TWIST_COVARIANCE),
        ("/ublox_gps/fix", "/ublox_gps/fix_velocity", TWIST_COVARIANCE),
        ("/ublox_gps_node/fix", "/ublox_gps_node/fix_velocity", TWIST_COVARIANCE),
        ("/navsatfix", "/twist_gnss", TWIST_COVARIANCE),
        ("/septentrio/navsatfix", "/septentrio/twist_gnss", TWIST_COVARIANCE),
        ("/fix", "/vel", TWIST),
        ("/mast/fix", "/mast/vel", TWIST),
        ("/gps/fix", "/gps/vel", TWIST),
        ("/navsat/fix", "/navsat/vel", TWIST),
    ],
)
def test_the_velocity_of_a_receiver_is_that_of_its_antenna(fix: str, velocity: str, type_name: str) -> None:
    topics = Info("/imu", IMU), Info(fix, FIX), Info(velocity, type_name), Info("/wheel/twist", TWIST)
    assert chosen(*topics) == {"imu": "/imu", "gnss": fix, "gnss_velocity": velocity, "twist": "/wheel/twist"}
    config = parse_config(starter(*topics))
    assert config.frame_of("gnss_velocity") == "gnss"
    assert config.sensors["gnss_velocity"].axes == (("x", "y") if type_name == TWIST else ("x", "y", "z"))


def test_of_two_antennas_that_of_the_same_namespace_is_meant_and_else_the_user_must_say() -> None:
    both = Info("/imu", IMU), Info("/main/fix", FIX), Info("/aux/fix", FIX)
    for topic, frame in (("/aux/vel", "gnss_right"), ("/gps/vel", "gnss_velocity")):
        config = parse_config(starter(*both, Info(topic, TWIST)))
        assert config.frame_of("gnss_velocity") == frame
        assert (frame in [extrinsic.child for extrinsic in config.extrinsics]) and config.reaches(frame)


def test_what_wheels_commands_and_inertial_systems_say_is_no_velocity_of_gnss() -> None:
    for topic in ("/speed", "/wheel/vel", "/base/vel", "/twist"):
        assert "gnss_velocity" not in chosen(Info("/fix", FIX), Info(topic, TWIST))
    for topic in ("/cmd_vel", "/gps/cmd_vel", "/septentrio/twist_ins"):
        assert chosen(Info("/fix", FIX), Info(topic, TWIST_COVARIANCE)) == {"gnss": "/fix"}


def test_the_reason_for_a_velocity_without_a_telling_name_is_the_fix_beside_it() -> None:
    assert reason("gnss_velocity", Info("/fix", FIX), Info("/vel", TWIST)).endswith(f"for a {FIX} beside it")


def test_a_pose_is_an_odometry_unless_its_name_says_that_it_is_absolute() -> None:
    assert chosen(Info("/lidar/pose", POSE), Info("/marker_pose", POSE)) == {
        "lidar": "/lidar/pose",
        "pose": "/marker_pose",
    }


def test_a_topic_without_messages_is_not_taken_but_an_unknown_number_is() -> None:
    assert chosen(Info("/imu/data", IMU, 0), Info("/imu", IMU, 5)) == {"imu": "/imu"}
    assert chosen(Info("/imu/data", IMU, None)) == {"imu": "/imu/data"}
    assert chosen(Info("/imu/data", IMU, 0)) == {}


def test_a_kind_that_is_passed_in_is_found_like_the_others() -> None:
    found = assign([Info("/a", "sonar/Range"), Info("/b", "sonar/Range")], [*KINDS.values(), Sonar()])
    assert [(guess.sensor, guess.kind) for guess in found.guesses] == [("sonar", "sonar"), ("sonar_2", "sonar")]


def test_a_starter_for_everything_loads_with_every_topic() -> None:
    sensors = parse_config(starter(*EVERYTHING.values())).sensors
    expected = chosen(*EVERYTHING.values())
    prism = expected.pop("prism")  # a grid beside GNSS needs a datum, which only the user knows
    assert {name: section.topic for name, section in sensors.items()} == expected
    assert f"  # prism: {prism}" in starter(*EVERYTHING.values())
    assert sensors["pose"].offset_sigma_m > 0.0


def test_sensors_of_the_chassis_hang_below_the_turn_joint_where_there_is_one() -> None:
    config = parse_config(starter(*EVERYTHING.values()))
    assert config.turn_joint is not None
    assert [name for name in config.sensors if config.is_beyond_joint(config.frame_of(name))] == ["twist", "base_imu"]
    rigid = parse_config(starter(EVERYTHING["imu"], EVERYTHING["twist"]))
    assert rigid.turn_joint is None
    assert rigid.reaches("twist")


def test_deleting_the_comment_sign_of_every_default_changes_nothing() -> None:
    text = starter(*EVERYTHING.values())
    uncommented = re.sub(r"^( *)#((?:  )*[a-z]\w*:)", r"\1\2", text, flags=re.MULTILINE)
    before, after = parse_config(text), parse_config(uncommented)
    assert uncommented.count("\n") == text.count("\n")
    assert after.frames.datum is not None  # an optional section appears with its placeholders
    assert after.model_copy(update={"frames": before.frames}) == before
    assert after.frames.model_copy(update={"datum": None}) == before.frames


def test_every_key_of_a_sensor_that_was_found_stands_in_a_starter() -> None:
    text = starter(*EVERYTHING.values())
    for name, section in parse_config(text).sensors.items():
        block = re.search(rf"^  {name}:.*\n((?:    .*\n)+)", text, re.MULTILINE)
        assert block is not None
        for key in type(section).model_fields:
            assert re.search(rf"^    #?{key}:", block[1], re.MULTILINE), f"{name}.{key}"


def test_a_kind_that_was_not_found_takes_one_line() -> None:
    text = starter(EVERYTHING["imu"])
    assert [line for line in text.splitlines() if "none found" in line or "has no topic" in line] == [
        f"  # {kind}: " + ("has no topic, see docs/configuration.md" if kind == "nonholonomic" else "none found")
        for kind in SECTIONS
        if kind != "imu"
    ]


def test_every_sensor_with_a_frame_has_its_placeholder_marked_todo() -> None:
    text = starter(*EVERYTHING.values())
    children = [extrinsic.child for extrinsic in parse_config(text).extrinsics]
    without = ("imu", "heading", "joint", "gnss_velocity")  # a velocity is that of an antenna
    assert children == ["cabin", *(name for name in EVERYTHING if name not in without)]
    assert text.count("translation_m: [0.0, 0.0, 0.0]  # TODO measure") == len(children) + 1  # and the turn joint's
    assert "PLACEHOLDERS" in text


def test_reasons_and_what_is_left_over_stand_in_comments() -> None:
    text = starter(EVERYTHING["imu"], Info("/imu/mag", IMU, 7), Info("/goal", POSE))
    assert f"# imu: /imu/data ({IMU}, 100 messages), for 'data' in its name" in text
    assert f"# not used: /imu/mag ({IMU}, 7 messages); could be imu, heading, base_imu" in text
    assert f"# not used: /goal ({POSE}, 100 messages); could be odometry, pose, height" in text


def test_a_recording_without_an_imu_is_refused_in_one_line_that_lists_its_topics() -> None:
    with pytest.raises(
        RecordingError, match=r"^x.bag: no IMU in it.*it has /gnss \(sensor_msgs/msg/NavSatFix"
    ) as caught:
        starter(Info("/gnss", FIX))
    assert "\n" not in str(caught.value)


@settings(max_examples=60, deadline=None)
@given(
    st.text(max_size=10).map(lambda text: f"x{text}"),
    st.lists(
        st.builds(
            Info,
            st.text(min_size=1, max_size=10) | st.sampled_from([info.topic for info in EVERYTHING.values()]),
            st.sampled_from([*{info.type for info in EVERYTHING.values()} - {IMU}, "?"]),
        )
    ),
)
def test_whatever_the_topics_are_called_the_starter_loads(imu: str, others: list[Info]) -> None:
    text = starter_yaml(propose("x\n.bag", [Info(imu, IMU), *others], KINDS.values()))
    config = parse_config(text)
    assert parse_config(minimal_yaml(propose("x\n.bag", [Info(imu, IMU), *others], KINDS.values()))) == config
    assert config.imu.topic == imu
    assert all(section.default_sigma_m is None for section in config.sensors_of(GnssConfig).values())
