"""A starter loads as it is, says what it guessed, and its commented defaults are the model's."""

import re
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.config.assignment import assign
from holdfast.config.load import parse_config
from holdfast.config.model import Config
from holdfast.config.starter import starter_yaml
from holdfast.errors import RecordingError

IMU, FIX, ODOMETRY = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "nav_msgs/msg/Odometry"
JOINT, QUATERNION = "sensor_msgs/msg/JointState", "geometry_msgs/msg/QuaternionStamped"
TYPES = {"imu": [IMU], "gnss": [FIX], "lidar": [ODOMETRY], "heading": [QUATERNION, IMU], "joint": [JOINT]}


@dataclass(frozen=True)
class Info:
    topic: str
    type: str
    count: int | None = 100


EVERYTHING = [
    Info("/imu/data", IMU),
    Info("/gnss_left/fix", FIX),
    Info("/gnss_right/fix", FIX),
    Info("/lidar/odom", ODOMETRY),
    Info("/gnss/heading", QUATERNION),
    Info("/joint_states", JOINT),
]


def chosen(*topics: Info) -> dict[str, str]:
    return {sensor: guess.topic for sensor, guess in assign(topics, TYPES).items() if guess.topic is not None}


def test_one_topic_of_each_kind_finds_its_sensor() -> None:
    assert chosen(*EVERYTHING) == {
        "imu": "/imu/data",
        "gnss": "/gnss_left/fix",
        "gnss_right": "/gnss_right/fix",
        "lidar": "/lidar/odom",
        "heading": "/gnss/heading",
        "joint": "/joint_states",
    }


def test_an_imu_of_the_chassis_is_not_the_main_one_unless_it_is_alone() -> None:
    base, cabin = Info("/base/imu", IMU, 900), Info("/imu", IMU, 100)
    assert chosen(base, cabin)["imu"] == "/imu"
    assert chosen(base)["imu"] == "/base/imu"
    assert "AGAINST" in assign([base], TYPES)["imu"].reason


def test_an_orientation_named_heading_is_the_heading_and_not_the_imu() -> None:
    assert chosen(Info("/gnss/heading", IMU, 900), Info("/imu", IMU)) == {"heading": "/gnss/heading", "imu": "/imu"}


@pytest.mark.parametrize("names", [("/gnss_l", "/gnss_r"), ("/main/fix", "/aux/fix"), ("/gnss_Left", "/gnss_Right")])
def test_two_antennas_are_left_and_right_by_name(names: tuple[str, str]) -> None:
    left, right = names
    assert chosen(Info(right, FIX, 900), Info(left, FIX)) == {"gnss": left, "gnss_right": right}


def test_two_fixes_without_sides_are_one_antenna_and_an_alternative() -> None:
    guesses = assign([Info("/gps/fix", FIX), Info("/gps/fix_filtered", FIX, 900)], TYPES)
    assert guesses["gnss"].topic == "/gps/fix"
    assert [other.topic for other in guesses["gnss"].others] == ["/gps/fix_filtered"]
    assert guesses["gnss_right"].topic is None


def test_a_single_letter_is_a_side_only_where_it_stands_alone() -> None:
    assert chosen(Info("/receiver/a", FIX), Info("/receiver/b", FIX, 900)) == {"gnss": "/receiver/b"}


def test_a_sensor_that_is_commented_out_has_a_frame_of_its_own() -> None:
    text = starter_yaml("x.bag", [Info("/imu", IMU)], TYPES)
    assert "  #  frame: gnss_right  #" in text


def test_lidar_odometry_is_preferred_by_name_and_other_odometry_is_never_taken() -> None:
    wheel, icp = Info("/wheel/odom", ODOMETRY, 900), Info("/icp_odometry", ODOMETRY)
    plain = Info("/state", ODOMETRY, 50)
    assert chosen(wheel, plain, icp) == {"lidar": "/icp_odometry"}
    assert chosen(wheel, plain) == {"lidar": "/state"}
    assert chosen(wheel) == {}


def test_a_topic_without_messages_is_not_taken_but_an_unknown_number_is() -> None:
    assert chosen(Info("/imu/data", IMU, 0), Info("/imu", IMU, 5)) == {"imu": "/imu"}
    assert chosen(Info("/imu/data", IMU, None)) == {"imu": "/imu/data"}
    assert chosen(Info("/imu/data", IMU, 0)) == {}


def test_a_starter_for_everything_loads_with_every_topic() -> None:
    sensors = parse_config(starter_yaml("x.bag", EVERYTHING, TYPES)).sensors
    topics = {name: section.topic for name, section in sensors if section is not None}
    assert topics == chosen(*EVERYTHING)


def test_deleting_the_comment_sign_of_every_default_changes_nothing() -> None:
    text = starter_yaml("x.bag", EVERYTHING, TYPES)
    uncommented = re.sub(r"^( *)#((?:  )*[a-z]\w*:)", r"\1\2", text, flags=re.MULTILINE)
    before, after = parse_config(text), parse_config(uncommented)
    assert uncommented.count("\n") == text.count("\n")
    assert after.frames.datum is not None  # an optional section appears with its placeholders
    assert after.model_copy(update={"frames": before.frames}) == before
    assert after.frames.model_copy(update={"datum": None}) == before.frames


def test_every_key_of_the_model_stands_in_a_starter() -> None:
    text = starter_yaml("x.bag", [Info("/imu", IMU)], TYPES)
    definitions = Config.model_json_schema()
    for definition in (definitions, *definitions["$defs"].values()):
        if definition["title"] != "Extrinsic":  # nothing but the IMU needs none
            for key in definition["properties"]:
                assert re.search(rf"^[ #]*{key}:", text, re.MULTILINE), key


def test_every_sensor_with_a_frame_has_its_placeholder_marked_todo() -> None:
    text = starter_yaml("x.bag", EVERYTHING, TYPES)
    assert [extrinsic.child for extrinsic in parse_config(text).extrinsics] == ["gnss", "gnss_right", "lidar"]
    assert text.count("translation_m: [0.0, 0.0, 0.0]  # TODO measure") == 3
    assert "PLACEHOLDERS" in text


def test_guesses_and_alternatives_are_said() -> None:
    text = starter_yaml("x.bag", [*EVERYTHING, Info("/imu2", IMU, 7), Info("/wheel/odom", ODOMETRY)], TYPES)
    assert f"# imu: /imu/data ({IMU}, 100 messages), for 'data' in its name" in text
    assert f"could also be /imu2 ({IMU}, 7 messages)" in text
    assert f"could also be /wheel/odom ({ODOMETRY}, 100 messages)" in text


def test_a_recording_without_an_imu_is_refused_in_one_line_that_lists_its_topics() -> None:
    with pytest.raises(
        RecordingError, match=r"^x.bag: no IMU in it.*it has /gnss \(sensor_msgs/msg/NavSatFix"
    ) as caught:
        starter_yaml("x.bag", [Info("/gnss", FIX)], TYPES)
    assert "\n" not in str(caught.value)


@settings(max_examples=60, deadline=None)
@given(
    st.text(max_size=10).map(lambda text: f"x{text}"),
    st.lists(
        st.builds(Info, st.text(min_size=1, max_size=10), st.sampled_from([FIX, ODOMETRY, JOINT, QUATERNION, "?"]))
    ),
)
def test_whatever_the_topics_are_called_the_starter_loads(imu: str, others: list[Info]) -> None:
    text = starter_yaml("x\n.bag", [Info(imu, IMU), *others], TYPES)
    assert parse_config(text).sensors.imu.topic == imu
