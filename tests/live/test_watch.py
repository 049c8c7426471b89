"""What is reported of topics on which something is wrong."""

import pytest

from holdfast.live.dds import Publication
from holdfast.live.watch import Watch

IMU, FIX, ODOMETRY, POSE = (
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
)
TOPICS = {"/imu/data": (IMU,), "/lidar": (ODOMETRY, POSE)}
BEGAN_NS = 1_700_000_000_000_000_000
SECOND_NS = 1_000_000_000
HERE = [Publication("/imu/data", IMU, True), Publication("/lidar", POSE, False)]


class Watched:
    """A watch with a clock that the test sets."""

    def __init__(self, reliable=False):
        self.watch = Watch(TOPICS, 5.0, 1.0, reliable=reliable, began_ns=BEGAN_NS)

    def receive(self, at_s, *topics, offset_s=0.0):
        at_ns = BEGAN_NS + round(at_s * SECOND_NS)
        for topic in topics or TOPICS:
            self.watch.note(topic, at_ns + round(offset_s * SECOND_NS), at_ns, at_ns)

    def review(self, at_s, publications=HERE, malformed=None):
        reasons = {"/lidar": "quaternion has norm 0"}
        return self.watch.review(BEGAN_NS + round(at_s * SECOND_NS), publications, malformed or {}, reasons)


@pytest.fixture
def watched():
    return Watched()


def test_nothing_is_wrong_while_messages_come(watched):
    for second in range(1, 20):
        watched.receive(second)
        assert watched.review(second + 0.5) == {}


def test_a_publisher_is_missing_only_after_a_while(watched):
    assert watched.review(4.9, []) == {}
    found = watched.review(5.1, [])
    assert set(found) == set(TOPICS)
    assert "nobody publishes it" in found["/imu/data"].text
    assert IMU in found["/imu/data"].text
    assert ODOMETRY in found["/lidar"].text and POSE in found["/lidar"].text


def test_a_topic_of_the_right_type_with_a_name_like_it_is_proposed(watched):
    others = [Publication("/imu/data_raw", IMU, True), Publication("/gnss", FIX, True), HERE[1]]
    watched.receive(5.0, "/lidar")
    assert "did you mean /imu/data_raw" in watched.review(6.0, others)["/imu/data"].text


def test_a_wrong_type_is_reported_at_once_with_both_names(watched):
    watched.receive(0.5, "/lidar")
    found = watched.review(1.0, [Publication("/imu/data", FIX, True), HERE[1]])
    assert set(found) == {"/imu/data"}
    assert FIX in found["/imu/data"].text and IMU in found["/imu/data"].text


def test_a_silent_publisher_is_reported_apart_from_an_absent_one(watched):
    watched.receive(1.0)
    assert watched.review(1.0) == {} == watched.review(5.9)
    found = watched.review(6.1)
    assert {finding.kind for finding in found.values()} == {"silent"}
    assert found["/lidar"].text == "has a publisher, seen for 5 s, but no message for 5 s"


def test_the_silence_of_a_publisher_counts_from_when_it_was_seen(watched):
    assert set(watched.review(60.0, [])) == set(TOPICS)
    assert watched.review(61.0) == {} == watched.review(65.9), "it has been there for 5 s only"
    assert watched.review(68.0)["/lidar"].text == "has a publisher, seen for 7 s, but no message has come"
    watched.review(69.0, [])
    assert watched.review(70.0) == {}, "another one"


def test_a_best_effort_driver_and_a_reliable_reader_never_meet():
    watched = Watched(reliable=True)
    assert watched.review(0.5) == {}
    found = watched.review(6.0)
    assert found["/imu/data"].kind == "silent"  # its publisher is reliable
    assert "best-effort" in found["/lidar"].text


@pytest.mark.parametrize(("offset_s", "words"), [(-1.7e9, "behind"), (2.0, "ahead of"), (-1.5, "behind")])
def test_stamps_far_from_this_clock_are_reported_with_their_distance(watched, offset_s, words):
    watched.receive(1.0, "/imu/data", offset_s=offset_s)
    text = watched.review(1.5)["/imu/data"].text
    assert words in text and f"{abs(offset_s):.3g} s" in text


def test_stamps_within_the_limit_are_well(watched):
    watched.receive(1.0, offset_s=-0.9)
    assert watched.review(1.5) == {}


def test_unusable_messages_are_reported_with_number_and_reason_once_per_review(watched):
    watched.receive(1.0)
    assert "3 message(s)" in watched.review(1.5, malformed={"/lidar": 3})["/lidar"].text
    assert watched.review(2.5, malformed={"/lidar": 3}) == {}
    text = watched.review(3.5, malformed={"/lidar": 4})["/lidar"].text
    assert "1 message(s)" in text and "quaternion has norm 0" in text


def test_two_publishers_of_one_sensor_are_reported(watched):
    watched.receive(1.0)
    assert "2 publishers" in watched.review(1.5, [*HERE, HERE[0]])["/imu/data"].text


def test_the_rate_is_that_of_the_last_messages_and_falls_in_silence(watched):
    for k in range(300):
        watched.receive(1.0 + 0.01 * k, "/imu/data")
    reception = watched.watch.received["/imu/data"]
    at_s = 1.0 + 0.01 * 299
    assert reception.rate_hz(BEGAN_NS + round(at_s * SECOND_NS)) == pytest.approx(100.0, rel=1e-6)
    assert reception.rate_hz(BEGAN_NS + round((at_s + 2.0) * SECOND_NS)) == pytest.approx(0.5, rel=1e-6)
    assert watched.watch.received["/lidar"].rate_hz(BEGAN_NS) == 0.0
