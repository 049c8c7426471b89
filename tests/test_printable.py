"""Text of an input, fit to be printed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.printable import QUOTED, listed, one_line, quoted


@given(st.text(st.characters()))
def test_what_is_printed_is_one_line_without_control_characters_and_is_left_alone_the_second_time(text):
    printed = one_line(text)
    assert printed.isprintable()
    assert one_line(printed) == printed
    assert not text.isprintable() or printed == text


@pytest.mark.parametrize(("text", "printed"), [
    ("/imu\x1b[2J", r"/imu\x1b[2J"),
    ("a\nerror: b", r"a\nerror: b"),
    ("\x9b31m", r"\x9b31m"),  # the same as ESC [ on some terminals
    ("abc\u202edcba", r"abc\u202edcba"),  # what follows runs backwards
    ("\udcff.bag", r"\udcff.bag"),  # a file name that is not UTF-8: printing it would raise
    ("Kräne 工地", "Kräne 工地"),
])  # fmt: skip
def test_a_control_character_is_written_as_python_writes_it(text, printed):
    assert one_line(text) == printed


def test_a_quotation_is_cut_and_so_is_a_list_of_names():
    assert len(quoted("x" * 10**6)) == QUOTED
    assert quoted("short") == "short"
    assert len(quoted("\0" * 10**6)) == QUOTED  # fuzzing found a column of a CSV that was quoted with 1000 characters
    assert listed([f"/t{k}" for k in range(1000)]).endswith("/t19 and 980 more")
    assert listed(["/a", "/b"]) == "/a, /b"
