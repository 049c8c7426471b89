"""Samples become measurements of the sensors that name their topic; nothing that arrives is fatal."""

import numpy as np
import pytest

from holdfast.errors import ConfigError
from holdfast.live.dds import Publication, Sample
from holdfast.live.idl import STORE
from holdfast.live.inputs import Inputs
from holdfast.recording.decode import IMU, ODOMETRY, POINT, POSE, POSE_COVARIANCE, TWIST, TWIST_COVARIANCE
from holdfast.recording.source import Subscription

BOTH = [Subscription("/odom", "wheels", "odometry"), Subscription("/odom", "speed", "twist")]


class FakeNetwork:
    def __init__(self):
        self.subscribed = []

    def subscribe(self, topic, type_name, *, reliable):
        self.subscribed.append((topic, type_name, reliable))


def odometry(norm=1.0):
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 0), "odom")
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, norm)
    )
    vectors = (types["geometry_msgs/msg/Vector3"](x, 0.0, 0.0) for x in (4.0, 0.0))
    message = types[ODOMETRY](
        header,
        "base_link",
        types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        types["geometry_msgs/msg/TwistWithCovariance"](types["geometry_msgs/msg/Twist"](*vectors), np.zeros(36)),
    )
    return Sample("/odom", ODOMETRY, bytes(STORE.serialize_cdr(message, ODOMETRY)))


def test_a_topic_of_one_type_is_subscribed_at_once_and_one_of_several_when_it_is_published():
    network = FakeNetwork()
    inputs = Inputs(network, [Subscription("/imu", "imu", "imu"), Subscription("/pose", "marker", "pose")])
    assert network.subscribed == [("/imu", IMU, False)]
    inputs.join([Publication("/pose", POINT, True), Publication("/pose", POSE_COVARIANCE, True)])
    assert network.subscribed[1:] == [("/pose", POSE_COVARIANCE, False)]
    assert inputs.topics == {"/imu": (IMU,), "/pose": (POSE, ODOMETRY, POSE_COVARIANCE)}


@pytest.mark.parametrize("topic", ["/imu data", "/~/imu", "/2/imu"])
def test_a_topic_that_ros_has_not_is_refused(topic):
    """Nothing would ever have come."""
    with pytest.raises(ConfigError, match=r"sensors\.imu\.topic: .* is no name of a topic"):
        Inputs(FakeNetwork(), [Subscription(topic, "imu", "imu")])


def test_one_odometry_serves_an_odometry_and_a_twist():
    network = FakeNetwork()
    inputs = Inputs(network, BOTH, reliable=True)
    assert network.subscribed == [("/odom", ODOMETRY, True)]  # the only type that is both
    pose, speed = inputs.decode(odometry(), 7)
    assert (pose.sensor, pose.position.tolist()) == ("wheels", [1.0, 2.0, 3.0])
    assert (speed.sensor, speed.linear.tolist(), speed.stamp_ns, speed.arrival_ns) == ("speed", [4, 0, 0], 5 * 10**9, 7)


def test_the_velocity_of_a_receiver_is_received_as_whichever_twist_is_published():
    network, types = FakeNetwork(), STORE.types
    inputs = Inputs(network, [Subscription("/vel", "doppler", "gnss_velocity")])
    inputs.join([Publication("/vel", TWIST, True)])
    assert network.subscribed == [("/vel", TWIST, False)]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 0), "gnss")
    vectors = (types["geometry_msgs/msg/Vector3"](x, 2.0, 0.0) for x in (4.0, 0.0))
    twist = types["geometry_msgs/msg/Twist"](*vectors)
    with_covariance = types["geometry_msgs/msg/TwistWithCovariance"](twist, np.full(36, 0.25))
    for type_name, content, covariance in ((TWIST, twist, None), (TWIST_COVARIANCE, with_covariance, 0.25)):
        message = types[type_name](header, content)
        (velocity,) = inputs.decode(Sample("/vel", type_name, bytes(STORE.serialize_cdr(message, type_name))), 7)
        assert (velocity.sensor, velocity.stamp_ns, velocity.velocity.tolist()) == ("doppler", 5 * 10**9, [4, 2, 0])
        assert velocity.covariance is None if covariance is None else (velocity.covariance == covariance).all()


@pytest.mark.parametrize("order", [1, -1])
def test_a_pose_without_rotation_costs_the_twist_of_the_message_nothing(order):
    inputs = Inputs(FakeNetwork(), BOTH[::order])
    (speed,) = inputs.decode(odometry(norm=0.0), 7)
    assert speed.sensor == "speed"
    assert (inputs.received["/odom"], inputs.malformed["/odom"]) == (1, 1)
    assert "quaternion has norm 0" in inputs.reasons["/odom"]


def test_damaged_bytes_are_counted_and_strange_topics_are_not():
    inputs = Inputs(FakeNetwork(), BOTH)
    assert inputs.decode(Sample("/odom", ODOMETRY, b"\x00\x01\x00\x00x"), 7) == []
    assert inputs.decode(Sample("/other", ODOMETRY, b""), 7) == []
    assert (dict(inputs.received), dict(inputs.malformed)) == ({"/odom": 1}, {"/odom": 1})


def test_one_topic_for_two_sensors_that_no_message_can_be_is_refused():
    with pytest.raises(ConfigError, match=r"sensors\.gnss\.topic: /t is that of another sensor"):
        Inputs(FakeNetwork(), [Subscription("/t", "imu", "imu"), Subscription("/t", "gnss", "gnss")])
