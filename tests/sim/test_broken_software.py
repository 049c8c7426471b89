"""What software does to messages: a flood, a twin on the topic, garbage, and stamps of 32 bits that wrap around."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from struck import HEALTHY, same, strike, within
from test_transport import START_NS, TRUE_NS, numbers, send, step

from holdfast.geometry.earth import Geodetic, LocalFrame
from holdfast.sim.fault import Fault
from holdfast.sim.garbage import Garbage
from holdfast.sim.ros import RosMessages

IMU = "sensor_msgs/msg/Imu"
STORE = get_typestore(Stores.ROS2_HUMBLE)


def twin(start_s, end_s, **values):
    return Fault(kind="twin", sensors=("gnss",), start_s=start_s, end_s=end_s, **values)


def test_a_flood_repeats_what_was_measured_until_the_next_and_stamps_it_anew():
    before, after = HEALTHY["joint"], strike("flood", 10.0, 20.0, sensors=("joint",), flood_hz=1000.0)["joint"]
    flooded = within(after, 10.0, 20.0)
    assert flooded.sum() == pytest.approx(10_000, abs=110)
    assert np.all(np.diff(after.times_s) > 0.0)
    assert np.diff(after.times_s[flooded]) == pytest.approx(1e-3, rel=1e-6)
    held = before.values["angle_rad"][np.searchsorted(before.times_s, after.times_s + 1e-9, side="right") - 1]
    np.testing.assert_array_equal(after.values["angle_rad"], held)
    calm = after.times_s < 9.99
    assert same(after.taken(calm), before.taken(before.times_s < 9.99))


def test_a_flood_of_a_sensor_leaves_the_others_alone():
    after = strike("flood", sensors=("imu",), flood_hz=4000.0)
    assert all(same(after[name], HEALTHY[name]) for name in HEALTHY if name != "imu")


def test_a_twin_sends_each_message_again_with_a_stamp_and_a_content_of_its_own():
    sent = send(steps=[twin(100.0, 200.0, step_s=0.003, behind=2)])
    assert len(sent.stamps_ns) == 12_000
    copies = np.flatnonzero(np.diff(sent.arrivals_ns, prepend=0) == 0)
    assert len(copies) == 2000
    np.testing.assert_array_equal(sent.stamps_ns[copies] - sent.stamps_ns[copies - 1], 3_000_000)
    np.testing.assert_array_equal(numbers(sent)[copies], numbers(sent)[copies - 1] - 2)


def test_a_twin_of_the_first_message_has_nothing_older_to_tell():
    assert numbers(send(steps=[twin(0.0, 0.1, behind=5)]))[:4].tolist() == [0, 0, 1, 0]


def test_a_twin_with_the_same_stamps_and_content_is_every_message_twice():
    sent = send(steps=[twin(0.0, 500.0)])
    np.testing.assert_array_equal(sent.stamps_ns, TRUE_NS.repeat(2))
    np.testing.assert_array_equal(numbers(sent), np.arange(10_000).repeat(2))


def test_a_twin_steps_with_the_clock_of_its_sensor():
    sent = send(steps=[step(100.0, 200.0, 1e6), twin(100.0, 200.0, step_s=1.0)])
    inside = sent.stamps_ns > TRUE_NS[-1]
    assert inside.sum() == 4000
    assert set(np.round((sent.stamps_ns - START_NS - sent.readings.times_s * 1e9)[inside] * 1e-9).tolist()) == {
        1e6,
        1e6 + 1.0,
    }


# --- garbage ----------------------------------------------------------------------------------------------------------


def ros():
    return RosMessages(STORE.types, LocalFrame(Geodetic(47.0, 8.0, 400.0)))


def imu_message(row, stamp_ns):
    make = ros()
    nine = np.diag([1e-4] * 3).ravel()
    return make.make(
        IMU,
        header=make.header(stamp_ns, "imu"),
        orientation=make.quaternion((0.0, 0.0, 0.0, 1.0)),
        orientation_covariance=nine.copy(),
        angular_velocity=make.vector((0.1, 0.2, float(row))),
        angular_velocity_covariance=nine.copy(),
        linear_acceleration=make.vector((0.0, 0.0, 9.8)),
        linear_acceleration_covariance=nine.copy(),
    )


def flat(message):
    return bytes(STORE.serialize_cdr(message, IMU))


def garbage(ratio, seed=3, sensors=("imu",)):
    fault = Fault(kind="garbage", sensors=sensors, start_s=2.0, end_s=8.0, garbage_ratio=ratio)
    return Garbage([fault], "imu", np.arange(0.0, 10.0, 0.01), seed)


def test_garbage_strikes_a_fraction_of_the_messages_inside_and_none_outside():
    encode = garbage(0.3).in_place_of(imu_message)
    struck = np.array([flat(encode(k, START_NS + k)) != flat(imu_message(k, START_NS + k)) for k in range(1000)])
    assert not struck[:200].any()
    assert not struck[801:].any()
    assert struck[200:801].mean() == pytest.approx(0.3, abs=0.06)


def test_garbage_is_of_every_sort_and_every_message_can_still_be_written():
    encode = garbage(1.0).in_place_of(imu_message)
    rates, variances, stamps = [], [], []
    for k in range(200, 800):
        message = encode(k, START_NS)
        flat(message)
        rates.append(message.angular_velocity.x)
        variances.append(message.angular_velocity_covariance[0])
        stamps.append((message.header.stamp.sec, message.header.stamp.nanosec))
    assert np.isnan(rates).any() and np.isinf(rates).any() and (np.abs(rates) == 1e300).any()
    assert {0.0, -1.0} < set(variances)
    assert {-(2**31), 2**31 - 1} < {sec for sec, _ in stamps}
    assert any(nanosec >= 10**9 for _, nanosec in stamps)


def test_garbage_is_the_same_in_whatever_order_the_messages_are_made():
    forwards, backwards = (
        {k: flat(encode(k, START_NS)) for k in order}
        for order in (range(200, 300), range(299, 199, -1))
        for encode in [garbage(1.0).in_place_of(imu_message)]
    )
    assert forwards == backwards


def test_garbage_of_another_sensor_changes_nothing():
    assert garbage(1.0, sensors=("gnss",)).in_place_of(imu_message) is imu_message


def test_the_seconds_of_a_stamp_wrap_around_as_32_bits_do():
    stamp = ros().header((2**31 + 5) * 10**9 + 7, "imu").stamp
    assert (stamp.sec, stamp.nanosec) == (-(2**31) + 5, 7)
