"""Shared memory: a reader sees whole rows and records or none, and every bit of a message."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.geometry.earth import Geodetic
from holdfast.messages import FixStatus, GnssFix, Heading, ImuSample, LidarPose
from holdfast.realtime.memory import Memory, Ring, Slot
from holdfast.realtime.records import pack_request, pack_sample, unpack_request, unpack_sample

ROWS, BODY = 16, 24


@pytest.fixture
def memory():
    shared = Memory(4096)
    yield shared
    shared.close()


def bodies(count):
    return [bytes([k]) * BODY for k in range(1, count + 1)]


def test_a_ring_gives_back_the_last_rows_by_number(memory):
    ring = Ring(memory, 64, ROWS, BODY)
    assert ring.read(0) is None
    for number, body in enumerate(bodies(40)):
        ring.push(body)
        assert ring.read(number) == body
        assert ring.read(number + 1) is None
    assert [ring.read(k) for k in range(24, 40)] == bodies(40)[24:]


def test_a_reader_that_is_lapped_is_led_to_a_row_that_is_still_there(memory):
    ring = Ring(memory, 64, ROWS, BODY)
    for body in bodies(40):
        ring.push(body)
    assert ring.read(3) is None
    oldest = ring.oldest_after(3)
    assert 24 <= oldest < 40
    assert ring.read(oldest) == bodies(40)[oldest]
    assert ring.oldest_after(40) is None  # not written yet


@given(cut=st.integers(1, 8 + BODY + 3), garbage=st.integers(0, 255))
@settings(max_examples=60, deadline=None)
def test_a_row_that_is_half_written_is_not_read(cut, garbage):
    shared = Memory(4096)
    ring = Ring(shared, 64, ROWS, BODY)
    for body in bodies(ROWS + 1):  # row 16 lies over row 0
        ring.push(body)
    whole = bytes(shared.map[64 : 64 + 8 + BODY + 4])
    torn = whole[:cut] + bytes([garbage]) * (len(whole) - cut)
    shared.map[64 : 64 + len(torn)] = torn
    assert ring.read(16) in {None, bodies(17)[16] if torn == whole else None}
    shared.close()


def test_a_slot_gives_the_newest_record_and_the_one_before_if_that_is_torn(memory):
    slot = Slot(memory, 64, BODY)
    assert slot.read() is None
    for version, body in enumerate(bodies(5), start=1):
        slot.write(body)
        assert slot.version == version
        assert slot.read() == (version, body)
    at = memory.map.find(bodies(5)[4])
    memory.map[at : at + 1] = b"\xff"
    assert slot.read() == (4, bodies(5)[3])
    slot.release()


def test_another_process_writes_on_where_one_was_killed_in_a_write(memory):
    slot = Slot(memory, 64, BODY)
    slot.write(bodies(1)[0])
    successor = Slot(memory, 64, BODY)
    successor.write(bodies(2)[1])
    assert slot.read() == (2, bodies(2)[1])
    slot.release()
    successor.release()


floats = st.floats(width=64)  # NaN and infinity travel, too
stamps = st.integers(-(2**63), 2**63 - 1)


def vector(length):
    return st.lists(floats, min_size=length, max_size=length).map(np.array)


def matrix(size):
    return st.none() | vector(size * size).map(lambda values: values.reshape(size, size))


messages = st.one_of(
    st.builds(
        GnssFix, stamps, stamps, st.sampled_from(["gnss", "gnss_right"]), floats, floats, floats, matrix(3),
        st.sampled_from(FixStatus),
    ),
    st.builds(Heading, stamps, stamps, st.just("heading"), floats, st.none() | floats),
    st.builds(LidarPose, stamps, stamps, st.just("lidar"), vector(3), vector(4), matrix(6)),
)  # fmt: skip


def same(one, other):
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, float | np.ndarray):
            assert np.asarray(a).tobytes() == np.asarray(b).tobytes(), field.name
            assert np.shape(a) == np.shape(b)
        else:
            assert a == b, field.name


@settings(deadline=None)
@given(epoch=st.integers(0, 2**40), samples=st.integers(0, 2**40), message=messages)
def test_a_measurement_comes_out_as_it_went_in(epoch, samples, message):
    *counted, unpacked = unpack_request(pack_request(epoch, samples, message))
    assert counted == [epoch, samples]
    assert type(unpacked) is type(message)
    same(unpacked, message)


@settings(deadline=None)
@given(sample=st.builds(ImuSample, stamps, stamps, st.just("imu"), vector(3), vector(3)))
def test_a_sample_comes_out_as_it_went_in(sample):
    epoch, unpacked = unpack_sample(pack_sample(7, sample))
    assert epoch == 7
    same(unpacked, sample)


@pytest.mark.parametrize("request_", [None, Geodetic(47.0, 8.0, 400.0)])
def test_a_request_comes_out_as_it_went_in(request_):
    assert unpack_request(pack_request(1, 2, request_)) == (1, 2, request_)
