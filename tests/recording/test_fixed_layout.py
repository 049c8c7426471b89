"""Fields read from where they lie: the same as the general decoder's, or nothing."""

import random

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from holdfast.recording.fixed_layout import FixedLayout

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types


def header(frame_id, sec=1_700_000_000):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=sec, nanosec=987_654_321)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def joints(names, seed=0, frame_id="base"):
    noise = random.Random(seed)
    values = [np.array([noise.random() for _ in names]) for _ in range(2)]
    return TYPES["sensor_msgs/msg/JointState"](header(frame_id, seed), names, *values, np.array([]))


def raw_of(message):
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def layout_of(message, *fields):
    return FixedLayout(STORE.fielddefs, message.__msgtype__, fields, raw_of(message))


@pytest.mark.parametrize("frame_id", ["", "a", "im", "imu", "base_imu", "x" * 13])
def test_numbers_arrays_and_what_lies_behind_a_name_are_found_at_every_alignment(frame_id):
    numbers = np.arange(9.0)
    status = TYPES["sensor_msgs/msg/NavSatStatus"](status=-1, service=7)
    fix = TYPES["sensor_msgs/msg/NavSatFix"](header(frame_id), status, 47.5, 8.25, 412.0, numbers, 2)
    layout = layout_of(fix, "latitude", "position_covariance", "status.status", "position_covariance_type")
    assert layout.read(raw_of(fix)) == (47.5, tuple(numbers), -1, 2)


def test_strings_and_sequences_are_those_of_each_message():
    layout = layout_of(joints(["turn", "boom"]), "position", "name", "header.stamp.sec")
    other = joints(["boom", "turn"], seed=5)
    assert layout.read(raw_of(other)) == (tuple(other.position), ("boom", "turn"), 5)


@pytest.mark.parametrize("names", [["turn"], ["turn", "arm"], ["turning"], [], ["turn", "boom", "stick"]])
def test_a_message_with_other_lengths_is_not_read(names):
    assert layout_of(joints(["turn", "boom"]), "position", "name").read(raw_of(joints(names))) is None


def test_lengths_that_cancel_out_are_noticed():
    """Two messages of one size, of which one has a longer name here and a shorter one there."""
    ours, other = joints(["abc", "abcdefg"]), joints(["abcdefg", "abc"])
    assert len(raw_of(ours)) == len(raw_of(other))
    assert layout_of(ours, "position").read(raw_of(other)) is None


def test_what_is_no_little_endian_cdr_or_cut_off_is_refused():
    message = joints(["turn"])
    big = bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=False))
    with pytest.raises(ValueError, match="little endian"):
        FixedLayout(STORE.fielddefs, message.__msgtype__, ["position"], big)
    with pytest.raises(ValueError, match="too early"):
        FixedLayout(STORE.fielddefs, message.__msgtype__, ["position"], raw_of(message)[:-9])
    assert layout_of(message, "position", "name").read(big) is None
    with pytest.raises(KeyError):
        layout_of(message, "no_such_field")
