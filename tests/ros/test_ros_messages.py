"""The published messages, one by one."""

import gtsam
import numpy as np
import pytest

from holdfast.config.model import Config
from holdfast.live.idl import STORE
from holdfast.ros.messages import EstimateMessages, Status, diagnostic_array
from holdfast.ros.outputs import odometry, seen_from
from holdfast.ros.rows import Rows
from holdfast.state import Estimate

STAMP_NS = 1_700_000_000_123_456_789


def estimate(stamp_ns=STAMP_NS):
    A = np.random.default_rng(1).normal(size=(9, 9))
    nav = gtsam.NavState(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.7), np.array([4.0, 5.0, 6.0]), np.array([1.0, 2.0, 0.5]))
    T_W_O = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([1.0, -2.0, 0.5]))
    return Estimate.of(stamp_ns, nav, T_W_O, gtsam.imuBias.ConstantBias(), A @ A.T, np.array([0.1, 0.2, 0.3]), True)


def test_an_estimate_seen_from_another_frame_is_its_odometry_there():
    rows, variances = Rows.of([estimate()]), np.array([1e-4])
    expected = odometry(rows, rows.T_O_I, variances)
    for ours, direct in zip(seen_from(odometry(rows, rows.T_W_I, variances), rows, rows.T_O_I), expected, strict=True):
        np.testing.assert_array_equal(ours, direct)


def test_many_estimates_at_once_are_the_messages_of_one_after_the_other():
    config = Config.model_validate({"sensors": {"imu": {"kind": "imu", "topic": "/imu"}}})
    given = [estimate(STAMP_NS + k * period_ns) for k, period_ns in enumerate((0, 10_000_000, 9_000_000, 2**33))]
    at_once, one_by_one = EstimateMessages(config), EstimateMessages(config)
    assert at_once.of(Rows.of(given)) == [one_by_one.of(Rows.of([one]))[0] for one in given]


@pytest.mark.parametrize("node", ["/holdfast", "/excavator/holdfast"])
def test_topics_are_those_of_the_node_and_every_one_is_declared(node):
    messages = EstimateMessages(Config.model_validate({"sensors": {"imu": {"kind": "imu", "topic": "/imu"}}}), node)
    given = {message.topic: message for message in messages.of(Rows.of([estimate()]))[0]}
    assert set(given) == {f"{node}/odometry/world", f"{node}/odometry/odom", "/tf"}
    assert {topic: message.type_name for topic, message in given.items()} == messages.topics
    for message in given.values():
        decoded = STORE.deserialize_cdr(message.data, message.type_name)
        header = decoded.transforms[0].header if message.topic == "/tf" else decoded.header
        assert header.stamp.sec * 10**9 + header.stamp.nanosec == STAMP_NS


def test_diagnostics_hold_every_status_with_its_values():
    statuses = [Status(0, "holdfast", "nominal", [("fused", "imu gnss")]), Status(1, "holdfast: /imu", "silent")]
    array = diagnostic_array(STORE.types, STAMP_NS, statuses)
    again = STORE.deserialize_cdr(
        STORE.serialize_cdr(array, "diagnostic_msgs/msg/DiagnosticArray"), "diagnostic_msgs/msg/DiagnosticArray"
    )
    found = [Status(s.level, s.name, s.message, [(v.key, v.value) for v in s.values]) for s in again.status]
    assert found == [statuses[0], statuses[1]._replace(values=[])]
    assert again.header.stamp.sec * 10**9 + again.header.stamp.nanosec == STAMP_NS
