"""Shared memory: a reader sees whole rows and whole records, or none."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.realtime.memory import Memory, Ring, Slot

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


@given(cut=st.integers(1, 8 + BODY + 7), garbage=st.integers(0, 255))
@settings(max_examples=60)
def test_a_row_that_is_half_written_is_not_read(cut, garbage):
    shared = Memory(4096)
    ring = Ring(shared, 64, ROWS, BODY)
    for body in bodies(ROWS + 1):  # row 16 lies over row 0
        ring.push(body)
    whole = bytes(shared.map[64 : 64 + 8 + BODY + 8])
    torn = whole[:cut] + bytes([garbage]) * (len(whole) - cut)
    shared.map[64 : 64 + len(torn)] = torn
    assert ring.read(16) in {None, bodies(17)[16] if torn == whole else None}
    ring.release()
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
