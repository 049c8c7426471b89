"""Names of topics that ROS has, and those that it has not."""

import pytest

from holdfast.errors import ConfigError
from holdfast.ros.names import check_topic


@pytest.mark.parametrize("topic", ["/imu", "imu", "/lidar/odometry", "/_left/imu_2", "/a/b/c"])
def test_a_topic_of_ros_is_taken(topic):
    check_topic("--output-topic", topic)


@pytest.mark.parametrize(
    "topic", ["", "/", "bad topic", "/imu/", "//imu", "/imu//data", "/2/imu", "~/imu", "/imü", "/a\n"]
)
def test_what_no_program_of_ros_could_name_is_refused(topic):
    with pytest.raises(ConfigError, match=r"^sensors\.imu\.topic: '.*' is no name of a topic \(allowed: "):
        check_topic("sensors.imu.topic", topic)
